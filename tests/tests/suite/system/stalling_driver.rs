//! A velocity driver that measures while its motors get no commands, again and again, beside an obstacle.

use std::collections::BTreeSet;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use cdcr_client::{Circle, Connection, FeedError, FeedEvent, PlantDriver};
use cdcr_controller::estimator::Actuator;
use cdcr_controller::plant::Flaws;
use cdcr_controller::robot::{Obstacle, Shape};
use cdcr_shared_types::codes::{Interface, Mode, Reason};
use cdcr_tests::{Daemon, EndWhenDropped, ball, tracked, until_undisturbed, wait_record};
use nalgebra::Vector3;

const CONFIGURATION: &str = "[link]\nkind = \"driver\"\nmeasurement_timeout_ms = 500.0\n\
    [cycle]\nmiss_limit = 1000000\n[reference]\nlease_ms = 60000.0\n\
    [actuator]\ndelay_ms = 10.0\ntime_constant_ms = 20.0\n";
/// A ball on the circle of the reference.
const CENTRE_M: [f64; 3] = [0.0, 0.2, 0.837];
const RADIUS_M: f64 = 0.03;
/// Of the safe distance of 10 mm: half, as in lockstep, where 7.9 mm are left at any phase of the losses, and 5.8 mm if the driver stalls, too
/// (`cycle::tests::contact::lost_commands`).
const LEAST_M: f64 = 5e-3;
const EVERY_MS: u64 = 150;

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

/// Runs the driver until `ends`; its motors get no command for 30 to 50 ms, again and again. Returns the least true clearance
/// \[m\] and how often.
fn drive(connection: &Connection, ends: &AtomicBool) -> (f64, u64) {
    let mut driver = PlantDriver::new(connection, Interface::Velocity, None, flaws(), 11).unwrap();
    let shape = Shape::Sphere {
        centre_m: CENTRE_M.into(),
    };
    let seen = Obstacle::new(shape, RADIUS_M, Vector3::zeros()).unwrap();
    let (mut least_m, mut losses, begin) = (f64::INFINITY, 0, Instant::now());
    while !ends.load(Ordering::Relaxed) {
        let now_ms = begin.elapsed().as_millis() as u64;
        losses = now_ms / EVERY_MS;
        if now_ms % EVERY_MS < EVERY_MS - 30 - 7 * losses % 21 {
            driver.follow().unwrap();
        } else {
            driver.advance();
        }
        driver.send_cables().unwrap();
        least_m = least_m.min(driver.plant().clearance_m([seen].into_iter()));
        std::thread::sleep(Duration::from_millis(2));
    }
    (least_m, losses)
}

/// Tracks a circle through the ball. The least true clearance \[m\], how often commands were lost, and the number of the stated
/// rests; `None`: inputs were stale, on a machine that stalls.
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
                rests.insert(record.measurement.rested_from_ns);
            }
            ControlFlow::Continue(())
        });
        drop(ending);
        rests.remove(&0);
        let (least_m, losses) = driver.join().unwrap();
        println!(
            "{losses} losses, {} stated rests: true clearance {least_m} m",
            rests.len()
        );
        match report {
            Ok(_) => Some((least_m, losses, rests.len())),
            Err(FeedError::LeftTracking { reason, .. }) if reason == Reason::InputsStale.text() => {
                None
            }
            Err(error) => panic!("{error}; true clearance {least_m} m"),
        }
    })
}

#[test]
fn a_driver_that_loses_commands_again_and_again_touches_nothing() {
    let (least_m, losses, rests) =
        until_undisturbed("a circle is tracked to its end", track_beside_the_ball);
    assert!(least_m > LEAST_M, "{least_m} m");
    // Some end before a record with their measurement.
    assert!(rests as u64 > losses / 2, "{rests} of {losses}");
}
