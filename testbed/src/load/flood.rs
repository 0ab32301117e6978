//! Clients that send far more than a daemon can use.

use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use cdcr_client::{Connection, ReferenceFeed, monotonic_ns};
use cdcr_shared_types::codes::{ChunkMode, Interpolation};
use cdcr_shared_types::limits::CHUNK_POINTS_MAX;
use cdcr_shared_types::{Location, Obstacle, ReferencePoint};

use super::Done;
use super::rate::every;
use super::task::Signals;
use crate::subject::ROBOT;

pub const PERIOD: Duration = Duration::from_micros(100);
/// Half in tests, because one test waits for it.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(if cfg!(test) { 5 } else { 10 });
/// Number of obstacles in the flood. Small, because the load measures the cost of messages, not of a crowded
/// scene: each obstacle costs the solver and the guard about 0.3 µs at any distance.
const OBSTACLES: u32 = 4;
/// Distance from the robot's base \[m\], out of reach of every robot.
const AWAY_M: f64 = 50.0;

/// Sends reference chunks without the lease. The daemon refuses those that it reads; the rest overflows its
/// queue.
pub(super) fn references(target: &Location, signals: &Signals) -> Result<Done> {
    let mut done = Done::default();
    let Some(connection) = connect(target, signals)? else {
        return Ok(done);
    };
    let feed = connection.reference_feed()?;
    signals.works();
    send_references(&feed, || signals.is_ending(), || done.chunks += 1)?;
    Ok(done)
}

/// Sends 10 000 chunks of references per second, which begin in a second, and reports each.
pub fn send_references(
    feed: &ReferenceFeed,
    is_ending: impl Fn() -> bool,
    mut sent: impl FnMut(),
) -> Result<()> {
    let mut points = [ReferencePoint::default(); CHUNK_POINTS_MAX];
    every(PERIOD, is_ending, || {
        let begin_ns = monotonic_ns() + 1_000_000_000;
        for (index, point) in points.iter_mut().enumerate() {
            point.time_ns = begin_ns + index as u64 * 1_000_000;
            point.position_m = [0.0, 0.0, 0.8];
        }
        feed.send(ChunkMode::Replace, Interpolation::Cubic, &points)?;
        sent();
        Ok(())
    })
}

/// Sends obstacle updates. The daemon accepts what its queue and its gather hold; the rest overflows. The
/// obstacles are out of reach, so they add no work to the solver.
pub(super) fn obstacles(target: &Location, signals: &Signals) -> Result<Done> {
    let mut done = Done::default();
    let Some(connection) = connect(target, signals)? else {
        return Ok(done);
    };
    let sender = connection.obstacle_sender()?;
    let mut turn = 0_u32;
    signals.works();
    every(
        PERIOD,
        || signals.is_ending(),
        || {
            turn = turn.wrapping_add(1);
            sender.upsert_anywhere(&[ball(turn)])?;
            done.updates += 1;
            Ok(())
        },
    )?;
    Ok(done)
}

fn ball(turn: u32) -> Obstacle {
    let shift_m = 0.05 * f64::from(turn % 100) / 100.0;
    Obstacle {
        id: turn % OBSTACLES,
        start_m: [AWAY_M + shift_m, 0.0, 0.0],
        radius_m: 0.02,
        velocity_m_s: [0.1, 0.0, 0.0],
        measured_ns: monotonic_ns(),
        // Short, so that the obstacles expire soon after the flood.
        lifetime_ns: 200_000_000,
        ..Obstacle::default()
    }
}

/// Connects, with several attempts on a busy machine. `None` when the load ends first.
fn connect(target: &Location, signals: &Signals) -> Result<Option<Connection>> {
    let deadline = Instant::now() + CONNECT_TIMEOUT;
    while !signals.is_ending() {
        match Connection::open(target, ROBOT) {
            Ok(connection) => return Ok(Some(connection)),
            Err(error) if Instant::now() >= deadline => bail!(error),
            Err(_) => thread::sleep(Duration::from_millis(20)),
        }
    }
    Ok(None)
}
