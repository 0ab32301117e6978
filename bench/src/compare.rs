//! Changes between two runs beyond the noise of their rounds.

use std::collections::BTreeMap;
use std::fmt::{Display, Write as _};
use std::path::Path;

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use statrs::function::factorial::binomial;

use crate::dataset::Dataset;
use crate::environment::Environment;
use crate::metric::{Better, Metric};
use crate::named::named;
use crate::run_options::RunOptions;
use ChangeClass::{OneValueAlike, OneValueBetter, OneValueWorse, TooFewRounds, WithinNoise};

/// Rounds that each run needs: with fewer, two ranges are too often disjoint by chance.
const ROUNDS_MIN: usize = 3;
/// Smaller changes of the median are ignored, however small the spread \[%\].
const LEAST_CHANGE_PERCENT: f64 = 2.0;
/// Numbers that may get worse in addition, because the number of chance changes varies, too.
const WORSE_MARGIN: usize = 2;
const NAMES_MAX: usize = 12;
const NO_RESULT: &str = "is not a result of cdcr-bench: expected one JSON object with \"environment\" and \"metrics\", as \
                         --format json prints it and --out writes it";
const NO_OPTIONS: &str = "does not contain its options: it may have measured something else";
const OTHER_MACHINE: &str = "absolute times of the two runs cannot be compared then; the ratios to the bare loop, which \
                             each run measured itself, can";
const OTHER_OPTIONS: &str = "numbers may differ for this reason alone, ratios too";

named! {
    /// Classification of a number. `OneValue…`: each run has a single value, so chance cannot be estimated.
    pub enum ChangeClass {
        Worse = "worse",
        Better = "better",
        OneValueWorse = "one-value-worse",
        OneValueBetter = "one-value-better",
        WithinNoise = "within-noise",
        TooFewRounds = "too-few-rounds",
        OneValueAlike = "one-value-alike",
    }
}

/// A change: its class, its size \[%\], the probability to be classified as changed by chance alone, and its row.
fn change(old: &Metric, new: &Metric) -> Option<(ChangeClass, f64, f64, Value)> {
    let (before, after) = (old.median()?, new.median()?);
    let (old_range, new_range) = (old.range()?, new.range()?);
    let rounds = [old, new].map(|metric| metric.rounds.len());
    let percent = (before != 0.0).then(|| 100.0 * (after - before) / before.abs());
    // From zero, every change is large.
    let size = percent.map_or(f64::INFINITY, f64::abs);
    let is_apart = old_range.1 < new_range.0 || new_range.1 < old_range.0;
    let is_better = (new.better == Better::Lower) == (after < before);
    // Probability that values of one source are disjoint: extreme case of the two-sided rank test, 1 for one value each.
    let ways = binomial((rounds[0] + rounds[1]) as u64, rounds[0] as u64);
    let chance = (2.0 / ways).min(1.0);
    let is_comparable = rounds.iter().all(|count| *count >= ROUNDS_MIN);
    let [same, worse, better] = match rounds {
        [1, 1] => [OneValueAlike, OneValueWorse, OneValueBetter],
        _ if is_comparable => [WithinNoise, ChangeClass::Worse, ChangeClass::Better],
        _ => [TooFewRounds; 3],
    };
    let changed = [worse, better][usize::from(is_better)];
    let class = [same, changed][usize::from(is_apart && size > LEAST_CHANGE_PERCENT)];
    let row = json!({
        "name": new.name,
        "unit": new.unit,
        "better": new.better,
        "before": { "median": before, "range": old_range, "rounds": rounds[0] },
        "after": { "median": after, "range": new_range, "rounds": rounds[1] },
        "change_percent": percent,
        "verdict": class,
        // That the rounds are disjoint by chance, if they are disjoint.
        "chance": (is_apart && rounds != [1, 1]).then_some(chance),
    });
    let by_chance = if is_comparable { chance } else { 0.0 };
    Some((class, size, by_chance, row))
}

#[derive(Debug, Clone, Deserialize)]
pub struct Input {
    pub environment: Environment,
    /// Options of the run; `None` in a file of an older version.
    pub options: Option<RunOptions>,
    pub metrics: Vec<Metric>,
}

impl Input {
    pub fn read(file: &Path) -> Result<Self> {
        let name = file.display();
        let text = std::fs::read_to_string(file).with_context(|| format!("cannot read {name}"))?;
        serde_json::from_str(&text).with_context(|| format!("{name} {NO_RESULT}"))
    }
}

/// The measured metrics by name and unit; a number with another unit is another number.
type Named<'a> = BTreeMap<(&'a str, &'a str), &'a Metric>;

