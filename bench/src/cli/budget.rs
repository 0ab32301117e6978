//! `cdcr-bench budget`.

use anyhow::Result;
use cdcr_bench::report::offline::budget;

use super::output::Output;

#[derive(Debug, clap::Args)]
pub(super) struct Options {
    /// How often all budgets are measured, 1 to 100; a time is the median, the largest of all.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100))]
    rounds: u32,
    /// Solves of each case with each budget in a round, 1 to 1000000.
    #[arg(long, default_value_t = 2000, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    solves: u64,
    #[command(flatten)]
    output: Output,
}

pub(super) fn run(args: &Options) -> Result<()> {
    args.output.prepare()?;
    let options = budget::Options {
        rounds: args.rounds,
        solves: args.solves,
    };
    args.output
        .measure(&options, budget::expected_s, budget::run)
}
