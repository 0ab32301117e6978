//! Load on a daemon: clients that connect and leave, floods, changes of settings, a driver with faults.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{PoisonError, RwLock};
use std::time::{Duration, Instant};

use cdcr_client::{Connection, FeedEvent, FeedOptions, ObstacleSender, Spiral, monotonic_ns};
use cdcr_shared_types::codes::{Interface, MeasurementKind, Mode, RequestKind};
use cdcr_shared_types::{Obstacle, SolverSettings, Telemetry};
pub use cdcr_testbed::load::visitors::COMERS;
use cdcr_testbed::load::{flood, rate, visitors};

use crate::robot::DrivenRobot;
use crate::{Place, ROBOT, TIMEOUT, ball};

/// Counts of the load, so that a test can check that it was present.
#[derive(Debug, Default)]
pub struct Done {
    /// Clients that connected and left.
    pub connections: AtomicU64,
    /// Reference chunks of the flood.
    pub chunks: AtomicU64,
    /// Obstacle updates of the flood.
    pub updates: AtomicU64,
    /// Changes of settings that the daemon accepted.
    pub settings: AtomicU64,
}

impl Done {
    /// The fraction 1/`part` of the nominal load in `seconds`.
    pub fn part_of(seconds: u64, part: u64) -> Self {
        Self {
            connections: (seconds * 30 / part).into(),
            chunks: (seconds * 10_000 / part).into(),
            updates: (seconds * 10_000 / part).into(),
            settings: 1.into(),
        }
    }

    /// Whether each count is at least that of `least`.
    pub fn reaches(&self, least: &Self) -> bool {
        let counts = |done: &Self| {
            [
                &done.connections,
                &done.chunks,
                &done.updates,
                &done.settings,
            ]
            .map(|count| count.load(Ordering::Relaxed))
        };
        counts(self)
            .iter()
            .zip(counts(least))
            .all(|(now, least)| *now >= least)
    }
}

/// Connects as soon as the daemon is up.
pub fn connect(place: &Place) -> Connection {
    Connection::open_within(place.location(), ROBOT, TIMEOUT).unwrap()
}

fn every(period: Duration, ending: &AtomicBool, mut work: impl FnMut()) {
    let is_ending = || ending.load(Ordering::Relaxed);
    let work = || {
        work();
        Ok(())
    };
    rate::every(period, is_ending, work).unwrap();
}

/// Clients that connect and leave, 30 times a second in total by [`COMERS`] threads; every second one opens the
/// telemetry. A writer of `gate` waits until all have left, and keeps them out.
pub fn come_and_go(place: &Place, gate: &RwLock<()>, ending: &AtomicBool, done: &Done) {
    let mut turn = 0_u32;
    every(visitors::PERIOD, ending, || {
        turn += 1;
        let _inside = gate.read().unwrap_or_else(PoisonError::into_inner);
        // The daemon may be ending.
        let granted = visitors::visit(place.location(), ROBOT, turn.is_multiple_of(2));
        done.connections
            .fetch_add(u64::from(granted), Ordering::Relaxed);
    });
}

/// Sends reference chunks at 10 kHz without the lease: all are rejected.
pub fn flood_references(place: &Place, ending: &AtomicBool, done: &Done) {
    let feed = connect(place).reference_feed().unwrap();
    let is_ending = || ending.load(Ordering::Relaxed);
    let sent = || _ = done.chunks.fetch_add(1, Ordering::Relaxed);
    flood::send_references(&feed, is_ending, sent).unwrap();
}

/// Sends obstacle updates at 10 kHz: a moving crowd that appears and expires.
pub fn flood_obstacles(place: &Place, ending: &AtomicBool, done: &Done) {
    let connection = connect(place);
    let obstacles = connection.obstacle_sender().unwrap();
    let mut turn = 0_u32;
    every(flood::PERIOD, ending, || {
        turn = turn.wrapping_add(1);
        let shift_m = 0.05 * f64::from(turn % 100) / 100.0;
        let moving = Obstacle {
            velocity_m_s: [0.1, 0.0, 0.0],
            lifetime_ns: 200_000_000,
            ..ball(turn % 60, [0.3 + shift_m, 0.2, 0.3])
        };
        obstacles.upsert(&[moving]).unwrap();
        done.updates.fetch_add(1, Ordering::Relaxed);
    });
}

