//! `cdcr-bench latency`, and the hidden peer that it needs.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::Result;
use cdcr_bench::latency;
use cdcr_bench::latency::bare;
use cdcr_shared_types::Location;

use super::output::Output;

/// What follows the options in the help.
pub(super) const AFTER_HELP: &str = "Example: cdcr-bench latency --rounds 5 --out latency\n\n\
    Real-time threads need a privilege (docs/realtime.md); without it the same is measured without them.";

#[derive(Debug, clap::Args)]
pub(super) struct Options {
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
    #[command(flatten)]
    output: Output,
}

impl Options {
    fn plan(&self) -> latency::Options {
        let (rounds, samples) = if self.quick {
            latency::Options::QUICK
        } else {
            (usize::from(self.rounds), usize::from(self.samples))
        };
        latency::Options {
            rounds,
            samples,
            period: self.period,
            config: self.config.clone(),
        }
    }
}

pub(super) fn run(options: &Options) -> Result<()> {
    options.output.prepare()?;
    let plan = options.plan();
    options
        .output
        .measure(&plan, latency::expected_s, latency::run)
}

/// The other process of the bare measurement.
#[derive(Debug, clap::Args)]
pub(super) struct PeerOptions {
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

pub(super) fn peer(options: &PeerOptions) -> Result<()> {
    bare::peer(&bare::PeerOptions {
        location: Location::new(&options.prefix, &options.root)?,
        core: options.core,
        parent: options.parent,
        shares: options.shares,
    })
}
