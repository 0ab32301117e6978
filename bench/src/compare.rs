//! Changes between two runs beyond the noise of their rounds.

use std::collections::BTreeMap;
use std::fmt::{Display, Write as _};
use std::fs;
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
use ChangeClass::{
    Better as Improved, OneValueAlike, OneValueBetter, OneValueWorse, TooFewRounds, WithinNoise,
    Worse,
};

/// Rounds that each run needs: with fewer, two ranges are too often disjoint by chance.
const ROUNDS_MIN: usize = 3;
/// Smaller changes of the median are ignored, however small the spread \[%\].
pub const LEAST_CHANGE_PERCENT: f64 = 2.0;
/// Numbers that may get worse in addition, because the number of chance changes varies, too.
const WORSE_MARGIN: usize = 2;
const NAMES_MAX: usize = 12;
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
        let text = fs::read_to_string(file).with_context(|| format!("cannot read {name}"))?;
        serde_json::from_str(&text).with_context(|| {
            format!(
                "{name} is not a result of cdcr-bench: expected one JSON object with \"environment\" and \
                 \"metrics\", as --format json prints it and --out writes it"
            )
        })
    }

    fn named(&self) -> Named<'_> {
        let known = self.metrics.iter().filter(|it| !it.rounds.is_empty());
        known.map(|it| ((&*it.name, &*it.unit), it)).collect()
    }
}

/// Metrics by name and unit; a number with another unit is another number.
type Named<'a> = BTreeMap<(&'a str, &'a str), &'a Metric>;

#[derive(Debug, Clone, Serialize)]
pub struct Comparison {
    pub before: Environment,
    pub after: Environment,
    pub warnings: Vec<String>,
    /// Every number that both runs have: changed ones first, worst on top.
    pub metrics: Vec<Change>,
    /// Expected count of numbers classified as changed if nothing has changed.
    pub changed_by_chance: f64,
    pub only_before: Vec<String>,
    pub only_after: Vec<String>,
}

