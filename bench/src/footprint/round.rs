//! One daemon from its start to its end: what it takes, idle and tracking.

use std::time::{Duration, Instant};

use anyhow::Result;
use cdcr_shared_types::codes::realtime;
use serde::Serialize;

use super::memory::{Files, Memory};
use super::start::{Start, without_client};
use crate::interrupt;
use crate::subject::daemon::{Daemon, Launch};
use crate::subject::tracking::Tracking;
use crate::system::cores::Cores;
use crate::system::counts::{core_share, threads};

/// Between a change and what is measured after it.
const SETTLE: Duration = Duration::from_millis(500);
/// How long the daemon may take to send its status.
const STATUS_TIMEOUT: Duration = Duration::from_secs(2);
const CORE_THREADS: [&str; 2] = ["cdcr-cycle", "cdcr-exchange"];

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Round {
    /// How long the start of one like it took, which a client looked for meanwhile.
    pub start: Start,
    /// Its threads; none where the kernel does not count what they use.
    pub threads: Vec<ThreadUse>,
    /// Whether its memory was locked, as it says itself.
    pub memory_locked: bool,
    /// When it said `READY=1`; no client had connected yet.
    pub after_start: Memory,
    pub before_client: Memory,
    pub before_tracking: Memory,
    pub after_tracking: Memory,
    /// Its files in shared memory, those of the tracking client among them.
    pub shared_memory: Files,
    /// Its files below the root folder, those of the tracking client among them.
    pub root: Files,
}

/// Share of one core that a thread used.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ThreadUse {
    pub name: String,
    /// While the robot held its position, without any client \[%\].
    pub idle_percent: f64,
    pub tracking_percent: f64,
}

impl Round {
    /// Starts one daemon for the times of its start, and one that no client disturbs to measure it for so long, idle
    /// and tracking.
    pub fn run(launch: &Launch, cores: &Cores, idle: Duration, tracking: Duration) -> Result<Self> {
        let start = Start::measure(launch, cores)?;
        let daemon = without_client(launch, cores)?;
        let measured = measure(&daemon, cores, idle, tracking, start);
        daemon.stop().and(measured)
    }

    /// What the real-time core spent while tracking \[%\]; not a number where the kernel does not count it.
    pub fn core_tracking_percent(&self) -> f64 {
        self.core(|thread| thread.tracking_percent)
    }

    pub fn core_idle_percent(&self) -> f64 {
        self.core(|thread| thread.idle_percent)
    }

    fn core(&self, percent: fn(&ThreadUse) -> f64) -> f64 {
        self.sum(|thread| {
            let counts = CORE_THREADS.contains(&thread.name.as_str());
            if counts { percent(thread) } else { 0.0 }
        })
    }

    /// Of all threads; not a number where the kernel does not count what they use.
    pub fn sum(&self, percent: impl Fn(&ThreadUse) -> f64) -> f64 {
        if self.threads.is_empty() {
            return f64::NAN;
        }
        self.threads.iter().map(percent).sum()
    }

    /// Resident memory that came after the start, without any client \[bytes\].
    pub fn growth_idle_bytes(&self) -> f64 {
        self.before_client.resident_bytes as f64 - self.after_start.resident_bytes as f64
    }

    /// Resident memory that came while the robot tracked \[bytes\].
    pub fn growth_bytes(&self) -> f64 {
        self.after_tracking.resident_bytes as f64 - self.before_tracking.resident_bytes as f64
    }

    /// Resident memory that came when a client connected and the robot began to follow \[bytes\].
    pub fn growth_by_client_bytes(&self) -> f64 {
        self.before_tracking.resident_bytes as f64 - self.before_client.resident_bytes as f64
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
    let after_start = Memory::of(daemon.id())?;
    interrupt::sleep(SETTLE)?;
    let idle_percent = watch(daemon, idle)?;
    let before_client = Memory::of(daemon.id())?;

    let client = Tracking::start(daemon.location(), cores.client())?;
    interrupt::sleep(SETTLE)?;
    let before_tracking = Memory::of(daemon.id())?;
    let tracking_percent = watch(daemon, tracking)?;
    let after_tracking = Memory::of(daemon.id())?;
    let shared_memory = Files::of(&daemon.place().memory_files());
    let root = Files::below(daemon.location().root());
    let status = daemon.connect()?.status(STATUS_TIMEOUT)?;
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
        // Switched off, it is not asked for either.
        memory_locked: status.realtime_missing & (realtime::LOCKED | realtime::OFF) == 0,
        after_start,
        before_client,
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
    let mut names: Vec<String> = after.iter().map(|thread| thread.name.clone()).collect();
    names.sort();
    names.dedup();
    let with_percent = |name: String| {
        let percent = 100.0 * core_share(&before, &after, &name, passed);
        (name, percent)
    };
    Ok(names.into_iter().map(with_percent).collect())
}