/// Sends obstacle updates at 10 kHz, each rejected because of its last obstacle.
pub fn flood_bad_obstacles(place: &Place, ending: &AtomicBool) {
    let connection = connect(place);
    let sender = connection.obstacle_sender().unwrap();
    let mut obstacles: [Obstacle; 64] = core::array::from_fn(|index| Obstacle {
        id: index as u32,
        start_m: [1.0, 0.0, 0.3],
        ..Obstacle::default()
    });
    obstacles[63].radius_m = -1.0;
    every(flood::PERIOD, ending, || {
        sender.upsert(&obstacles).unwrap();
    });
}

/// A driver that measures bends or cables, and sometimes pauses for long enough to be a fault.
pub fn drive(place: &Place, ending: &AtomicBool) {
    let connection = connect(place);
    let mut robot = DrivenRobot::new(&connection, Interface::Velocity, [0.0; 12]);
    let mut turn = 0_u32;
    while !ending.load(Ordering::Relaxed) {
        turn += 1;
        robot.follow();
        robot.measure(if turn.is_multiple_of(2) {
            MeasurementKind::CableLengths
        } else {
            MeasurementKind::Configuration
        });
        let pause_ms = if turn.is_multiple_of(2000) { 150 } else { 1 };
        std::thread::sleep(Duration::from_millis(pause_ms));
    }
}

/// Balls and capsules near the tip.
fn around(record: &Telemetry) -> [Obstacle; 4] {
    let [x, y, z] = record.tip_position_m;
    core::array::from_fn(|i| {
        let id = i as u32;
        let apart_m = 0.05 + 0.01 * f64::from(id);
        Obstacle {
            id: 60 + id,
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

/// A client that uses all functions of a daemon in turn.
#[derive(Debug)]
pub struct Busy {
    pub connection: Connection,
    /// Received records of tracking cycles.
    pub tracked: u64,
    settings: SolverSettings,
    obstacles: ObstacleSender,
    turn: u64,
}

impl Busy {
    /// Connects.
    pub fn new(place: &Place) -> Self {
        let connection = connect(place);
        Self {
            settings: connection.status(TIMEOUT).unwrap().settings,
            obstacles: connection.obstacle_sender().unwrap(),
            connection,
            tracked: 0,
            turn: 0,
        }
    }

    /// Resets, changes settings, tracks a spiral of `duration_s` past obstacles, homes, holds and stops.
    pub fn turn(&mut self, duration_s: f64, done: &Done) {
        self.turn += 1;
        let connection = &self.connection;
        let _ = connection.request(RequestKind::Reset);
        let wanted = SolverSettings {
            swarm_size: if self.turn.is_multiple_of(2) { 6 } else { 20 },
            budget_ns: self.turn % 3 * 50_000,
            ..self.settings
        };
        // With floods on all sides, a request to try again is not a failure.
        let changed = connection.change_settings(wanted);
        done.settings
            .fetch_add(u64::from(changed.is_ok()), Ordering::Relaxed);
        let spiral = Spiral {
            duration_s,
            ..Spiral::for_sections(&[0.3; 3])
        };
        let options = FeedOptions {
            lead: Duration::from_millis(100),
            track: true,
            ..FeedOptions::default()
        };
        // A stall of the machine may end a feed early; the next turn feeds again.
        if let Ok(feed) = connection.feed(&spiral, options) {
            let _ = feed.run(|event| {
                if let FeedEvent::Record(record) = event {
                    self.tracked += u64::from(record.mode == Mode::Tracking.code());
                    if record.cycle.is_multiple_of(10) {
                        self.obstacles.upsert(&around(record)).unwrap();
                    }
                }
                ControlFlow::Continue(())
            });
        }
        for kind in [RequestKind::Home, RequestKind::Hold, RequestKind::Stop] {
            let _ = connection.request(kind);
        }
        let _ = connection.request(RequestKind::ResetStatistics);
    }

    pub fn cycles(&self) -> u64 {
        self.connection.status(TIMEOUT).unwrap().cycles
    }
}

/// Keeps a daemon busy until it has run `cycles`, and `done` has reached `least`. Returns the number of
/// cycles, and of records of tracking cycles.
pub fn keep_busy(place: &Place, cycles: u64, least: &Done, done: &Done) -> (u64, u64) {
    let begin = Instant::now();
    let mut busy = Busy::new(place);
    while busy.cycles() < cycles || busy.tracked <= cycles / 20 || !done.reaches(least) {
        busy.turn(2.0, done);
        let (ran, tracked) = (busy.cycles(), busy.tracked);
        assert!(
            begin.elapsed() < 5 * TIMEOUT,
            "{tracked} of {ran} cycles tracked, beside {done:?} instead of {least:?}"
        );
    }
    (busy.cycles(), busy.tracked)
}
