//! What a daemon takes: cores, memory, files, time to start.
//!
//! Each round starts a daemon with its defaults (200 Hz, three sections) for the times of its start, and a second
//! one: its memory is read when it says that it is ready, before any client connects; then it is measured without
//! a client, then while it tracks. All counts are the kernel's: time on a core from `/proc/PID/task/TID/schedstat`, memory
//! from `/proc/PID/status`.

mod memory;
mod quantity;
mod report;
mod round;
mod start;

use std::time::Duration;

use anyhow::{Result, ensure};

pub use memory::{Files, Memory};
pub use round::{Round, ThreadUse};
pub use start::Start;

use crate::benchmark::Benchmark;
use crate::dataset::Dataset;
use crate::progress::Progress;
use crate::subject::daemon::Launch;
use crate::system::cores::Cores;
use crate::system::thread::may_be_realtime;

/// Share of the time of tracking that is measured without a client, too.
const IDLE_SHARE: f64 = 0.4;
/// What start, begin of tracking, warm-up and end take, about \[s\].
const AROUND_S: f64 = 2.3;

/// Shorter than this the kernel's counts say little.
const LEAST: Duration = Duration::from_millis(100);
const MOST: Duration = Duration::from_secs(3600);

#[derive(Debug, Clone, Copy, PartialEq, clap::Args)]
pub struct FootprintOptions {
    /// Daemons that are measured one after the other, 1 to 100.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=100))]
    rounds: u32,
    /// How long each of them tracks, 100ms to 1h; without a client it is measured for two fifths of that.
    #[arg(long, default_value = "10s", value_parser = humantime::parse_duration)]
    duration: Duration,
    /// Two daemons for two seconds: a look of ten seconds instead of a measurement.
    #[arg(long, conflicts_with_all = ["rounds", "duration"])]
    quick: bool,
}

impl FootprintOptions {
    fn idle(&self) -> Duration {
        self.duration.mul_f64(IDLE_SHARE)
    }

    fn round_s(&self) -> f64 {
        self.duration.as_secs_f64() + self.idle().as_secs_f64() + AROUND_S
    }
}

impl Benchmark for FootprintOptions {
    fn of_report(quick: bool) -> Self {
        let (rounds, seconds) = if quick { (2, 2) } else { (5, 10) };
        Self {
            rounds,
            duration: Duration::from_secs(seconds),
            quick,
        }
    }

    fn rounds_mut(&mut self) -> &mut u32 {
        &mut self.rounds
    }

    fn resolved(self) -> Result<Self> {
        ensure!(
            (LEAST..=MOST).contains(&self.duration),
            "--duration must be 100ms to 1h"
        );
        Ok(if self.quick {
            Self::of_report(true)
        } else {
            self
        })
    }

    fn expected_s(&self) -> f64 {
        f64::from(self.rounds) * self.round_s()
    }

    fn run(&self, progress: &mut Progress) -> Result<Dataset> {
        let cores = Cores::find()?;
        cores.stay_off();
        let realtime = may_be_realtime();
        let launch = Launch::patient(None).placed(&cores, realtime);
        let mut rounds = Vec::new();
        for round in 1..=self.rounds {
            progress.begin(&format!("daemon {round} of {}", self.rounds));
            let (idle, tracking) = (self.idle(), self.duration);
            rounds.push(Round::run(&launch, &cores, idle, tracking)?);
            progress.advance(self.round_s());
        }
        report::dataset(&rounds, realtime)
    }
}
