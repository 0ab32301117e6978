//! The command line of the benchmarks.

mod all;
mod compare;
mod measure;
mod output;

use anyhow::Result;
use cdcr_bench::{
    budget, deadline, footprint, latency, quality, rate, robustness, simulation, solver,
};
use clap::{Parser, Subcommand};
use measure::Measure;

const DEADLINE_HELP: &str = "Example: cdcr-bench deadline --duration 60s --rounds 6 --out deadline\n\n\
    Real-time threads need a privilege (docs/realtime.md); without it only the ordinary set-up is measured.";
const LATENCY_HELP: &str = "Example: cdcr-bench latency --rounds 5 --out latency\n\n\
    Real-time threads need a privilege (docs/realtime.md); without it the same is measured without them.";

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
    All(all::AllArguments),
    /// What changed between two runs beyond the noise of their rounds.
    #[command(after_help = "Example: cdcr-bench compare before/report.json after/report.json")]
    Compare(compare::CompareArguments),
    /// Deadline misses and latencies of the daemon under named loads, beside a bare loop in the same run.
    #[command(after_help = DEADLINE_HELP)]
    Deadline(Measure<deadline::DeadlineOptions>),
    /// The paper's three simulations (spiral, line with orientation, circle with an obstacle) with every
    /// solver, beside the paper's figures.
    #[command(after_help = "Example: cdcr-bench paper --seeds 3 --out paper")]
    Paper(Measure<simulation::Effort>),
    /// What time buys: error, clearance and cost against the budget of a solve, the swarm and the horizon, on
    /// the paper's and on harder scenes, and how often a solver gets stuck.
    #[command(after_help = "Example: cdcr-bench quality --rounds 5 --out quality")]
    Quality(Measure<quality::QualityOptions>),
    /// Robots that are not their model (lag, noise, play, another geometry, a load): the true error of the tip, and what each part of the
    /// controller is for.
    #[command(after_help = "Example: cdcr-bench robustness --seeds 20 --out robustness")]
    Robustness(Measure<robustness::RobustnessOptions>),
    /// Solve times on every path of this processor, and how they grow with sections, steps, particles,
    /// iterations and obstacles.
    #[command(after_help = "Example: cdcr-bench solver --format csv > solver.csv")]
    Solver(Measure<solver::SolverOptions>),
    /// How much later than its budget a solve ends, from no time at all to 1 ms, and that its plan is never
    /// worse than the warm start.
    #[command(after_help = "Example: cdcr-bench budget --format json > budget.json")]
    Budget(Measure<budget::BudgetOptions>),
    /// How long messages take: reference, obstacle, measurement, request and stop, beside iceoryx2 alone.
    #[command(after_help = LATENCY_HELP)]
    Latency(Measure<latency::LatencyOptions>),
    /// The other process of `latency`.
    #[command(name = cdcr_bench::latency::baseline::PEER, hide = true)]
    Peer(measure::Peer),
    /// How fast the loop can go: the shortest period that a real daemon holds with 1, 2 and 3 sections, every
    /// solver and two horizons, and what ends it.
    #[command(after_help = "Example: cdcr-bench rate --rounds 5 --out rate")]
    Rate(Measure<rate::RateOptions>),
    /// What a daemon takes at 200 Hz: share of a core of each thread, memory, files, time to start.
    #[command(
        after_help = "Example: cdcr-bench footprint --duration 30s --format json > footprint.json"
    )]
    Footprint(Measure<footprint::FootprintOptions>),
}

/// Carries a command line out.
pub(crate) fn execute(cli: Cli) -> Result<()> {
    match cli.command {
        Command::All(options) => all::run(&options),
        Command::Compare(options) => compare::run(&options),
        Command::Deadline(asked) => asked.run(),
        Command::Paper(asked) => asked.run(),
        Command::Quality(asked) => asked.run(),
        Command::Robustness(asked) => asked.run(),
        Command::Solver(asked) => asked.run(),
        Command::Budget(asked) => asked.run(),
        Command::Latency(asked) => asked.run(),
        Command::Peer(options) => options.run(),
        Command::Rate(asked) => asked.run(),
        Command::Footprint(asked) => asked.run(),
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
