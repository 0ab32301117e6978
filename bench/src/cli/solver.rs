//! `cdcr-bench solver`.

use anyhow::Result;
use cdcr_bench::report::offline::solver;

use super::output::Output;

#[derive(Debug, clap::Args)]
pub(super) struct Options {
    /// How often all sizes are measured, 1 to 100; a number is the median.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100))]
    rounds: u32,
    #[command(flatten)]
    output: Output,
}

pub(super) fn run(args: &Options) -> Result<()> {
    args.output.prepare()?;
    let options = solver::Options {
        rounds: args.rounds,
        ..solver::Options::default()
    };
    args.output
        .measure(&options, solver::expected_s, solver::run)
}
