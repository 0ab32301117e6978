//! `cdcr-bench all`.

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail, ensure};
use cdcr_bench::progress::Progress;
use cdcr_bench::report::benchmark::Request;
use cdcr_bench::report::{BenchReport, Start};
use cdcr_testbed::interrupt;

use super::output::{keep, make, show};

/// Where a report goes that would take results from an older one.
const ASIDE: &str = "partial";

#[derive(Debug, clap::Args)]
pub(super) struct AllArguments {
    /// Folder for the report: report.html, report.txt, report.json, a CSV for each table, plots as SVG, raw
    /// histograms; made if it does not exist, written into at the end only.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    request: Request,
}

pub(super) fn run(args: &AllArguments) -> Result<()> {
    let start = Start::now()?;
    interrupt::catch()?;
    if let Some(config) = &args.request.config {
        ensure!(config.is_file(), "there is no file {}", config.display());
    }
    make(&args.out)?;
    let mut progress = Progress::new(args.request.expected_s());
    let report = args.request.run(start, &mut progress)?;
    drop(progress);
    keep(&report.bundle()?, &folder(&report, &args.out)?)?;
    show(&report.summary()?)?;
    let failed: Vec<&str> = report.failures().map(|(name, _)| name).collect();
    if !failed.is_empty() {
        bail!(
            "{} of {} benchmarks failed: {}; the report says why, and holds the others",
            failed.len(),
            report.parts.len(),
            failed.join(", ")
        );
    }
    Ok(())
}

/// The folder itself, unless it holds a report with results that this one lacks.
fn folder(report: &BenchReport, out: &Path) -> Result<PathBuf> {
    let older = fs::read_to_string(out.join("report.json")).unwrap_or_default();
    let lost = report.would_lose(&older);
    if lost.is_empty() {
        return Ok(out.to_owned());
    }
    let aside = out.join(ASIDE);
    writeln!(
        std::io::stderr(),
        "{} holds an older report, with {}, which this one lacks: it stays, and this one goes into {}",
        out.display(),
        lost.join(", "),
        aside.display()
    )?;
    Ok(aside)
}
