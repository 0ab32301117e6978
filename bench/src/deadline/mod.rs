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
use clap::ValueEnum;

pub use case::{Case, Cases, Key, Round};
pub use observer::{Observed, Observer};
pub use ratio::{Ratio, misses_p_value, ratios};
pub use segment::{Runner, Segment, Subject};
pub use tally::{Counts, Tally};

use crate::benchmark::{Benchmark, defaults};
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

#[derive(Debug, Clone, PartialEq, clap::Args)]
pub struct DeadlineOptions {
    /// Measured time of each subject under each load, all rounds together.
    #[arg(long, default_value = "60s", value_parser = humantime::parse_duration)]
    pub duration: Duration,
    /// What else the machine does meanwhile, on the cores of the client; several with commas. Without this
    /// option, every load but stress-ng, one after the other.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "LOAD")]
    pub load: Vec<Load>,
    /// Rounds, in each of which every subject runs once under every load, 1 to 1000.
    #[arg(long, default_value_t = 6, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub rounds: u32,
    /// Period of the loop, if another one than the configuration's.
    #[arg(long, value_parser = humantime::parse_duration)]
    pub period: Option<Duration>,
    /// Configuration of the daemon; without it the default, three sections.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Which set-up of the threads.
    #[arg(long, value_enum, default_value_t = Setups::Both)]
    pub setup: Setups,
    #[arg(skip)]
    quick: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Setups {
    /// Real time under every load, and without it under the loads that show the difference best.
    Both,
    /// Only with real time.
    Realtime,
    /// Only without.
    Ordinary,
}

impl DeadlineOptions {
    pub fn segment(&self) -> Duration {
        self.duration / self.rounds.max(1)
    }

    /// The loads of a set-up; none when it is not measured.
    fn loads(&self, setup: Setup) -> Vec<Load> {
        let usual: &[Load] = match (setup, self.setup, self.quick) {
            (Setup::Realtime, Setups::Ordinary, _) | (Setup::Ordinary, Setups::Realtime, _) => {
                return Vec::new();
            }
            _ if !self.load.is_empty() => &self.load,
            (Setup::Realtime, _, false) => &Load::OWN,
            (Setup::Realtime, _, true) => &[Load::None, Load::Flood],
            (Setup::Ordinary, _, false) => &[Load::None, Load::CpuEverywhere],
            (Setup::Ordinary, _, true) => &[Load::None],
        };
        usual.to_vec()
    }
}

impl Benchmark for DeadlineOptions {
    /// Quick: a look that takes a minute and proves little.
    fn of_report(quick: bool) -> Self {
        let all: Self = defaults();
        if !quick {
            return all;
        }
        Self {
            duration: Duration::from_secs(4),
            rounds: 2,
            quick,
            ..all
        }
    }

    fn rounds_mut(&mut self) -> &mut u32 {
        &mut self.rounds
    }

    fn config_mut(&mut self) -> Option<&mut Option<PathBuf>> {
        Some(&mut self.config)
    }

    fn resolved(self) -> Result<Self> {
        ensure!(
            self.setup != Setups::Realtime || may_be_realtime(),
            "this user may not have real-time threads: see docs/realtime.md, or measure with --setup ordinary"
        );
        ensure!(
            self.segment() >= Duration::from_secs(1),
            "{:?} in {} rounds is less than a second for each: take a longer --duration or fewer --rounds",
            self.duration,
            self.rounds
        );
        Ok(self)
    }

    fn expected_s(&self) -> f64 {
        let realtime = if may_be_realtime() {
            2 + usize::from(Cyclictest::find().is_some())
        } else {
            0
        };
        let [with, without] = Setup::ALL.map(|setup| self.loads(setup).len());
        let segment_s = self.segment().as_secs_f64() + WARM_UP.as_secs_f64() + AROUND_S;
        segment_s * (realtime * with + 2 * without) as f64 * f64::from(self.rounds)
    }

    fn run(&self, progress: &mut Progress) -> Result<Dataset> {
        for load in Setup::ALL.iter().flat_map(|setup| self.loads(*setup)) {
            load.is_available()?;
        }
        let cores = Cores::find()?;
        cores.stay_off();
        let runner = Runner::new(self, cores)?;
        let mut run = Run {
            begin: Instant::now(),
            is_realtime: self.setup != Setups::Ordinary && runner.may_be_realtime(),
            runner,
            progress,
            cases: Cases::new(),
            failures: Vec::new(),
        };
        for round in 0..self.rounds {
            for key in run.stretches(self, round) {
                run.stretch(key, round, self.rounds)?;
            }
        }
        report::dataset(run, self)
    }
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
        for setup in Setup::ALL {
            if setup == Setup::Realtime && !self.is_realtime {
                continue;
            }
            let mut subjects = self.runner.subjects(setup);
            let count = subjects.len();
            subjects.rotate_left(round as usize % count);
            for load in options.loads(setup) {
                let key = |subject: &Subject| Key {
                    setup,
                    load,
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
