//! `cdcr-bench solver`.

use anyhow::Result;
use cdcr_bench::csv::csv;
use cdcr_bench::growth::{Growth, growth};
use cdcr_bench::solver::{self, Case};
use cdcr_bench::table;
use serde::Serialize;

use super::bar::progress;
use super::output::{Format, show};

/// The cases, and what follows from them.
#[derive(Serialize)]
struct Cases<'a> {
    cases: &'a [Case],
    growth: &'a [Growth],
}

pub(super) fn run(format: Format) -> Result<()> {
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
