//! The command line of the benchmarks.

mod bar;
mod budget;
mod output;
mod paper;
mod solver;

use anyhow::Result;
use clap::{Parser, Subcommand};
use output::Format;

/// What the controller reaches, measured.
#[derive(Debug, Parser)]
#[command(version, about, after_help = "Example: cdcr-bench paper --seeds 10")]
pub(crate) struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// The paper's three simulations (spiral, line with orientation, circle with an obstacle) with every
    /// solver, beside the paper's figures.
    #[command(after_help = "Example: cdcr-bench paper --seeds 3 --out paper")]
    Paper(paper::Options),
    /// Solve times on every path of this processor, and how they grow with sections, steps, particles,
    /// iterations and obstacles.
    #[command(after_help = "Example: cdcr-bench solver --format csv > solver.csv")]
    Solver {
        /// How to print the result.
        #[arg(long, value_enum, default_value_t = Format::Text)]
        format: Format,
    },
    /// How much later than its budget a solve ends, from no time at all to 1 ms, and that its plan is never
    /// worse than the warm start.
    #[command(after_help = "Example: cdcr-bench budget --format json > budget.json")]
    Budget {
        /// How to print the result.
        #[arg(long, value_enum, default_value_t = Format::Text)]
        format: Format,
        /// Solves of each case with each budget, 1 to 1000000.
        #[arg(long, default_value_t = 2000, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
        solves: u64,
    },
}

/// Carries a command line out.
pub(crate) fn execute(cli: Cli) -> Result<()> {
    match cli.command {
        Command::Paper(options) => paper::run(&options),
        Command::Solver { format } => solver::run(format),
        Command::Budget { format, solves } => budget::run(format, solves),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_manual_is_what_the_command_line_says() {
        cdcr_packaging::check(&Cli::command(), "1").expect("up to date");
    }
}
