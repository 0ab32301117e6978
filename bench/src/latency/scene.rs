//! References of the client, sent far enough ahead that no stall makes them late.

use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use cdcr_client::{ReferenceFeed, RequestError, monotonic_ns, section_lengths_m};
use cdcr_shared_types::codes::{ChunkMode, Interpolation, Mode, Outcome, Reason, RequestKind};
use cdcr_shared_types::{Header, ReferencePoint};

use super::inputs::Sender;
use crate::interrupt;
use crate::subject::TIMEOUT;
use crate::subject::watcher::Watcher;

/// Time from sending to the begin of a reference \[ns\]; until then its first point applies.
const BEGINS_NS: u64 = 500_000_000;
const ASK_AGAIN: Duration = Duration::from_millis(5);
const ENDS_NS: u64 = 3_600_000_000_000;

pub(super) fn send(feed: &ReferenceFeed, position_m: [f64; 3]) -> Result<Header> {
    let now_ns = monotonic_ns();
    let point = |after_ns: u64| ReferencePoint {
        time_ns: now_ns + after_ns,
        position_m,
        ..ReferencePoint::default()
    };
    let points = [point(BEGINS_NS), point(ENDS_NS)];
    Ok(feed.send(ChunkMode::Replace, Interpolation::Linear, &points)?)
}

pub(super) fn length_m(watcher: &Watcher) -> f64 {
    section_lengths_m(&watcher.status.robot).iter().sum()
}

/// Positions on a small circle in turn, scaled to the robot's length: the robot always has some work.
pub(super) fn on_circle(index: usize, length_m: f64) -> [f64; 3] {
    let (sin, cos) = (0.1 * index as f64).sin_cos();
    [0.2 * length_m * cos, 0.2 * length_m * sin, 0.7 * length_m]
}

pub(super) fn aside(index: usize, length_m: f64) -> [f64; 3] {
    let side = if index.is_multiple_of(2) { 0.4 } else { -0.4 };
    [side * length_m, 0.1 * length_m, 0.5 * length_m]
}

/// Takes the lease and starts tracking. With a driver, measurements are sent meanwhile: the daemon needs one
/// before it holds the robot, and takes silence for a fault.
pub(super) fn follow(watcher: &mut Watcher, driver: Option<&Sender>) -> Result<ReferenceFeed> {
    let measure = |watcher: &mut Watcher| -> Result<()> {
        interrupt::check()?;
        driver.map_or(Ok(()), |source| source.send(0, watcher).map(|_| ()))
    };
    let deadline = Instant::now() + TIMEOUT;
    while watcher.connection.status(TIMEOUT)?.mode == Mode::Starting.code() {
        let in_time = Instant::now() < deadline;
        ensure!(in_time, "the daemon does not see the robot of its driver");
        measure(watcher)?;
        // With real time, this thread has priority over the thread that sends the status.
        thread::sleep(ASK_AGAIN);
    }
    watcher.connection.request(RequestKind::AcquireLease)?;
    let feed = watcher.connection.reference_feed()?;
    send(&feed, on_circle(0, length_m(watcher)))?;
    loop {
        measure(watcher)?;
        match watcher.connection.request(RequestKind::Track) {
            Ok(_) => return Ok(feed),
            // The reference comes with the next gather.
            Err(RequestError::Refused {
                outcome: Outcome::NoReference,
                ..
            }) if Instant::now() < deadline => thread::sleep(ASK_AGAIN),
            Err(error) => {
                let why = Reason::text_of(watcher.connection.status(TIMEOUT)?.reason);
                return Err(error).context(format!("the robot shall follow a reference ({why})"));
            }
        }
    }
}
