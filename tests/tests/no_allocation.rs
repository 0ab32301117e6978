//! The cycle thread of a whole daemon makes 10 000 cycles without one heap operation.

#![allow(
    clippy::unwrap_used,
    reason = "in a test a panic is the report, in its helpers, too"
)]

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use cdcr_client::{Connection, FeedEvent, FeedOptions, Spiral};
use cdcr_daemon::app::run_until;
use cdcr_daemon::config::Config;
use cdcr_daemon::rt::sys::{CountingAllocator, count_allocations};
use cdcr_shared_types::SolverSettings;
use cdcr_shared_types::codes::{Mode, RequestKind};
use cdcr_tests::{PATIENCE, Place, ROBOT};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Cycles that must pass without a heap operation.
const CYCLES: u64 = 10_000;

static HEAP_OPERATIONS: AtomicU64 = AtomicU64::new(u64::MAX);
static ENDING: AtomicBool = AtomicBool::new(false);

#[test]
fn the_counter_counts() {
    let (operations, text) = count_allocations(|| vec![1_u8; 100]);
    assert_eq!((operations, text.len()), (1, 100));
    assert_eq!(count_allocations(|| drop(text)).0, 1);
}

#[test]
fn ten_thousand_cycles_without_a_heap_operation() {
    let place = Place::new();
    // Short periods, so that 10 000 cycles are soon over; everything else as in service.
    let text = format!(
        "[cycle]\nperiod_ms = 1.0\ngather_lead_ms = 0.2\nmiss_limit = 1000000\n\
         [transport]\nprefix = \"{}\"\nroot = \"{}\"\n",
        place.location().prefix(),
        place.location().root().display()
    );
    let validated = Config::parse(&text, &place.folder().join("robot.toml")).unwrap();
    std::thread::scope(|scope| {
        let daemon = scope.spawn(|| {
            run_until(
                &validated,
                || ENDING.load(Ordering::Relaxed),
                |life| {
                    let (operations, ()) = count_allocations(life);
                    HEAP_OPERATIONS.store(operations, Ordering::Release);
                },
            )
        });
        let (cycles, tracked) = keep_busy(&place);
        ENDING.store(true, Ordering::Relaxed);
        daemon.join().unwrap().unwrap();
        assert!(
            cycles >= CYCLES && tracked > CYCLES / 10,
            "{tracked} of {cycles} cycles tracked"
        );
    });
    assert_eq!(HEAP_OPERATIONS.load(Ordering::Acquire), 0);
}

/// Tracks, changes settings, holds, stops, resets and homes, until the daemon has run long enough.
/// Returns its cycles, and the records of tracking cycles.
fn keep_busy(place: &Place) -> (u64, u64) {
    let begin = std::time::Instant::now();
    let connection = loop {
        match Connection::open(place.location(), ROBOT) {
            Ok(connection) => break connection,
            Err(error) => assert!(begin.elapsed() < PATIENCE, "{error}"),
        }
    };
    let settings = connection.status(PATIENCE).unwrap().settings;
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
                }
                ControlFlow::Continue(())
            });
        }
        for kind in [RequestKind::Home, RequestKind::Hold, RequestKind::Stop] {
            let _ = connection.request(kind);
        }
        cycles = connection.status(PATIENCE).unwrap().cycles;
        assert!(begin.elapsed() < 10 * PATIENCE, "{cycles} cycles only");
    }
    (cycles, tracked)
}
