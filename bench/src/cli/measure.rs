//! The arguments of every benchmark, and what they ask for.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Result, ensure};
use cdcr_bench::dataset::Dataset;
use cdcr_bench::latency::baseline;
use cdcr_bench::progress::Progress;
use cdcr_bench::simulation::Effort;
use cdcr_bench::{budget, deadline, footprint, latency, quality, rate, robustness, solver};
use cdcr_shared_types::Location;
use cdcr_testbed::load::Load;
use cdcr_testbed::system::thread::may_be_realtime;
use clap::ValueEnum;

use super::output::Output;

/// What a command line asks of a benchmark.
pub(super) trait Arguments: clap::Args {
    type Options;

    fn options(&self) -> Result<Self::Options>;
}

/// The arguments of a benchmark, and what becomes of its result.
#[derive(Debug, clap::Args)]
pub(super) struct Measure<A: Arguments> {
    #[command(flatten)]
    arguments: A,
    #[command(flatten)]
    output: Output,
}

impl<A: Arguments> Measure<A> {
    pub(super) fn run(
        &self,
        expected_s: fn(&A::Options) -> f64,
        run: fn(&A::Options, &mut Progress) -> Result<Dataset>,
    ) -> Result<()> {
        let options = || self.arguments.options();
        self.output.measure(options, expected_s, run)
    }
}

#[derive(Debug, clap::Args)]
pub(super) struct Deadline {
    /// Measured time of each subject under each load, all rounds together.
    #[arg(long, default_value = "60s", value_parser = humantime::parse_duration)]
    duration: Duration,
    /// What else the machine does meanwhile, on the cores of the client; several with commas. Without this
    /// option, every load but stress-ng, one after the other.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "LOAD")]
    load: Vec<Load>,
    /// Rounds, in each of which every subject runs once under every load, 1 to 1000.
    #[arg(long, default_value_t = 6, value_parser = clap::value_parser!(u32).range(1..=1000))]
    rounds: u32,
    /// Period of the loop, if another one than the configuration's.
    #[arg(long, value_parser = humantime::parse_duration)]
    period: Option<Duration>,
    /// Configuration of the daemon; without it the default, three sections.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Which set-up of the threads.
    #[arg(long, value_enum, default_value_t = Setups::Both)]
    setup: Setups,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Setups {
    /// Real time under every load, and without it under the loads that show the difference best.
    Both,
    /// Only with real time.
    Realtime,
    /// Only without.
    Ordinary,
}

impl Arguments for Deadline {
    type Options = deadline::DeadlineOptions;

    fn options(&self) -> Result<Self::Options> {
        let default = deadline::DeadlineOptions::default();
        let chosen = |loads: Vec<Load>| {
            if self.load.is_empty() {
                loads
            } else {
                self.load.clone()
            }
        };
        let (loads, ordinary_loads) = match self.setup {
            Setups::Both => (chosen(default.loads), chosen(default.ordinary_loads)),
            Setups::Realtime => (chosen(default.loads), Vec::new()),
            Setups::Ordinary => (Vec::new(), chosen(default.ordinary_loads)),
        };
        ensure!(
            !ordinary_loads.is_empty() || may_be_realtime(),
            "this user may not have real-time threads: see docs/realtime.md, or measure with --setup ordinary"
        );
        let options = deadline::DeadlineOptions {
            duration: self.duration,
            rounds: self.rounds,
            loads,
            ordinary_loads,
            period_ms: self.period.map(|period| period.as_secs_f64() * 1e3),
            config: self.config.clone(),
        };
        let least = Duration::from_secs(1);
        ensure!(
            options.segment() >= least,
            "{:?} in {} rounds is less than a second for each: take a longer --duration or fewer --rounds",
            self.duration,
            self.rounds
        );
        Ok(options)
    }
}

#[derive(Debug, clap::Args)]
pub(super) struct Latency {
    /// Rounds, in each of which everything is measured once, 1 to 1000.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..=1000))]
    rounds: u16,
    /// Samples of each kind in each round, 5 to 10000; two fifths of that for stops, eight times that
    /// for iceoryx2 alone.
    #[arg(long, default_value_t = 250, value_parser = clap::value_parser!(u16).range(5..=10_000))]
    samples: u16,
    /// Period of the loop, if another one than the configuration's.
    #[arg(long, value_parser = humantime::parse_duration)]
    period: Option<Duration>,
    /// Configuration of the daemon; without it the default, three sections.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// A quick look: 2 rounds of 40 samples.
    #[arg(long, conflicts_with_all = ["rounds", "samples"])]
    quick: bool,
}

impl Arguments for Latency {
    type Options = latency::LatencyOptions;

