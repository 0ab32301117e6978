//! The command line of the benchmarks.

use std::fmt::Write as _;
use std::io::Write as _;

use anyhow::Result;
use cdcr_bench::paper::{self, Flat, Simulation};
use cdcr_bench::solver::{self, Case};
use clap::{Parser, Subcommand, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

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
    /// Solve times on every path of this processor, and how they grow with sections, steps, particles
    /// and iterations.
    #[command(after_help = "Example: cdcr-bench solver --format csv > solver.csv")]
    Solver {
        /// How to print the result.
        #[arg(long, value_enum, default_value_t = Format::Text)]
        format: Format,
    },
}

/// A bar for `length` pieces of work, on a terminal only.
fn progress(length: u64, unit: &str) -> Result<ProgressBar> {
    let style =
        ProgressStyle::with_template(&format!("{{bar:30}} {{pos}}/{{len}} {unit}, {{eta}} left"))?;
    Ok(ProgressBar::new(length).with_style(style))
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    /// A table for people.
    Text,
    /// One JSON object.
    Json,
    /// Comma-separated values with a header.
    Csv,
}

fn main() -> Result<()> {
    match Cli::parse().command {
        Command::Paper { seeds, format } => paper_command(seeds, format),
        Command::Solver { format } => solver_command(format),
    }
}

fn paper_command(seeds: u64, format: Format) -> Result<()> {
    let bar = progress(paper::spiral_runs(seeds), "runs")?;
    let rows = paper::spiral(seeds, || bar.inc(1))?;
    bar.finish_and_clear();
    match format {
        Format::Text => show(&paper_table(&rows)),
        Format::Json => show(&format!("{}\n", serde_json::json!({ "simulations": rows }))),
        Format::Csv => show(&csv_of(&rows.iter().map(Flat::from).collect::<Vec<_>>())?),
    }
}

fn solver_command(format: Format) -> Result<()> {
    let sizes = solver::sizes();
    let bar = progress(sizes.len() as u64, "sizes")?;
    let mut cases = Vec::new();
    for size in &sizes {
        cases.extend(solver::measure(size)?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    match format {
        Format::Text => show(&cases_table(&cases)),
        Format::Json => show(&format!("{}\n", serde_json::json!({ "cases": cases }))),
        Format::Csv => show(&csv_of(&cases)?),
    }
}

/// Writes to the standard output. A reader that closed it, like `head`, has seen enough.
fn show(text: &str) -> Result<()> {
    match std::io::stdout().write_all(text.as_bytes()) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => Err(error.into()),
        _ => Ok(()),
    }
}

/// One line for each row, with the names of its fields above.
fn csv_of<T: Serialize>(rows: &[T]) -> Result<String> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for row in rows {
        writer.serialize(row)?;
    }
    Ok(String::from_utf8(writer.into_inner()?)?)
}

fn cases_table(cases: &[Case]) -> String {
    let mut text = format!(
        "{:<13} {:<9} {:>8} {:>7} {:>6} {:>10} {:>10} {:>10} {:>10}\n",
        "solver",
        "path",
        "sections",
        "horizon",
        "swarm",
        "iterations",
        "p50 µs",
        "p99 µs",
        "speed-up"
    );
    for case in cases {
        let _ = writeln!(
            text,
            "{:<13} {:<9} {:>8} {:>7} {:>6} {:>10} {:>10.2} {:>10.2} {:>9.1}x",
            case.solver,
            format!("{:?}", case.path).to_lowercase(),
            case.sections,
            case.horizon,
            case.swarm,
            case.iterations,
            case.p50_us,
            case.p99_us,
            case.speedup_vs_scalar
        );
    }
    text
}

fn paper_table(rows: &[Simulation]) -> String {
    let mut text = format!(
        "{:<8} {:>8} {:<13} {:>14} {:>12} {:>12} {:>10} {:>10} {:>10} {:>12}\n",
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
        let _ = writeln!(
            text,
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
    text
}
