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

use std::collections::btree_map::Entry;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
pub use case::{Case, Cases, Key, Round};
pub use observer::{Observed, Observer};
pub use ratio::{Ratio, misses_p_value, ratios};
pub use segment::{Runner, Segment, Subject};
pub use tally::{Counts, Tally, Times};

use crate::dataset::Dataset;
use crate::interrupt;
use crate::load::Load;
use crate::named::named;
use crate::progress::Progress;
use crate::subject::cyclictest::Cyclictest;
use crate::system::cores::Cores;
use crate::system::thread::may_be_realtime;

/// What is not counted at the beginning of a stretch: memory is mapped, caches fill.
pub const WARM_UP: Duration = Duration::from_secs(1);
/// What a stretch takes beside its cycles and its warm-up \[s\]: processes start and end.
const AROUND_S: f64 = 1.2;

named! {
    pub enum Setup {
        /// `SCHED_FIFO`, a core of their own, locked memory.
        Realtime = "realtime",
        /// None of it: what an ordinary process gets.
        Ordinary = "ordinary",
    }
}

#[derive(Debug, Clone, PartialEq)]
pub struct DeadlineOptions {
    /// Measured time of each subject under each load, all rounds together.
    pub duration: Duration,
    pub rounds: u32,
    pub loads: Vec<Load>,
    /// Loads without real time, a case of its own.
    pub ordinary_loads: Vec<Load>,
    /// Period of the loop \[ms\], if another one than the configuration's.
    pub period_ms: Option<f64>,
    /// Configuration of the daemon; none: the default, three sections.
    pub config: Option<PathBuf>,
}

impl Default for DeadlineOptions {
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

impl DeadlineOptions {
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

pub fn expected_s(options: &DeadlineOptions) -> f64 {
    let realtime = if may_be_realtime() {
        2 + usize::from(Cyclictest::find().is_some())
    } else {
        0
    };
    let loads = realtime * options.loads.len() + 2 * options.ordinary_loads.len();
    let segment_s = options.segment().as_secs_f64() + WARM_UP.as_secs_f64() + AROUND_S;
    segment_s * loads as f64 * f64::from(options.rounds)
}

pub fn run(options: &DeadlineOptions, progress: &mut Progress) -> Result<Dataset> {
    ensure!(options.rounds > 0, "at least one round is needed");
    for load in options.loads.iter().chain(&options.ordinary_loads) {
        load.is_available()?;
    }
    let cores = Cores::find()?;
    cores.stay_off();
    let runner = Runner::new(options, cores)?;
    let mut run = Run {
        begin: Instant::now(),
        is_realtime: !options.loads.is_empty() && runner.may_be_realtime(),
        runner,
        progress,
        cases: Cases::new(),
        failures: Vec::new(),
    };
    for round in 0..options.rounds {
        for key in run.stretches(options, round) {
            run.stretch(key, round, options.rounds)?;
        }
    }
    report::dataset(run, options)
}

struct Run<'a> {
    begin: Instant,
    runner: Runner<'a>,
    is_realtime: bool,
    progress: &'a mut Progress,
    cases: Cases,
    failures: Vec<String>,
}

impl Run<'_> {
    /// What a round measures, in this order: another subject comes first in each round.
    fn stretches(&self, options: &DeadlineOptions, round: u32) -> Vec<Key> {
        let mut keys = Vec::new();
        for (setup, loads) in options.setups() {
            if setup == Setup::Realtime && !self.is_realtime {
                continue;
            }
            let mut subjects = self.runner.subjects(setup);
            let count = subjects.len();
            subjects.rotate_left(round as usize % count);
            for load in loads {
                let key = |subject: &Subject| Key {
                    setup,
                    load: *load,
                    subject: *subject,
                };
                keys.extend(subjects.iter().map(key));
            }
        }
        keys
    }

    /// Measures one stretch. One that fails is measured once more: a machine may stall for longer than a process
    /// can bear, and half an hour of measurements is not to be lost by that. It is told.
    fn stretch(&mut self, key: Key, round: u32, rounds: u32) -> Result<()> {
        let names = [key.load.name(), key.setup.name(), key.subject.name()].join(", ");
        let what = format!("round {} of {rounds}, load {names}", round + 1);
        self.progress.begin(&what);
        let start = Instant::now();
        let measure = || self.runner.run(key.subject, key.load, key.setup);
        let segment = measure().or_else(|failure| {
            interrupt::check()?;
            self.failures.push(format!("{what}: {failure:#}"));
            measure()
        })?;
        let start_s = (start - self.begin).as_secs_f64();
        let case = match self.cases.entry(key) {
            Entry::Vacant(free) => free.insert(Case::new(key)?),
            Entry::Occupied(known) => known.into_mut(),
        };
        case.push(Round { start_s, segment })?;
        self.progress.advance(start.elapsed().as_secs_f64());
        Ok(())
    }
}
