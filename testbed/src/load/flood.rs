//! Clients that send far more than a daemon can use.

use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use cdcr_client::{Connection, monotonic_ns};
use cdcr_shared_types::codes::{ChunkMode, Interpolation};
use cdcr_shared_types::limits::CHUNK_POINTS_MAX;
use cdcr_shared_types::{Location, Obstacle, ReferencePoint};

use super::Done;
use super::rate::every;
use super::task::Signals;
use crate::subject::ROBOT;

const PERIOD: Duration = Duration::from_micros(100);
/// Half of it in tests, one of which waits for it.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(if cfg!(test) { 5 } else { 10 });
/// Obstacles of the flood. A few: what is to be measured is what messages cost, and not a crowded scene, which
/// costs the solver and the guard about 0.3 µs for each obstacle, wherever it is.
const OBSTACLES: u32 = 4;
/// From the base of the robot \[m\]: out of reach of any.
const AWAY_M: f64 = 50.0;

/// Reference chunks of a client that holds no lease: the daemon refuses those that it looks at, and the rest
/// overflows its queue.
pub(super) fn references(target: &Location, signals: &Signals) -> Result<Done> {
    let mut done = Done::default();
    let Some(connection) = connect(target, signals)? else {
        return Ok(done);
    };
    let feed = connection.reference_feed()?;
    let mut points = [ReferencePoint::default(); CHUNK_POINTS_MAX];
    signals.works();
    every(
        PERIOD,
        || signals.is_ending(),
        || {
            let begin_ns = monotonic_ns() + 1_000_000_000;
            for (index, point) in points.iter_mut().enumerate() {
                point.time_ns = begin_ns + index as u64 * 1_000_000;
                point.position_m = [0.0, 0.0, 0.8];
            }
            feed.send(ChunkMode::Replace, Interpolation::Cubic, &points)?;
            done.chunks += 1;
            Ok(())
        },
    )?;
    Ok(done)
}

/// Obstacle updates: the daemon takes in what its queue and its gather hold, and the rest overflows; the robot
/// cannot come near, so the solver has no more to do.
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
            sender.upsert(&[ball(turn)])?;
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
        // What is not sent again is soon forgotten.
        lifetime_ns: 200_000_000,
        ..Obstacle::default()
    }
}

/// None when the load ends before. On a machine that is busy with the rest of the load it may take some tries.
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
