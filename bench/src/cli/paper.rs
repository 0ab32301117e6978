//! `cdcr-bench paper`.

use anyhow::Result;
use cdcr_bench::report::offline::paper;
use cdcr_bench::simulation::Effort;

use super::output::Output;

#[derive(Debug, clap::Args)]
pub(super) struct Options {
    /// Runs of each solver, each with another seed, 1 to 1000. kpso-refined draws the circle at least 20
    /// times.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=1000))]
    seeds: u64,
    #[command(flatten)]
    output: Output,
    /// Cycles of a run at most: for a quick look.
    #[arg(long, hide = true, default_value_t = u64::MAX, value_parser = clap::value_parser!(u64).range(1..))]
    cycles: u64,
}

pub(super) fn run(args: &Options) -> Result<()> {
    args.output.prepare()?;
    let effort = Effort {
        seeds: args.seeds,
        cycles_max: args.cycles,
    };
    let options = paper::Options { effort };
    args.output.measure(&options, paper::expected_s, paper::run)
}
