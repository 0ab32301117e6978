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

use anyhow::Result;

pub use memory::{Files, Memory};
pub use round::{Round, ThreadUse};
pub use start::Start;

use crate::dataset::Dataset;
use crate::progress::Progress;
use crate::subject::daemon::Launch;
use crate::system::cores::Cores;
use crate::system::thread::may_be_realtime;

/// Share of the time of tracking that is measured without a client, too.
const IDLE_SHARE: f64 = 0.4;
/// What start, begin of tracking, warm-up and end take, about \[s\].
const AROUND_S: f64 = 2.3;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FootprintOptions {
    /// Daemons that are measured one after the other.
    pub rounds: u32,
    pub tracking: Duration,
}

impl FootprintOptions {
    pub fn full() -> Self {
        Self {
            rounds: 5,
            tracking: Duration::from_secs(10),
        }
    }

    /// A look of about ten seconds, no measurement.
    pub fn quick() -> Self {
        Self {
            rounds: 2,
            tracking: Duration::from_secs(2),
        }
    }

    fn idle(&self) -> Duration {
        self.tracking.mul_f64(IDLE_SHARE)
    }

    fn round_s(&self) -> f64 {
        self.tracking.as_secs_f64() + self.idle().as_secs_f64() + AROUND_S
    }
}

/// How long [`run`] takes, about \[s\].
pub fn expected_s(options: &FootprintOptions) -> f64 {
    f64::from(options.rounds) * options.round_s()
}

pub fn run(options: &FootprintOptions, progress: &mut Progress) -> Result<Dataset> {
    let cores = Cores::find()?;
    cores.stay_off();
    let realtime = may_be_realtime();
    let launch = Launch::patient(None).placed(&cores, realtime);
    let mut rounds = Vec::new();
    for round in 1..=options.rounds {
        progress.begin(&format!("daemon {round} of {}", options.rounds));
        rounds.push(Round::run(
            &launch,
            &cores,
            options.idle(),
            options.tracking,
        )?);
        progress.advance(options.round_s());
    }
    report::dataset(&rounds, realtime)
}
