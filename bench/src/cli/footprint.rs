//! `cdcr-bench footprint`.

use std::time::Duration;

use anyhow::{Result, ensure};
use cdcr_bench::footprint;

use super::output::Output;

/// Shorter than this the kernel's counts say little.
const LEAST: Duration = Duration::from_millis(100);
const MOST: Duration = Duration::from_secs(3600);

#[derive(Debug, clap::Args)]
pub(super) struct Options {
    /// Daemons that are measured one after the other, 1 to 100.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=100))]
    rounds: u32,
    /// How long each of them tracks, 100ms to 1h; without a client it is measured for two fifths of that.
    #[arg(long, default_value = "10s", value_parser = humantime::parse_duration)]
    duration: Duration,
    /// Two daemons for two seconds: a look of ten seconds instead of a measurement.
    #[arg(long, conflicts_with_all = ["rounds", "duration"])]
    quick: bool,
    #[command(flatten)]
    output: Output,
}

pub(super) fn run(args: &Options) -> Result<()> {
    args.output.prepare()?;
    ensure!(
        (LEAST..=MOST).contains(&args.duration),
        "--duration must be 100ms to 1h"
    );
    let options = if args.quick {
        footprint::Options::quick()
    } else {
        footprint::Options {
            rounds: args.rounds,
            tracking: args.duration,
        }
    };
    args.output
        .measure(&options, footprint::expected_s, footprint::run)
}
