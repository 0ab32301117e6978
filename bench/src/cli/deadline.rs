//! `cdcr-bench deadline`.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Result, ensure};
use cdcr_bench::deadline;
use cdcr_bench::load::Load;
use cdcr_bench::system::thread::may_be_realtime;
use clap::ValueEnum;

use super::output::Output;

/// What follows the options in the help.
pub(super) const AFTER_HELP: &str = "Example: cdcr-bench deadline --duration 60s --rounds 6 --out deadline\n\n\
    Real-time threads need a privilege (docs/realtime.md); without it only the ordinary set-up is measured.";

#[derive(Debug, clap::Args)]
pub(super) struct Options {
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
    #[command(flatten)]
    output: Output,
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

impl Options {
    fn plan(&self) -> Result<deadline::Options> {
        let default = deadline::Options::default();
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
        let options = deadline::Options {
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

pub(super) fn run(options: &Options) -> Result<()> {
    options.output.prepare()?;
    let plan = options.plan()?;
    options
        .output
        .measure(&plan, deadline::expected_s, deadline::run)
}
