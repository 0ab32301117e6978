//! The command line of the benchmarks.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use cdcr_bench::budget;
use cdcr_bench::csv::csv;
use cdcr_bench::folder::{self, Document};
use cdcr_bench::growth::{Growth, growth};
use cdcr_bench::simulation::{self, Effort};
use cdcr_bench::solver::{self, Case};
use cdcr_bench::table;
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
    /// The paper's three simulations (spiral, line with orientation, circle with an obstacle) with every
    /// solver, beside the paper's figures.
    #[command(after_help = "Example: cdcr-bench paper --seeds 3 --out paper")]
    Paper(PaperArgs),
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

#[derive(Debug, clap::Args)]
struct PaperArgs {
    /// Runs of each solver, each with another seed, 1 to 1000. kpso-refined draws the circle at least 20
    /// times.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=1000))]
    seeds: u64,
    /// How to print the result.
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
    /// Folder for the figures as SVG, for paper.html with all of them, paper.json and paper.csv; made if
    /// it does not exist.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Cycles of a run at most: for a quick look.
    #[arg(long, hide = true, default_value_t = u64::MAX, value_parser = clap::value_parser!(u64).range(1..))]
    cycles: u64,
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
        Command::Paper(args) => paper(&args),
        Command::Solver { format } => solver(format),
        Command::Budget { format, solves } => budget(format, solves),
    }
}

fn paper(args: &PaperArgs) -> Result<()> {
    if let Some(folder) = &args.out {
        // Before minutes of work, not after.
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    }
    let effort = Effort {
        seeds: args.seeds,
        cycles_max: args.cycles,
    };
    let bar = progress(effort.all_work(), "{percent:>3} %")?;
    let outcomes = simulation::run_all(effort, |work| bar.inc(work))?;
    bar.finish_and_clear();
    let document = Document::of(&outcomes);
    show(&match args.format {
        Format::Text => {
            let tables = table::simulations(&outcomes);
            let texts: Vec<String> = tables.iter().map(table::Table::text).collect();
            texts.join("\n")
        }
        Format::Json => document.json()?,
        Format::Csv => document.csv()?,
    })?;
    match &args.out {
        Some(folder) => tell(folder, &folder::write(folder, &outcomes)?),
        None => Ok(()),
    }
}

/// What was written, beside the result and not in it.
fn tell(folder: &Path, written: &[PathBuf]) -> Result<()> {
    let names: Vec<_> = written
        .iter()
        .filter_map(|file| file.file_name())
        .map(|name| name.to_string_lossy())
        .collect();
    let folder = folder.display();
    let mut stderr = std::io::stderr();
    writeln!(stderr, "written into {folder}: {}", names.join(", "))?;
    Ok(())
}

/// The cases, and what follows from them.
#[derive(Serialize)]
struct Cases<'a> {
    cases: &'a [Case],
    growth: &'a [Growth],
}

fn solver(format: Format) -> Result<()> {
    let sizes = solver::sizes();
    let bar = progress(sizes.len() as u64, "{pos}/{len} sizes")?;
    let mut cases = Vec::new();
    for size in &sizes {
        cases.extend(solver::measure(size)?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    let growth = growth(&cases);
    show(&match format {
        Format::Text => table::cases(&cases).text() + "\n" + &table::growth(&growth).text(),
        Format::Json => {
            let all = Cases {
                cases: &cases,
                growth: &growth,
            };
            serde_json::to_string(&all)? + "\n"
        }
        Format::Csv => csv(&cases)?,
    })
}

/// The cases with every budget.
#[derive(Serialize)]
struct Budgets<'a> {
    cases: &'a [budget::Row],
}

fn budget(format: Format, solves: u64) -> Result<()> {
    let cases = budget::cases()?;
    let count = cases.len() * budget::BUDGETS_US.len();
    let bar = progress(count as u64, "{pos}/{len} budgets")?;
    let mut rows = Vec::new();
    for case in &cases {
        for budget_us in budget::BUDGETS_US {
            rows.push(case.measure(budget_us, solves)?);
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    show(&match format {
        Format::Text => table::budgets(&rows).text(),
        Format::Json => serde_json::to_string(&Budgets { cases: &rows })? + "\n",
        Format::Csv => csv(&rows)?,
    })
}

/// A bar for `length` pieces of work that are counted so, on a terminal only.
fn progress(length: u64, count: &str) -> Result<ProgressBar> {
    let style = ProgressStyle::with_template(&format!("{{bar:30}} {count}, {{eta}} left"))?;
    Ok(ProgressBar::new(length).with_style(style))
}

/// Writes to the standard output. A reader that closed it, like `head`, has seen enough.
fn show(text: &str) -> Result<()> {
    match std::io::stdout().write_all(text.as_bytes()) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => Err(error.into()),
        _ => Ok(()),
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
