//! One daemon from its start to its end: what it takes, idle and tracking.

use std::time::{Duration, Instant};

use anyhow::Result;
use serde::Serialize;

use super::memory::{Files, Memory};
use super::start::{Start, start};
use crate::interrupt;
use crate::subject::daemon::{Daemon, Launch};
use crate::subject::tracking::Tracking;
use crate::system::cores::Cores;
use crate::system::counts::threads;

/// Between a change and what is measured after it.
pub(super) const SETTLE: Duration = Duration::from_millis(500);
/// The threads of the real-time core.
pub(super) const CORE_THREADS: [&str; 2] = ["cdcr-cycle", "cdcr-exchange"];

/// What one daemon took.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Round {
    /// How long its start took.
    pub start: Start,
    /// Its threads.
    pub threads: Vec<ThreadUse>,
    /// When it controlled its robot, before any client came.
    pub after_start: Memory,
    /// When its robot followed a client's reference.
    pub before_tracking: Memory,
    /// At the end of the tracking.
    pub after_tracking: Memory,
    /// Its files in shared memory, those of the tracking client among them.
    pub shared_memory: Files,
    /// Its files below the root folder, those of the tracking client among them.
    pub root: Files,
}

/// Share of one core that a thread used.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ThreadUse {
    /// Its name.
    pub name: String,
    /// While the robot held its position, without any client \[%\].
    pub idle_percent: f64,
    /// While the robot followed a reference \[%\].
    pub tracking_percent: f64,
}

impl Round {
    /// Starts a daemon and measures it for so long, idle and tracking.
    ///
    /// # Errors
    /// When it does not start or does not follow, or a signal came.
    pub fn run(launch: &Launch, cores: &Cores, idle: Duration, tracking: Duration) -> Result<Self> {
        let (daemon, start) = start(launch, cores)?;
        let measured = measure(&daemon, cores, idle, tracking, start);
        daemon.stop().and(measured)
    }

    /// What the real-time core spent while tracking \[%\].
    pub fn core_tracking_percent(&self) -> f64 {
        self.core(|thread| thread.tracking_percent)
    }

    /// What the real-time core spent without a client \[%\].
    pub fn core_idle_percent(&self) -> f64 {
        self.core(|thread| thread.idle_percent)
    }

    fn core(&self, percent: fn(&ThreadUse) -> f64) -> f64 {
        let all = self.threads.iter();
        all.filter(|thread| CORE_THREADS.contains(&thread.name.as_str()))
            .map(percent)
            .sum()
    }

    /// Resident memory that came while the robot tracked \[bytes\].
    pub fn growth_bytes(&self) -> f64 {
        self.after_tracking.resident_bytes as f64 - self.before_tracking.resident_bytes as f64
    }

    /// Resident memory that came when a client connected and the robot began to follow \[bytes\].
    pub fn growth_by_client_bytes(&self) -> f64 {
        self.before_tracking.resident_bytes as f64 - self.after_start.resident_bytes as f64
    }

    /// Page faults of all threads while the robot tracked.
    pub fn faults(&self) -> u64 {
        self.after_tracking
            .faults()
            .saturating_sub(self.before_tracking.faults())
    }
}

fn measure(
    daemon: &Daemon,
    cores: &Cores,
    idle: Duration,
    tracking: Duration,
    start: Start,
) -> Result<Round> {
    interrupt::sleep(SETTLE)?;
    let after_start = Memory::of(daemon.id())?;
    let idle_percent = watch(daemon, idle)?;

    let client = Tracking::start(daemon.location(), cores.client())?;
    interrupt::sleep(SETTLE)?;
    let before_tracking = Memory::of(daemon.id())?;
    let tracking_percent = watch(daemon, tracking)?;
    let after_tracking = Memory::of(daemon.id())?;
    let shared_memory = Files::of(&daemon.place().memory_files());
    let root = Files::below(daemon.location().root());
    client.stop()?;

    let threads = tracking_percent.into_iter().map(|(name, percent)| {
        let idle = idle_percent.iter().find(|(idle, _)| *idle == name);
        ThreadUse {
            idle_percent: idle.map_or(0.0, |(_, percent)| *percent),
            tracking_percent: percent,
            name,
        }
    });
    Ok(Round {
        start,
        threads: threads.collect(),
        after_start,
        before_tracking,
        after_tracking,
        shared_memory,
        root,
    })
}

/// Share of a core that each thread uses in the time to come \[%\]. Threads of one name are added up.
fn watch(daemon: &Daemon, length: Duration) -> Result<Vec<(String, f64)>> {
    let (before, begin) = (threads(daemon.id()), Instant::now());
    interrupt::sleep(length)?;
    let (after, passed) = (threads(daemon.id()), begin.elapsed());
    let mut all: Vec<(String, f64)> = Vec::new();
    for thread in after {
        let began = before.iter().find(|old| old.id == thread.id);
        let used_ns = thread.on_core_ns - began.map_or(0, |old| old.on_core_ns);
        let percent = 100.0 * used_ns as f64 / passed.as_nanos().max(1) as f64;
        match all.iter_mut().find(|(name, _)| *name == thread.name) {
            Some((_, sum)) => *sum += percent,
            None => all.push((thread.name, percent)),
        }
    }
    Ok(all)
}
