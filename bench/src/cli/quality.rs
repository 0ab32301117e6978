//! `cdcr-bench quality`.

use anyhow::Result;
use cdcr_bench::quality;

use super::output::Output;

#[derive(Debug, clap::Args)]
pub(super) struct Options {
    /// Runs of each variant, each with another seed, 1 to 100.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    rounds: u32,
    /// One round of a part of it: a look of some seconds, no measurement.
    #[arg(long, conflicts_with = "rounds")]
    quick: bool,
    #[command(flatten)]
    output: Output,
}

pub(super) fn run(args: &Options) -> Result<()> {
    args.output.prepare()?;
    let options = if args.quick {
        quality::Options::quick()
    } else {
        quality::Options {
            rounds: args.rounds,
            ..quality::Options::full()
        }
    };
    args.output
        .measure(&options, quality::expected_s, quality::run)
}
