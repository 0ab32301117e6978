//! Deadline misses and latencies of the daemon beside what the machine can do, under named loads.
//!
//! A round runs, for every load, a bare loop, the daemon, and cyclictest where it is installed, one after the
//! other; the next round begins with another of them. So what the machine does of itself meets all of them
//! alike, and the spread of the rounds says how far a difference can be believed.

mod case;
mod observer;
mod ratio;
mod report;
mod segment;
mod tally;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
pub use case::{Case, Cases, Key, Round, Row};
pub use observer::{Observed, Observer};
pub use ratio::{Ratio, ratios};
pub use report::Report;
pub use segment::{Runner, Segment, Subject};
use serde::Serialize;
pub use tally::{Causes, Counts, Tally, Times};

use crate::load::Load;
use crate::progress::Progress;
use crate::system::cores::Cores;
use crate::system::thread::may_be_realtime;

/// What is not counted at the beginning of a stretch: memory is mapped, caches fill.
pub const WARM_UP: Duration = Duration::from_secs(1);
/// What a stretch takes beside its cycles and its warm-up \[s\]: processes start and end.
const AROUND_S: f64 = 1.2;

/// How the threads were set up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Setup {
    /// `SCHED_FIFO`, a core of their own, locked memory.
    Realtime,
    /// None of it: what an ordinary process gets.
    Ordinary,
}

impl Setup {
    /// In a word.
    pub fn name(self) -> &'static str {
        match self {
            Self::Realtime => "realtime",
            Self::Ordinary => "ordinary",
        }
    }
}

/// What is to be measured.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Measured time of each subject under each load, all rounds together.
    pub duration: Duration,
    /// Rounds, at least 1.
    pub rounds: u32,
    /// Loads with real time.
    pub loads: Vec<Load>,
    /// Loads without real time, a case of its own.
    pub ordinary_loads: Vec<Load>,
    /// Period of the loop \[ms\], if another one than the configuration's.
    pub period_ms: Option<f64>,
    /// Configuration of the daemon; none: the default, three sections.
    pub config: Option<PathBuf>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            duration: Duration::from_secs(60),
            rounds: 6,
            loads: Load::OWN.to_vec(),
            ordinary_loads: vec![Load::None, Load::CpuEverywhere],
            period_ms: None,
            config: None,
        }
    }
}

impl Options {
    /// A look that takes a minute and proves little.
    pub fn quick() -> Self {
        Self {
            duration: Duration::from_secs(4),
            rounds: 2,
            loads: vec![Load::None, Load::Flood],
            ordinary_loads: vec![Load::None],
            ..Self::default()
        }
    }

    /// Measured time of one stretch.
    pub fn segment(&self) -> Duration {
        self.duration / self.rounds.max(1)
    }

    fn setups(&self) -> [(Setup, &[Load]); 2] {
        [
            (Setup::Realtime, &self.loads),
            (Setup::Ordinary, &self.ordinary_loads),
        ]
    }
}

/// About how long a measurement takes \[s\].
pub fn expected_s(options: &Options) -> f64 {
    let loads = 3 * options.loads.len() + 2 * options.ordinary_loads.len();
    let segment_s = options.segment().as_secs_f64() + WARM_UP.as_secs_f64() + AROUND_S;
    segment_s * loads as f64 * f64::from(options.rounds)
}

/// Measures.
///
/// # Errors
/// When a process or a load fails, or the configuration is bad.
pub fn run(options: &Options, progress: &mut Progress) -> Result<Report> {
    ensure!(options.rounds > 0, "at least one round is needed");
    for load in options.loads.iter().chain(&options.ordinary_loads) {
        load.is_available()?;
    }
    let cores = Cores::find()?;
    cores.stay_off();
    let begin = Instant::now();
    let runner = Runner::new(options, cores.clone())?;
    let is_realtime = may_be_realtime();
    let mut cases = Cases::new();
    for round in 0..options.rounds {
        for (setup, loads) in options.setups() {
            if setup == Setup::Realtime && !is_realtime {
                continue;
            }
            for load in loads {
                let mut subjects = runner.subjects(setup);
                let count = subjects.len();
                subjects.rotate_left(round as usize % count);
                for subject in subjects {
                    let key = Key {
                        setup,
                        load: *load,
                        subject,
                    };
                    progress.begin(&format!(
                        "round {} of {}, load {}, {}, {}",
                        round + 1,
                        options.rounds,
                        load.name(),
                        setup.name(),
                        subject.name()
                    ));
                    let start = Instant::now();
                    let start_s = (start - begin).as_secs_f64();
                    let segment = runner.run(subject, *load, setup)?;
                    let case = match cases.entry(key) {
                        std::collections::btree_map::Entry::Vacant(free) => {
                            free.insert(Case::new(key)?)
                        }
                        std::collections::btree_map::Entry::Occupied(known) => known.into_mut(),
                    };
                    case.push(Round { start_s, segment })?;
                    progress.advance(start.elapsed().as_secs_f64());
                }
            }
        }
    }
    Ok(Report::new(cases, runner.period(), is_realtime, options))
}
