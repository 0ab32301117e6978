//! The command line of the benchmarks.

mod all;
mod budget;
mod compare;
mod deadline;
mod footprint;
mod latency;
mod output;
mod paper;
mod quality;
mod rate;
mod solver;

use anyhow::Result;
use clap::{Parser, Subcommand};

/// What the controller reaches, measured.
#[derive(Debug, Parser)]
#[command(version, about, after_help = "Example: cdcr-bench paper --seeds 10")]
pub(crate) struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Everything, as one report with the machine's description: text, JSON, CSV, plots, raw histograms, and
    /// a page that holds all of it.
    #[command(after_help = "Example: cdcr-bench all --out report --quick")]
    All(all::Options),
    /// What changed between two runs beyond the noise of their rounds.
    #[command(after_help = "Example: cdcr-bench compare before/report.json after/report.json")]
    Compare(compare::Options),
    /// Deadline misses and latencies of the daemon under named loads, beside a bare loop in the same run.
    #[command(after_help = deadline::AFTER_HELP)]
    Deadline(deadline::Options),
    /// The paper's three simulations (spiral, line with orientation, circle with an obstacle) with every
    /// solver, beside the paper's figures.
    #[command(after_help = "Example: cdcr-bench paper --seeds 3 --out paper")]
    Paper(paper::Options),
    /// What time buys: error, clearance and cost against the budget of a solve, the swarm and the horizon, on
    /// the paper's and on harder scenes, and how often a solver gets stuck.
    #[command(after_help = "Example: cdcr-bench quality --rounds 5 --out quality")]
    Quality(quality::Options),
    /// Solve times on every path of this processor, and how they grow with sections, steps, particles,
    /// iterations and obstacles.
    #[command(after_help = "Example: cdcr-bench solver --format csv > solver.csv")]
    Solver(solver::Options),
    /// How much later than its budget a solve ends, from no time at all to 1 ms, and that its plan is never
    /// worse than the warm start.
    #[command(after_help = "Example: cdcr-bench budget --format json > budget.json")]
    Budget(budget::Options),
    /// How long messages take: reference, obstacle, measurement, request and stop, beside iceoryx2 alone.
    #[command(after_help = latency::AFTER_HELP)]
    Latency(latency::Options),
    /// The other process of `latency`.
    #[command(name = cdcr_bench::latency::bare::PEER, hide = true)]
    Peer(latency::PeerOptions),
    /// How fast the loop can go: the shortest period that a real daemon holds with 1, 2 and 3 sections, every
    /// solver and two horizons, and what ends it.
    #[command(after_help = "Example: cdcr-bench rate --rounds 5 --out rate")]
    Rate(rate::Options),
    /// What a daemon takes at 200 Hz: share of a core of each thread, memory, files, time to start.
    #[command(
        after_help = "Example: cdcr-bench footprint --duration 30s --format json > footprint.json"
    )]
    Footprint(footprint::Options),
}

/// Carries a command line out.
pub(crate) fn execute(cli: Cli) -> Result<()> {
    match cli.command {
        Command::All(options) => all::run(&options),
        Command::Compare(options) => compare::run(&options),
        Command::Deadline(options) => deadline::run(&options),
        Command::Paper(options) => paper::run(&options),
        Command::Quality(options) => quality::run(&options),
        Command::Solver(options) => solver::run(&options),
        Command::Budget(options) => budget::run(&options),
        Command::Latency(options) => latency::run(&options),
        Command::Peer(options) => latency::peer(&options),
        Command::Rate(options) => rate::run(&options),
        Command::Footprint(options) => footprint::run(&options),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_manual_is_what_the_command_line_says() {
        cdcr_packaging::check(&Cli::command(), "1", None).expect("up to date");
    }
}
