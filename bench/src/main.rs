//! The command line of the benchmarks.

use anyhow::Result;
use cdcr_bench::paper::{self, Simulation};
use clap::{Parser, Subcommand, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};

/// What the controller reaches, measured.
#[derive(Debug, Parser)]
#[command(version, about, after_help = "Example: cdcr-bench paper --seeds 10")]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// The paper's spiral for 1, 2 and 3 sections with every solver, beside the paper's figures.
    #[command(after_help = "Example: cdcr-bench paper --seeds 3 --format json")]
    Paper {
        /// Runs of each solver, each with another seed, 1 to 1000.
        #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=1000))]
        seeds: u64,
        /// How to print the result.
        #[arg(long, value_enum, default_value_t = Format::Text)]
        format: Format,
    },
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    /// A table for people.
    Text,
    /// One JSON object.
    Json,
}

fn main() -> Result<()> {
    match Cli::parse().command {
        Command::Paper { seeds, format } => paper_command(seeds, format),
    }
}

fn paper_command(seeds: u64, format: Format) -> Result<()> {
    let style = ProgressStyle::with_template("{bar:30} {pos}/{len} runs, {eta} left")?;
    let bar = ProgressBar::new(paper::spiral_runs(seeds)).with_style(style);
    let rows = paper::spiral(seeds, || bar.inc(1))?;
    bar.finish_and_clear();
    match format {
        Format::Text => print_table(&rows),
        Format::Json => println!("{}", serde_json::json!({ "simulations": rows })),
    }
    Ok(())
}

fn print_table(rows: &[Simulation]) {
    println!(
        "{:<8} {:>8} {:<13} {:>14} {:>12} {:>12} {:>10} {:>10} {:>10} {:>12}",
        "curve",
        "sections",
        "solver",
        "mean error mm",
        "max mm",
        "paper's mm",
        "mean µs",
        "p50 µs",
        "p99 µs",
        "paper's ms"
    );
    for row in rows {
        println!(
            "{:<8} {:>8} {:<13} {:>14.2e} {:>12.2e} {:>12.0e} {:>10.2} {:>10.2} {:>10.2} {:>12}",
            row.name,
            row.sections,
            row.solver,
            row.mean_error_mm,
            row.max_error_mm,
            row.paper.mean_error_mm,
            row.solve_us.mean,
            row.solve_us.p50,
            row.solve_us.p99,
            row.paper.mean_solve_ms
        );
    }
}