    fn options(&self) -> Result<Self::Options> {
        let (rounds, samples) = if self.quick {
            latency::LatencyOptions::QUICK
        } else {
            (usize::from(self.rounds), usize::from(self.samples))
        };
        Ok(latency::LatencyOptions {
            rounds,
            samples,
            period: self.period,
            config: self.config.clone(),
        })
    }
}

#[derive(Debug, clap::Args)]
pub(super) struct Rate {
    /// How often the default is measured with each of its periods, 1 to 100. The search for the shortest periods
    /// is made once.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    rounds: u32,
    /// The default and its solvers only, in short trials: a look of half a minute instead of a measurement of
    /// five.
    #[arg(long, conflicts_with = "rounds")]
    quick: bool,
    /// Let the daemon wake up so long before each release and spin to it, 0 to 1000 µs; at most a quarter of the
    /// period.
    #[arg(long, value_name = "US", default_value_t = 0.0, value_parser = spin_us)]
    spin: f64,
}

fn spin_us(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "must be a number".to_owned())?;
    if (0.0..=1000.0).contains(&value) {
        Ok(value)
    } else {
        Err("must be 0 to 1000".to_owned())
    }
}

impl Arguments for Rate {
    type Options = rate::RateOptions;

    fn options(&self) -> Result<Self::Options> {
        let mut options = rate::RateOptions::full();
        options.rounds = self.rounds;
        if self.quick {
            options = rate::RateOptions::quick();
        }
        options.spin_us = self.spin;
        Ok(options)
    }
}

/// Shorter than this the kernel's counts say little.
const LEAST: Duration = Duration::from_millis(100);
const MOST: Duration = Duration::from_secs(3600);

#[derive(Debug, clap::Args)]
pub(super) struct Footprint {
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

impl Arguments for Footprint {
    type Options = footprint::FootprintOptions;

    fn options(&self) -> Result<Self::Options> {
        if self.quick {
            return Ok(footprint::FootprintOptions::quick());
        }
        ensure!(
            (LEAST..=MOST).contains(&self.duration),
            "--duration must be 100ms to 1h"
        );
        Ok(footprint::FootprintOptions {
            rounds: self.rounds,
            tracking: self.duration,
        })
    }
}

#[derive(Debug, clap::Args)]
pub(super) struct Quality {
    /// Runs of each variant, each with another seed, 1 to 100.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    rounds: u32,
    /// One round of a part of it: a look of some seconds, no measurement.
    #[arg(long, conflicts_with = "rounds")]
    quick: bool,
}

impl Arguments for Quality {
    type Options = quality::QualityOptions;

    fn options(&self) -> Result<Self::Options> {
        if self.quick {
            return Ok(quality::QualityOptions::quick());
        }
        Ok(quality::QualityOptions {
            rounds: self.rounds,
            ..quality::QualityOptions::full()
        })
    }
}

#[derive(Debug, clap::Args)]
pub(super) struct Paper {
    /// Runs of each solver, each with another seed, 1 to 1000. kpso-refined draws the circle at least 20
    /// times.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=1000))]
    seeds: u64,
    /// Cycles of a run at most: for a quick look.
    #[arg(long, hide = true, default_value_t = u64::MAX, value_parser = clap::value_parser!(u64).range(1..))]
    cycles: u64,
}

impl Arguments for Paper {
    type Options = Effort;

    fn options(&self) -> Result<Self::Options> {
        Ok(Effort {
            seeds: self.seeds,
            cycles_max: self.cycles,
        })
    }
}

#[derive(Debug, clap::Args)]
pub(super) struct Solver {
    /// How often all sizes are measured, 1 to 100; a number is the median.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100))]
    rounds: u32,
}

impl Arguments for Solver {
    type Options = solver::SolverOptions;

    fn options(&self) -> Result<Self::Options> {
        Ok(solver::SolverOptions {
            rounds: self.rounds,
            ..solver::SolverOptions::full()
        })
    }
}

#[derive(Debug, clap::Args)]
pub(super) struct Robustness {
    /// Runs of each robot with each controller, each with other noise, 1 to 1000.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    seeds: u32,
}

impl Arguments for Robustness {
    type Options = robustness::RobustnessOptions;

    fn options(&self) -> Result<Self::Options> {
        Ok(robustness::RobustnessOptions { rounds: self.seeds })
    }
}

#[derive(Debug, clap::Args)]
pub(super) struct Budget {
    /// How often all budgets are measured, 1 to 100; a time is the median, the largest of all.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100))]
    rounds: u32,
    /// Solves of each case with each budget in a round, 1 to 1000000.
    #[arg(long, default_value_t = 2000, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    solves: u64,
}

impl Arguments for Budget {
    type Options = budget::BudgetOptions;

    fn options(&self) -> Result<Self::Options> {
        Ok(budget::BudgetOptions {
            rounds: self.rounds,
            solves: self.solves,
        })
    }
}

/// The other process of the bare measurement.
#[derive(Debug, clap::Args)]
pub(super) struct Peer {
    /// Prefix of the files in shared memory.
    #[arg(long)]
    prefix: String,
    /// Root folder of iceoryx2.
    #[arg(long)]
    root: PathBuf,
    /// The process that started it.
    #[arg(long)]
    parent: u32,
    /// Its core.
    #[arg(long)]
    core: usize,
    /// Both processes are on one core.
    #[arg(long)]
    shares: bool,
}

impl Peer {
    pub(super) fn run(&self) -> Result<()> {
        baseline::peer(&baseline::PeerOptions {
            location: Location::new(&self.prefix, &self.root)?,
            core: self.core,
            parent: self.parent,
            shares: self.shares,
        })
    }
}
