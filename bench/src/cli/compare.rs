//! `cdcr-bench compare`.

use std::path::PathBuf;

use anyhow::{Result, bail};
use cdcr_bench::compare::{Comparison, Input, Verdict};
use clap::ValueEnum;

use super::output::show;

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    /// What changed, for people.
    Text,
    /// One JSON object with every number.
    Json,
}

#[derive(Debug, clap::Args)]
pub(super) struct CompareArguments {
    /// The JSON of the run before: report.json, or that of one benchmark.
    #[arg(value_name = "A.json")]
    before: PathBuf,
    /// The JSON of the run after.
    #[arg(value_name = "B.json")]
    after: PathBuf,
    /// How to print the result.
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
    /// Exit status 1 when more numbers changed for the worse, beyond noise, than chance explains: than half of
    /// those that chance alone would call changed, rounded up, and two more. Numbers with one value each do not
    /// count.
    #[arg(long)]
    fail_on_worse: bool,
}

pub(super) fn run(args: &CompareArguments) -> Result<()> {
    let comparison = Comparison::of(&Input::read(&args.before)?, &Input::read(&args.after)?);
    show(&match args.format {
        Format::Text => comparison.text()?,
        Format::Json => serde_json::to_string(&comparison)? + "\n",
    })?;
    let worse = comparison.count(Verdict::Worse);
    let by_chance = comparison.worse_by_chance();
    if args.fail_on_worse && worse > by_chance {
        bail!(
            "{worse} numbers are worse than before, beyond noise; chance explains {by_chance} at most"
        );
    }
    Ok(())
}
