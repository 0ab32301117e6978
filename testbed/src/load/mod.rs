//! Background load during a measurement, on threads of ordinary priority.
//!
//! | module | contents |
//! |---|---|
//! | `task` | one thread of a load, and its work |
//! | [`mod@done`] | work done by the load: evidence that it ran |
//! | `processor`, `memory`, `disk` | loads without a daemon |
//! | `visitors`, `flood` | loads on a daemon |
//! | `stress_ng` | the external program stress-ng |

mod disk;
pub mod done;
pub mod flood;
mod memory;
mod processor;
pub mod rate;
mod stress_ng;
mod task;
pub mod visitors;

use std::sync::Arc;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, bail, ensure};
use cdcr_shared_types::Location;
use clap::ValueEnum;
use serde::Serialize;

use crate::interrupt;
use crate::system::cores::Cores;
use crate::system::thread::pin;
pub use done::Done;
use task::{Signals, ThreadJob};

/// Time limit until all threads of a load work.
const START_TIMEOUT: Duration = Duration::from_secs(20);

/// What else runs while a loop is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, ValueEnum, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Load {
    /// No load.
    None,
    /// A computing thread on each core but the real-time one.
    Cpu,
    /// A thread on each core but the real-time one that copies more memory than the caches hold.
    Memory,
    /// A thread that writes a file of 64 MiB, syncs it every 4 MiB, and reads it back from the disk.
    Io,
    /// 30 clients per second that connect to the daemon and leave; every second one opens the telemetry.
    Clients,
    /// 10 000 reference chunks per second from a client without the lease, and 10 000 updates per second of obstacles
    /// out of reach. The daemon's queues hold 32 chunks and 16 updates, and one gather takes 8
    /// updates; the rest overflows. Received chunks are rejected, received updates accepted.
    Flood,
    /// Loads cpu, memory, io, clients and flood at once.
    All,
    /// Threads that compute and copy memory on every core, including the real-time one.
    CpuEverywhere,
    /// stress-ng, if installed: processor, memory and sync, on each core but the real-time one.
    StressNg,
}

impl Load {
    /// All loads that need no other program.
    pub const OWN: [Self; 8] = [
        Self::None,
        Self::Cpu,
        Self::Memory,
        Self::Io,
        Self::Clients,
        Self::Flood,
        Self::All,
        Self::CpuEverywhere,
    ];

    /// The parts of [`Load::All`].
    const PARTS: [Self; 5] = [
        Self::Cpu,
        Self::Memory,
        Self::Io,
        Self::Clients,
        Self::Flood,
    ];

    /// The name on the command line and in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Cpu => "cpu",
            Self::Memory => "memory",
            Self::Io => "io",
            Self::Clients => "clients",
            Self::Flood => "flood",
            Self::All => "all",
            Self::CpuEverywhere => "cpu-everywhere",
            Self::StressNg => "stress-ng",
        }
    }

    pub fn needs_daemon(self) -> bool {
        matches!(self, Self::Clients | Self::Flood | Self::All)
    }

    /// Fails, with the reason, when this machine cannot run the load.
    pub fn is_available(self) -> Result<()> {
        match self {
            Self::StressNg => stress_ng::program().map(|_| ()),
            _ => Ok(()),
        }
    }
}

/// A running load. Dropping it ends the load.
#[derive(Debug)]
pub struct RunningLoad {
    load: Load,
    signals: Arc<Signals>,
    threads: Vec<(&'static str, JoinHandle<Done>)>,
    /// Time from which all threads worked.
    ready: Option<Instant>,
}

impl RunningLoad {
    /// Starts the load and waits until all of its threads work. Call it from a thread of ordinary priority,
    /// which the threads inherit. `target`: the daemon for a load that [needs one](Load::needs_daemon).
    pub fn start(load: Load, cores: &Cores, target: Option<&Location>) -> Result<Self> {
        let tasks = task::tasks(load, cores, target)?;
        let count = tasks.len();
        let mut running = Self {
            load,
            signals: Arc::default(),
            threads: Vec::new(),
            ready: None,
        };
        for task in tasks {
            let signals = Arc::clone(&running.signals);
            let name = task.job.name();
            let thread = thread::Builder::new().name(name.to_owned());
            let handle = thread
                .spawn(move || carry_out(task, &signals))
                .with_context(|| format!("a thread for the load {name}"))?;
            running.threads.push((name, handle));
        }
        running.wait_until_ready(count)?;
        running.ready = Some(Instant::now());
        Ok(running)
    }

    /// The error of a thread that ended too early; the load is then invalid.
    pub fn failure(&self) -> Option<anyhow::Error> {
        if let Some(failure) = self.signals.failure() {
            return Some(anyhow!("{failure}"));
        }
        let ended = self.threads.iter().find(|(_, thread)| thread.is_finished());
        ended.map(|(name, _)| anyhow!("the load {name} ended by itself"))
    }

    /// Ends the load and returns its counts.
    pub fn stop(mut self) -> Result<Done> {
        let done = self.end()?;
        let missing = done.missing(self.load);
        ensure!(
            missing.is_empty(),
            "the load {} did nothing of this in {:.1} s: {}",
            self.load.name(),
            done.seconds,
            missing.join(", ")
        );
        Ok(done)
    }

    fn wait_until_ready(&self, count: usize) -> Result<()> {
        let deadline = Instant::now() + START_TIMEOUT;
        while self.signals.ready() < count {
            interrupt::check()?;
            if let Some(failure) = self.failure() {
                return Err(failure);
            }
            if Instant::now() >= deadline {
                let (ready, name) = (self.signals.ready(), self.load.name());
                let seconds = START_TIMEOUT.as_secs();
                bail!(
                    "only {ready} of {count} threads of the load {name} worked after {seconds} s"
                );
            }
            thread::sleep(Duration::from_millis(5));
        }
        Ok(())
    }

    fn end(&mut self) -> Result<Done> {
        let failed = self.failure();
        self.signals.end();
        let mut done = Done {
            seconds: self
                .ready
                .map_or(0.0, |ready| ready.elapsed().as_secs_f64()),
            ..Done::default()
        };
        let mut panicked = None;
        for (name, thread) in self.threads.drain(..) {
            match thread.join() {
                Ok(part) => done += part,
                Err(_) => panicked = Some(anyhow!("the load {name} panicked")),
            }
        }
        let late = || self.signals.failure().map(|failure| anyhow!("{failure}"));
        match panicked.or(failed).or_else(late) {
            Some(failure) => Err(failure),
            None => Ok(done),
        }
    }
}

impl Drop for RunningLoad {
    fn drop(&mut self) {
        // A load is only dropped without `stop` on the path of another error.
        let _ = self.end();
    }
}

fn carry_out(task: ThreadJob, signals: &Signals) -> Done {
    let ThreadJob { job, core } = task;
    let name = job.name();
    let result = match core {
        Some(core) if !pin(core) => Err(anyhow!("the system does not let it run on core {core}")),
        _ => job.run(signals),
    };
    result.unwrap_or_else(|error| {
        signals.fail(format!("the load {name}: {error:#}"));
        Done::default()
    })
}

#[cfg(test)]
mod tests;
