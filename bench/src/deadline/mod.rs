//! Deadline misses and latencies of the daemon under named loads, next to a baseline of the machine.

mod report;
mod stretch;
mod tally;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use cdcr_shared_types::parse_duration;
use clap::ValueEnum;
use serde_json::json;

pub use stretch::Subject;

use crate::benchmark::Benchmark;
use crate::dataset::Dataset;
use crate::interrupt;
use crate::load::Load;
use crate::named::named;
use crate::progress::Progress;
use crate::system::cores::Cores;
use crate::system::thread::may_be_realtime;
use report::{Cases, Key};
use stretch::Runner;

/// Uncounted time at the beginning of a stretch, in which memory is mapped and caches fill.
pub const WARM_UP: Duration = Duration::from_secs(1);
const AROUND_S: f64 = 1.2;

named! {
    pub enum Setup {
        Realtime = "realtime",
        Ordinary = "ordinary",
    }
}

#[derive(Debug, Clone, PartialEq, clap::Args)]
pub struct DeadlineOptions {
    /// Total measured time per subject and load, over all rounds.
    #[arg(long, default_value = "60s", value_parser = parse_duration)]
    pub duration: Duration,
    /// Loads on the cores of the client, comma-separated [default: all but stress-ng,
    /// one after the other].
    #[arg(long, value_enum, value_delimiter = ',', value_name = "LOAD")]
    pub load: Vec<Load>,
    /// Rounds, 1 to 1000: each runs every subject once under every load.
    #[arg(long, default_value_t = 6, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub rounds: u32,
    /// Period of the loop [default: as configured].
    #[arg(long, value_parser = parse_duration)]
    pub period: Option<Duration>,
    /// Configuration of the daemon [default: three sections].
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Set-up of the threads.
    #[arg(long, value_enum, default_value_t = Setups::Both)]
    pub setup: Setups,
    #[arg(skip)]
    quick: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Setups {
    /// Real time under every load, and ordinary threads under the loads that show the difference best.
    Both,
    /// Only real time.
    Realtime,
    /// Only ordinary threads.
    Ordinary,
}

impl DeadlineOptions {
    pub fn segment(&self) -> Duration {
        self.duration / self.rounds.max(1)
    }

    /// Keys of a round in the order of measurement: each round begins with another subject.
    fn stretches(&self, is_realtime: bool, round: u32) -> Vec<Key> {
        let mut keys = Vec::new();
        for setup in Setup::ALL {
            let mut subjects = Subject::in_setup(setup);
            let count = subjects.len();
            subjects.rotate_left((round - 1) as usize % count);
            for load in self.loads(setup) {
                let key = |subject| Key {
                    setup,
                    load,
                    subject,
                };
                keys.extend(subjects.iter().copied().map(key));
            }
        }
        keys.retain(|key| is_realtime || key.setup == Setup::Ordinary);
        keys
    }

    fn loads(&self, setup: Setup) -> Vec<Load> {
        let usual: &[Load] = match (setup, self.setup, self.quick) {
            (Setup::Realtime, Setups::Ordinary, _) | (Setup::Ordinary, Setups::Realtime, _) => &[],
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
    const HAS_CONFIG: bool = true;

    fn quicken(&mut self) {
        (self.duration, self.rounds, self.quick) = (Duration::from_secs(4), 2, true);
    }

    fn check(&self) -> Result<()> {
        ensure!(
            self.setup != Setups::Realtime || may_be_realtime(),
            "this user has no permission for real-time threads: see docs/realtime.md, or use --setup ordinary"
        );
        ensure!(
            self.segment() >= Duration::from_secs(1),
            "{:?} in {} rounds is less than a second per round: use a longer --duration or fewer --rounds",
            self.duration,
            self.rounds
        );
        Ok(())
    }

    fn expected_s(&self) -> f64 {
        let stretches = self.rounds as usize * self.stretches(may_be_realtime(), 1).len();
        stretches as f64 * ((self.segment() + WARM_UP).as_secs_f64() + AROUND_S)
    }

    fn run(&self, progress: &mut Progress) -> Result<Dataset> {
        for load in Setup::ALL.iter().flat_map(|setup| self.loads(*setup)) {
            load.is_available()?;
        }
        let cores = Cores::find()?;
        cores.stay_off();
        let runner = Runner::new(self, cores)?;
        let is_realtime = self.setup != Setups::Ordinary && runner.may_be_realtime();
        let begin = Instant::now();
        let (mut cases, mut failures) = (Cases::new(), Vec::new());
        for round in 1..=self.rounds {
            for key in self.stretches(is_realtime, round) {
                let names = [key.load.name(), key.setup.name(), key.subject.name()].join(", ");
                let what = format!("round {round} of {}, load {names}", self.rounds);
                progress.begin(&what);
                let start = Instant::now();
                // A failed stretch is repeated once, and the failure is reported. A long stall must not
                // discard half an hour of measurements.
                let measure = || runner.run(key);
                let tally = measure().or_else(|failure| {
                    interrupt::check()?;
                    failures.push(format!("{what}: {failure:#}"));
                    measure()
                })?;
                let start_s = (start - begin).as_secs_f64();
                let of_round = json!({ "round": round, "start_s": start_s });
                cases.entry(key).or_default().push(key, of_round, tally);
                progress.advance(start.elapsed().as_secs_f64());
            }
        }
        let period_ms = runner.period.as_secs_f64() * 1e3;
        let mut dataset = report::dataset(&cases, self, 1e3 * period_ms)?;
        dataset.fact("period_ms", period_ms);
        dataset.fact("realtime_granted", is_realtime);
        dataset.fact("measured_again", failures);
        Ok(dataset)
    }
}
