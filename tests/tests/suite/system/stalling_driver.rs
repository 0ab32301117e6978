//! A driver of speeds that stalls again and again beside an obstacle.

use std::collections::BTreeSet;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use cdcr_client::{Circle, Connection, FeedError, FeedEvent, PlantDriver};
use cdcr_controller::estimator::Actuator;
use cdcr_controller::plant::Flaws;
use cdcr_controller::robot::{Obstacle, Shape};
use cdcr_shared_types::codes::{Interface, Mode};
use cdcr_tests::{Daemon, EndWhenDropped, ball, tracked, until_undisturbed, wait_record};
use nalgebra::Vector3;

const CONFIGURATION: &str = "[link]\nkind = \"driver\"\nmeasurement_timeout_ms = 500.0\n\
    [cycle]\nmiss_limit = 1000000\n[reference]\nlease_ms = 60000.0\n\
    [actuator]\ndelay_ms = 10.0\ntime_constant_ms = 20.0\n";
/// A ball on the circle of the reference.
const CENTRE_M: [f64; 3] = [0.0, 0.2, 0.837];
const RADIUS_M: f64 = 0.03;
/// Of the safe distance of 10 mm.
const LEAST_M: f64 = 2e-3;
const EVERY: Duration = Duration::from_millis(150);

/// The motors as configured, and noise.
fn flaws() -> Flaws {
    Flaws {
        actuator: Actuator {
            delay_s: 0.01,
            time_constant_s: 0.02,
            play_m: 0.0,
        },
        noise_m: 3e-5,
        ..Flaws::default()
    }
}

/// Runs the driver until `ends`; it stalls for 20 to 40 ms, again and again. Returns the least true clearance \[m\] and
/// the number of stalls.
fn drive(connection: &Connection, ends: &AtomicBool) -> (f64, u64) {
    let mut driver = PlantDriver::new(connection, Interface::Velocity, None, flaws(), 11).unwrap();
    let shape = Shape::Sphere {
        centre_m: CENTRE_M.into(),
    };
    let seen = Obstacle::new(shape, RADIUS_M, Vector3::zeros()).unwrap();
    let (mut least_m, mut stalls, mut stalled) = (f64::INFINITY, 0, Instant::now());
    while !ends.load(Ordering::Relaxed) {
        driver.follow().unwrap();
        driver.send_cables().unwrap();
        least_m = least_m.min(driver.plant().clearance_m([seen].into_iter()));
        let mut pause_ms = 2;
        if stalled.elapsed() > EVERY {
            pause_ms = 20 + 7 * stalls % 21;
            stalls += 1;
            stalled = Instant::now();
        }
        std::thread::sleep(Duration::from_millis(pause_ms));
    }
    (least_m, stalls)
}

/// Tracks a circle through the ball. The least true clearance \[m\], the number of stalls, and that of the stated rests;
/// `None`: it was not tracked to its end, without contact.
fn track_beside_the_ball() -> Option<(f64, u64, usize)> {
    let daemon = Daemon::start(CONFIGURATION);
    let connection = daemon.connect();
    let sender = connection.obstacle_sender().unwrap();
    let mut seen = ball(1, CENTRE_M);
    seen.radius_m = RADIUS_M;
    sender.upsert(&[seen]).unwrap();
    let mut telemetry = connection.telemetry().unwrap();
    let circle = Circle {
        radius_m: 0.2,
        height_m: CENTRE_M[2],
        rate_rad_s: 1.5,
        duration_s: 9.0,
    };
    let ends = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let ending = EndWhenDropped(&ends);
        let driver = scope.spawn(|| drive(&daemon.connect(), &ends));
        wait_record(&mut telemetry, |record| {
            record.obstacle_count == 1 && record.mode == Mode::Holding.code()
        });
        let mut rests = BTreeSet::new();
        let report = connection.feed(&circle, tracked()).unwrap().run(|event| {
            if let FeedEvent::Record(record) = event {
                rests.insert(record.measurement.rested_until_ns);
            }
            ControlFlow::Continue(())
        });
        drop(ending);
        let (least_m, stalls) = driver.join().unwrap();
        println!(
            "{stalls} stalls, {} stated rests: true clearance {least_m} m",
            rests.len()
        );
        match report {
            Ok(_) => Some((least_m, stalls, rests.len())),
            // Not the contact: a machine that stalls may end it.
            Err(FeedError::LeftTracking { .. }) if least_m > LEAST_M => None,
            Err(error) => panic!("{error}; true clearance {least_m} m"),
        }
    })
}

#[test]
fn a_driver_that_stalls_again_and_again_touches_nothing() {
    let (least_m, stalls, rests) =
        until_undisturbed("a circle is tracked to its end", track_beside_the_ball);
    assert!(least_m > LEAST_M, "{least_m} m");
    // Some end before a record with their measurement.
    assert!(rests as u64 > stalls / 2, "{rests} of {stalls}");
}
