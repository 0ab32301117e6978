//! `cdcr-bench budget`.

use anyhow::Result;
use cdcr_bench::budget;
use cdcr_bench::csv::csv;
use cdcr_bench::table;
use serde::Serialize;

use super::bar::progress;
use super::output::{Format, show};

/// The cases with every budget.
#[derive(Serialize)]
struct Budgets<'a> {
    cases: &'a [budget::Row],
}

pub(super) fn run(format: Format, solves: u64) -> Result<()> {
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
