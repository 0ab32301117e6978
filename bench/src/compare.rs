//! What changed between two runs beyond the noise of their rounds.
//!
//! The rounds of a run are taken in turns with its baselines, so their range shows what the machine does to a
//! number that nobody touched. A number is called changed when the ranges of the two runs are apart and their
//! medians differ by more than [`LEAST_CHANGE_PERCENT`]. Numbers with one value in each run are told apart.

mod change;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};

use crate::dataset::{Column, Sheet, fixed, shorted, signed, word};
use crate::environment::{Environment, RunOptions};
use crate::metric::Metric;
pub use change::{Change, LEAST_CHANGE_PERCENT, Spread, Verdict};

/// Chance has a spread of its own: so many more may get worse.
const WORSE_MARGIN: usize = 2;
/// More names than this are not listed.
const NAMES_MAX: usize = 12;
const OTHER_MACHINE: &str = "absolute times of the two runs cannot be compared then; the ratios to the bare loop, which \
                             each run measured itself, can";
const OTHER_OPTIONS: &str = "numbers may differ for this reason alone, ratios too";

/// What the comparison needs of a result, of one benchmark or of all.
#[derive(Debug, Clone, Deserialize)]
pub struct Input {
    pub environment: Environment,
    /// What was asked for; none in a file of an older version.
    #[serde(default)]
    pub options: Option<RunOptions>,
    pub metrics: Vec<Metric>,
}

impl Input {
    pub fn read(file: &Path) -> Result<Self> {
        let name = file.display();
        let text = fs::read_to_string(file).with_context(|| format!("cannot read {name}"))?;
        serde_json::from_str(&text).with_context(|| {
            format!(
                "{name} is no result of cdcr-bench: expected is one JSON object with \"environment\" and \
                 \"metrics\", as --format json prints it and --out writes it"
            )
        })
    }
}

#[derive(Debug, Clone, Serialize)]
pub struct Comparison {
    pub before: Environment,
    pub after: Environment,
    /// Why the two cannot be compared as they are.
    pub warnings: Vec<String>,
    /// Every number that both runs have: changed ones first, the worst of them before the others.
    pub metrics: Vec<Change>,
    /// Numbers that would be called changed if nothing had changed, on average.
    pub changed_by_chance: f64,
    pub only_before: Vec<String>,
    pub only_after: Vec<String>,
}

impl Comparison {
    pub fn of(before: &Input, after: &Input) -> Self {
        let (old, new) = (by_name(&before.metrics), by_name(&after.metrics));
        let both = old
            .iter()
            .filter_map(|(key, metric)| Change::of(metric, new.get(key)?));
        let mut metrics: Vec<Change> = both.collect();
        metrics.sort_by(|one, other| {
            let by_verdict = one.verdict.cmp(&other.verdict);
            by_verdict
                .then(other.size().total_cmp(&one.size()))
                .then(one.name.cmp(&other.name))
        });
        let missing = |these: &Named<'_>, others: &Named<'_>| {
            let lone = these.keys().filter(|key| !others.contains_key(*key));
            lone.map(|(name, _)| (*name).to_owned()).collect()
        };
        Self {
            warnings: warnings(before, after),
            changed_by_chance: metrics.iter().map(Change::false_alarm).sum(),
            metrics,
            only_before: missing(&old, &new),
            only_after: missing(&new, &old),
            before: before.environment.clone(),
            after: after.environment.clone(),
        }
    }

    /// How many numbers may get worse before more than chance is behind it: half of those that chance alone
    /// calls changed, rounded up, and two more.
    pub fn worse_by_chance(&self) -> usize {
        // Chance calls as many better as worse.
        (self.changed_by_chance / 2.0).ceil() as usize + WORSE_MARGIN
    }

    pub fn count(&self, verdict: Verdict) -> usize {
        let all = self.metrics.iter();
        all.filter(|change| change.verdict == verdict).count()
    }

    /// Numbers that changed in a table, all others as counts.
    pub fn text(&self) -> Result<String> {
        let (before, after) = (self.before.run(), self.after.run());
        let mut text = format!("before: {before}\nafter:  {after}\n");
        for warning in &self.warnings {
            writeln!(text, "warning: {warning}")?;
        }
        let all = self.metrics.iter();
        let rows: Vec<_> = all.filter(|change| change.verdict.is_change()).collect();
        if rows.iter().all(|change| change.chance.is_none()) {
            text.push_str("\nNothing changed beyond noise.\n");
        }
        if !rows.is_empty() {
            let title = format!(
                "Worse or better: the rounds of the two runs are apart, and their medians differ by more than \
                 {LEAST_CHANGE_PERCENT} %. With one value each, a change only where the number is exact"
            );
            write!(
                text,
                "\n{}",
                Sheet::new(&rows)?.table(title, &COLUMNS).text()
            )?;
        }
        let counts = Verdict::ALL.map(|verdict| (self.count(verdict), verdict.name()));
        let counts = counts.map(|(count, verdict)| format!("{count} {verdict}"));
        writeln!(
            text,
            "\n{}.\nWithout any change up to {:.1} of these would be called worse or better, by chance alone; more \
             rounds make it rarer (5 in each run: 1 of 126).",
            counts.join(", "),
            self.changed_by_chance
        )?;
        for (when, names) in [("before", &self.only_before), ("after", &self.only_after)] {
            let shown = names[..names.len().min(NAMES_MAX)].join(", ");
            writeln!(text, "{} only in the run {when}: {shown}", names.len())?;
        }
        Ok(text)
    }
}

const COLUMNS: [Column; 9] = [
    word("metric", "name"),
    word("unit", "unit"),
    word("", "verdict"),
    signed("change %", "change_percent"),
    shorted("before", "before_median"),
    shorted("rounds", "before_range"),
    shorted("after", "after_median"),
    shorted("rounds", "after_range"),
    fixed("by chance", "chance", 3),
];

/// By name and unit: another unit is another number.
type Named<'a> = BTreeMap<(&'a str, &'a str), &'a Metric>;

fn by_name(metrics: &[Metric]) -> Named<'_> {
    let known = metrics.iter().filter(|metric| !metric.rounds.is_empty());
    known
        .map(|metric| ((&*metric.name, &*metric.unit), metric))
        .collect()
}

/// Why two runs are no measure of each other.
fn warnings(before: &Input, after: &Input) -> Vec<String> {
    let differing = before.environment.differing(&after.environment).into_iter();
    let mut warnings: Vec<String> = differing
        .map(|(what, old, new)| format!("another {what}: {old} before, {new} after"))
        .collect();
    if !warnings.is_empty() {
        warnings.push(OTHER_MACHINE.to_owned());
    }
    let (old, new) = match (&before.options, &after.options) {
        (Some(old), Some(new)) => (old, new),
        (None, None) => return warnings,
        (old, _) => {
            let when = if old.is_none() { "before" } else { "after" };
            warnings.push(format!(
                "the run {when} does not say what it was asked for: it may have measured something else"
            ));
            return warnings;
        }
    };
    let differing = old.differing(new);
    warnings.extend(differing.iter().map(|(name, old, new)| {
        format!("asked for with another value of {name}: {old} before, {new} after")
    }));
    warnings.extend((!differing.is_empty()).then(|| OTHER_OPTIONS.to_owned()));
    warnings
}

#[cfg(test)]
mod tests;
