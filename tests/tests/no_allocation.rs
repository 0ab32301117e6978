//! The cycle thread of a whole daemon makes 10 000 cycles without one heap operation.

#![allow(
    clippy::unwrap_used,
    reason = "in a test a panic is the report, in its helpers, too"
)]

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use cdcr_client::{Connection, FeedEvent, FeedOptions, Spiral, monotonic_ns};
use cdcr_daemon::app::run_until;
use cdcr_daemon::config::Config;
use cdcr_daemon::rt::sys::{CountingAllocator, count_allocations};
use cdcr_shared_types::codes::{MeasurementKind, Mode, RequestKind};
use cdcr_shared_types::{Measurement, Obstacle, SolverSettings, Telemetry};
use cdcr_tests::{PATIENCE, Place, ROBOT};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Cycles that must pass without a heap operation.
const CYCLES: u64 = 10_000;

static HEAP_OPERATIONS: AtomicU64 = AtomicU64::new(u64::MAX);

#[test]
fn the_counter_counts() {
    let (operations, text) = count_allocations(|| vec![1_u8; 100]);
    assert_eq!((operations, text.len()), (1, 100));
    assert_eq!(count_allocations(|| drop(text)).0, 1);
}

#[test]
fn ten_thousand_cycles_without_a_heap_operation() {
    run_daemon("", |place, _| keep_busy(place));
    run_daemon("[link]\nkind = \"driver\"\n", |place, ending| {
        std::thread::scope(|scope| {
            scope.spawn(|| drive(place, ending));
            let counts = keep_busy(place);
            ending.store(true, Ordering::Relaxed);
            counts
        })
    });
}

/// Runs a whole daemon while `work` keeps it busy, and counts what its cycle thread does on the heap.
/// `work` returns the cycles that it saw, and how many of them tracked.
fn run_daemon(link: &str, work: impl FnOnce(&Place, &AtomicBool) -> (u64, u64)) {
    let place = Place::new();
    // Short periods, so that 10 000 cycles are soon over; everything else as in service.
    let text = format!(
        "{link}[cycle]\nperiod_ms = 1.0\ngather_lead_ms = 0.2\nmiss_limit = 1000000\n\
         [transport]\nprefix = \"{}\"\nroot = \"{}\"\n",
        place.location().prefix(),
        place.location().root().display()
    );
    let validated = Config::parse(&text, &place.folder().join("robot.toml")).unwrap();
    HEAP_OPERATIONS.store(u64::MAX, Ordering::Release);
    let ending = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let daemon = scope.spawn(|| {
            run_until(
                &validated,
                || ending.load(Ordering::Relaxed),
                |life| {
                    let (operations, ()) = count_allocations(life);
                    HEAP_OPERATIONS.store(operations, Ordering::Release);
                },
            )
        });
        let (cycles, tracked) = work(&place, &ending);
        ending.store(true, Ordering::Relaxed);
        daemon.join().unwrap().unwrap();
        assert!(
            cycles >= CYCLES && tracked > CYCLES / 10,
            "{tracked} of {cycles} cycles tracked"
        );
    });
    assert_eq!(HEAP_OPERATIONS.load(Ordering::Acquire), 0, "{link}");
}

/// Connects as soon as the daemon is up.
fn connect(place: &Place) -> Connection {
    let begin = std::time::Instant::now();
    loop {
        match Connection::open(place.location(), ROBOT) {
            Ok(connection) => return connection,
            Err(error) => assert!(begin.elapsed() < PATIENCE, "{error}"),
        }
    }
}

/// A driver that measures now the bends, now the cables, and at times falls silent for long enough to be a
/// fault.
fn drive(place: &Place, ending: &AtomicBool) {
    let connection = connect(place);
    let mut driver = connection.driver().unwrap();
    let mut measurement = Measurement {
        sections: 3,
        kind: MeasurementKind::Configuration.code(),
        ..Measurement::default()
    };
    let mut turn = 0_u32;
    while !ending.load(Ordering::Relaxed) {
        turn += 1;
        if let Some(command) = driver.newest_command().unwrap() {
            measurement.bend_rad = command.bend_target_rad;
            measurement.cable_length_m = command.cable_length_m;
            let kind = if turn.is_multiple_of(2) {
                MeasurementKind::CableLengths
            } else {
                MeasurementKind::Configuration
            };
            measurement.kind = kind.code();
        }
        measurement.measured_ns = monotonic_ns();
        driver.send(measurement).unwrap();
        let pause_ms = if turn.is_multiple_of(2000) { 150 } else { 1 };
        std::thread::sleep(Duration::from_millis(pause_ms));
    }
}

/// A ball in the way of the tip and a crowd farther away; they come, move and expire.
fn around(record: &Telemetry) -> [Obstacle; 40] {
    let [x, y, z] = record.tip_position_m;
    core::array::from_fn(|i| {
        let id = i as u32;
        let apart_m = 0.05 + 0.01 * f64::from(id);
        Obstacle {
            id: id + 20 * (record.cycle / 100 % 2) as u32,
            shape: id % 2,
            start_m: [x + apart_m, y, z],
            end_m: [x + apart_m, y + 0.1, z],
            radius_m: 0.02,
            velocity_m_s: [0.0, 0.01 * f64::from(id), 0.0],
            measured_ns: monotonic_ns(),
            lifetime_ns: 50_000_000,
        }
    })
}

/// Tracks past obstacles, changes settings, holds, stops, resets and homes, until the daemon has run long enough.
/// Returns its cycles, and the records of tracking cycles.
fn keep_busy(place: &Place) -> (u64, u64) {
    let begin = std::time::Instant::now();
    let connection = connect(place);
    let settings = connection.status(PATIENCE).unwrap().settings;
    let obstacles = connection.obstacle_sender().unwrap();
    let (mut cycles, mut tracked, mut turn) = (0, 0, 0);
    while cycles < CYCLES {
        turn += 1;
        let _ = connection.request(RequestKind::Reset);
        let swarm_size = if turn % 2 == 0 { 6 } else { 20 };
        connection
            .change_settings(SolverSettings {
                swarm_size,
                ..settings
            })
            .unwrap();
        let spiral = Spiral {
            duration_s: 2.0,
            ..Spiral::for_sections(&[0.3; 3])
        };
        let options = FeedOptions {
            track: true,
            ..FeedOptions::default()
        };
        // A stall of the machine may end a feed early; the next turn feeds again.
        if let Ok(feed) = connection.feed(&spiral, options) {
            let _ = feed.run(|event| {
                if let FeedEvent::Record(record) = event {
                    tracked += u64::from(record.mode == Mode::Tracking.code());
                    if record.cycle.is_multiple_of(10) {
                        obstacles.upsert(&around(record)).unwrap();
                    }
                }
                ControlFlow::Continue(())
            });
        }
        obstacles.clear().unwrap();
        for kind in [RequestKind::Home, RequestKind::Hold, RequestKind::Stop] {
            let _ = connection.request(kind);
        }
        cycles = connection.status(PATIENCE).unwrap().cycles;
        assert!(begin.elapsed() < 10 * PATIENCE, "{cycles} cycles only");
    }
    (cycles, tracked)
}