#[derive(Debug, Clone, Serialize)]
pub struct Comparison {
    pub before: Environment,
    pub after: Environment,
    pub warnings: Vec<String>,
    /// A row for every number that both runs have: changed ones first, worst on top.
    pub metrics: Vec<Value>,
    /// Expected count of numbers classified as changed if nothing has changed.
    pub changed_by_chance: f64,
    pub only_before: Vec<String>,
    pub only_after: Vec<String>,
}

impl Comparison {
    pub fn new(before: &Input, after: &Input) -> Self {
        let [old, new] = [before, after].map(|input| -> Named<'_> {
            let measured = input.metrics.iter().filter(|it| !it.rounds.is_empty());
            measured.map(|it| ((&*it.name, &*it.unit), it)).collect()
        });
        let both = |(key, old): (_, &&Metric)| change(old, new.get(key)?);
        let mut changes: Vec<_> = old.iter().filter_map(both).collect();
        // Stable: in the order of the names otherwise.
        changes.sort_by(|one, other| one.0.cmp(&other.0).then(other.1.total_cmp(&one.1)));
        let only = |these: &Named, others: &Named| {
            let missing = these.keys().filter(|key| !others.contains_key(*key));
            missing.map(|(name, _)| (*name).to_owned()).collect()
        };
        Self {
            warnings: warnings(before, after),
            changed_by_chance: changes.iter().map(|change| change.2).sum(),
            metrics: changes.into_iter().map(|change| change.3).collect(),
            only_before: only(&old, &new),
            only_after: only(&new, &old),
            before: before.environment.clone(),
            after: after.environment.clone(),
        }
    }

    /// How many numbers may get worse by chance: half of those that change by chance, and a margin.
    pub fn worse_by_chance(&self) -> usize {
        (self.changed_by_chance / 2.0).ceil() as usize + WORSE_MARGIN
    }

    pub fn count(&self, class: ChangeClass) -> usize {
        let metrics = self.metrics.iter();
        metrics.filter(|row| row["verdict"] == class.name()).count()
    }

    pub fn text(&self) -> String {
        let unchanged = [WithinNoise, TooFewRounds, OneValueAlike].map(|class| self.count(class));
        let changed = &self.metrics[..self.metrics.len() - unchanged.iter().sum::<usize>()];
        let summary = match self.count(TooFewRounds) {
            _ if changed.iter().any(|row| row["chance"].is_f64()) => "",
            all if all == self.metrics.len() => "Nothing can be compared: too few rounds.\n\n",
            _ => "Nothing changed beyond noise.\n\n",
        };
        let count = |class: ChangeClass| format!("{} {}", self.count(class), class.name());
        let mut table = Dataset::new("compare", include_str!("compare.toml"));
        let least = LEAST_CHANGE_PERCENT.to_string();
        table.add_titled("changes", &[&least], changed.to_vec());
        table.note = format!(
            "{}.\nWithout any change up to {:.1} of these would be called worse or better, by chance alone; more \
             rounds make it rarer (5 in each run: 1 of 126).",
            ChangeClass::ALL.map(count).join(", "),
            self.changed_by_chance
        );
        let (before, after) = (self.before.run(), self.after.run());
        let mut text = format!("before: {before}\nafter:  {after}\n");
        for warning in &self.warnings {
            let _ = writeln!(text, "warning: {warning}");
        }
        text = text + "\n" + summary + &table.text();
        for (when, names) in [("before", &self.only_before), ("after", &self.only_after)] {
            let shown = names[..names.len().min(NAMES_MAX)].join(", ");
            let _ = writeln!(text, "{} only in the run {when}: {shown}", names.len());
        }
        text
    }
}

fn warnings(before: &Input, after: &Input) -> Vec<String> {
    let machine = before.environment.differing(&after.environment);
    let options = match (&before.options, &after.options) {
        (Some(old), Some(new)) => another("value of ", &old.differing(new), OTHER_OPTIONS),
        (None, None) => Vec::new(),
        (None, _) => vec![format!("the run before {NO_OPTIONS}")],
        (_, None) => vec![format!("the run after {NO_OPTIONS}")],
    };
    [another("", &machine, OTHER_MACHINE), options].concat()
}

fn another<T: Display>(kind: &str, all: &[(&str, T, T)], consequence: &str) -> Vec<String> {
    let one = |(name, old, new): &(&str, T, T)| {
        format!("another {kind}{name}: {old} before, {new} after")
    };
    let consequence = (!all.is_empty()).then(|| consequence.to_owned());
    all.iter().map(one).chain(consequence).collect()
}