impl Comparison {
    pub fn of(before: &Input, after: &Input) -> Self {
        let (old, new) = (before.named(), after.named());
        let both = |(key, old): (_, &&Metric)| Change::of(old, new.get(key)?);
        let mut metrics: Vec<Change> = old.iter().filter_map(both).collect();
        // From zero, every change is large.
        let size = |change: &Change| change.percent.map_or(f64::INFINITY, f64::abs);
        // Stable: in the order of the names otherwise.
        metrics.sort_by(|one, other| size(other).total_cmp(&size(one)));
        metrics.sort_by_key(|change| change.class);
        let only = |these: &Named, others: &Named| {
            let missing = these.keys().filter(|key| !others.contains_key(*key));
            missing.map(|(name, _)| (*name).to_owned()).collect()
        };
        Self {
            warnings: warnings(before, after),
            changed_by_chance: metrics.iter().map(|change| change.false_alarm).sum(),
            metrics,
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
        let classes = self.metrics.iter().map(|change| change.class);
        classes.filter(|found| *found == class).count()
    }

    pub fn text(&self) -> Result<String> {
        let (before, after) = (self.before.run(), self.after.run());
        let mut text = format!("before: {before}\nafter:  {after}\n");
        for warning in &self.warnings {
            writeln!(text, "warning: {warning}")?;
        }
        let is_changed = |change: &&Change| change.class < WithinNoise;
        let changed = self.metrics.iter().filter(is_changed);
        let rows: Vec<Value> = changed.map(|change| json!(change)).collect();
        if rows.iter().all(|change| change["chance"].is_null()) {
            text.push_str(if self.count(TooFewRounds) == self.metrics.len() {
                "\nNothing can be compared: too few rounds.\n"
            } else {
                "\nNothing changed beyond noise.\n"
            });
        }
        if !rows.is_empty() {
            let mut changes = Dataset::new("compare", include_str!("compare.toml"));
            changes.add_titled("changes", &[&LEAST_CHANGE_PERCENT.to_string()], rows);
            write!(text, "\n{}", changes.text())?;
        }
        let count = |class| format!("{} {}", self.count(class), class.name());
        let counts = ChangeClass::ALL.map(count);
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

fn warnings(before: &Input, after: &Input) -> Vec<String> {
    let machine = before.environment.differing(&after.environment);
    let options = match (&before.options, &after.options) {
        (Some(old), Some(new)) => another("value of ", &old.differing(new), OTHER_OPTIONS),
        (None, None) => Vec::new(),
        (old, _) => {
            let when = if old.is_none() { "before" } else { "after" };
            let words = "does not contain its options: it may have measured something else";
            vec![format!("the run {when} {words}")]
        }
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

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Change {
    pub name: String,
    unit: String,
    better: Better,
    before: Value,
    after: Value,
    /// Change of the median \[%\]; `None` from zero.
    #[serde(rename = "change_percent")]
    percent: Option<f64>,
    #[serde(rename = "verdict")]
    pub class: ChangeClass,
    /// Probability that the rounds are disjoint by chance, if they are disjoint.
    chance: Option<f64>,
    /// Probability that this number is classified as changed although nothing has changed.
    #[serde(skip)]
    false_alarm: f64,
}

impl Change {
    fn of(old: &Metric, new: &Metric) -> Option<Self> {
        let (before, after) = (old.median()?, new.median()?);
        let (old_range, new_range) = (old.range()?, new.range()?);
        let counts = [old.rounds.len(), new.rounds.len()];
        let percent = (before != 0.0).then(|| 100.0 * (after - before) / before.abs());
        let is_small = percent.is_some_and(|percent| percent.abs() <= LEAST_CHANGE_PERCENT);
        let is_apart = old_range.1 < new_range.0 || new_range.1 < old_range.0;
        let is_better = (new.better == Better::Lower) == (after < before);
        let is_comparable = counts.iter().all(|count| *count >= ROUNDS_MIN);
        let classes = match counts {
            [1, 1] => [OneValueAlike, OneValueBetter, OneValueWorse],
            _ if is_comparable => [WithinNoise, Improved, Worse],
            _ => [TooFewRounds; 3],
        };
        let spread = |median: f64, range, rounds: usize| json!({ "median": median, "range": range, "rounds": rounds });
        let (is_changed, chance) = (is_apart && !is_small, chance_apart(counts));
        Some(Self {
            name: new.name.clone(),
            unit: new.unit.clone(),
            better: new.better,
            before: spread(before, old_range, counts[0]),
            after: spread(after, new_range, counts[1]),
            percent,
            class: classes[usize::from(is_changed) * (2 - usize::from(is_better))],
            chance: (is_apart && counts != [1, 1]).then_some(chance),
            false_alarm: if is_comparable { chance } else { 0.0 },
        })
    }
}

/// Probability that values of one source are disjoint: the extreme case of the two-sided rank test.
fn chance_apart([before, after]: [usize; 2]) -> f64 {
    let ways = binomial((before + after) as u64, after as u64);
    // Limited for an empty side and for one value each, which are always disjoint.
    (2.0 / ways).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[rustfmt::skip]
    fn the_class_of_a_change_follows_from_its_rounds() {
        use crate::metric::Better::{Higher, Lower};
        let (low, high): (&[f64], &[f64]) = (&[1.0, 2.0, 3.0], &[3.1, 4.0, 5.0]);
        for (better, before, after, class) in [
            (Lower, low, high, Worse),
            (Lower, high, low, Improved),
            (Higher, low, high, Improved),
            (Higher, high, low, Worse),
            // Ranges that touch; then a change of 2 % with disjoint rounds.
            (Lower, low, &[3.0, 4.0, 5.0], WithinNoise),
            (Lower, &[100.0, 100.1, 100.2], &[101.9, 102.0, 102.05], WithinNoise),
            // From zero, every change counts.
            (Lower, &[0.0, 0.0, 0.0], &[4.0, 5.0, 6.0], Worse),
            (Lower, &[0.0, 0.0, 0.0], &[0.0, 0.0, 0.0], WithinNoise),
            // Too few rounds; then single values, without an estimate of chance.
            (Lower, &[1.0, 1.0], &[9.0, 9.0, 9.0], TooFewRounds),
            (Lower, &[1.0], &[9.0, 9.0, 9.0], TooFewRounds),
            (Lower, &[100.0], &[102.0], OneValueAlike),
            (Lower, &[100.0], &[103.0], OneValueWorse),
            (Lower, &[100.0], &[97.0], OneValueBetter),
            (Lower, &[0.0], &[1e-9], OneValueWorse),
        ] {
            let [before, after] = [before, after].map(|rounds| Metric::new("a", "µs", better, rounds.iter().copied()));
            let found = Change::of(&before, &after).expect("both have values");
            assert_eq!(found.class, class, "{found:?}");
            let is_change = [Worse, Improved, WithinNoise].contains(&class);
            assert_eq!(found.false_alarm > 0.0, is_change, "{found:?}");
        }
    }
}
