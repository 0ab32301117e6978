//! `cdcr-bench paper`.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use cdcr_bench::folder::{self, Document};
use cdcr_bench::simulation::{self, Effort};
use cdcr_bench::table;

use super::bar::progress;
use super::output::{Format, show};

#[derive(Debug, clap::Args)]
pub(super) struct Options {
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

pub(super) fn run(args: &Options) -> Result<()> {
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
