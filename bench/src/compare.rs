//! Changes between two runs beyond the noise of their rounds.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use serde::Deserialize;
use serde_json::{Value, json};
use statrs::function::factorial::binomial;

use crate::dataset::{Dataset, number};
use crate::environment::Environment;
use crate::metric::{Better, Metric};
use crate::named::named;
use crate::run_options::RunOptions;
use ChangeClass::{
    Improved, OneValueAlike, OneValueBetter, OneValueWorse, TooFewRounds, WithinNoise, Worse,
};

/// Rounds that each run needs: with fewer, two ranges are too often disjoint by chance.
const ROUNDS_MIN: usize = 3;
/// Smaller changes of the median are ignored, however small the spread \[%\].
const LEAST_CHANGE_PERCENT: f64 = 2.0;
/// Numbers that may get worse in addition, because the number of chance changes varies, too.
const WORSE_MARGIN: usize = 2;
const NAMES_MAX: usize = 12;
const EXPECTED: &str = "one JSON object with \"environment\" and \"metrics\", as --format json prints it and --out \
                        writes it";
const OTHER_MACHINE: &str = "absolute times of the two runs cannot be compared then; the ratios to the bare loop, which \
                             each run measured itself, can";
const OTHER_OPTIONS: &str = "numbers may differ for this reason alone, ratios too";

named! {
    /// Classification of a number. `OneValue…`: each run has a single value, so chance cannot be estimated.
    pub enum ChangeClass {
        Worse = "worse",
        Improved = "better",
        OneValueWorse = "one-value-worse",
        OneValueBetter = "one-value-better",
        WithinNoise = "within-noise",
        TooFewRounds = "too-few-rounds",
        OneValueAlike = "one-value-alike",
    }
}

#[derive(Debug, Clone, Default, Deserialize)]
pub struct Input {
    pub environment: Environment,
    /// Empty in a file of an older version.
    #[serde(default)]
    pub options: RunOptions,
    pub metrics: Vec<Metric>,
}

impl Input {
    pub fn read(file: &Path) -> Result<Self> {
        let name = file.display();
        let text = fs::read_to_string(file).with_context(|| format!("cannot read {name}"))?;
        let wrong = || format!("{name} is not a result of cdcr-bench: expected {EXPECTED}");
        serde_json::from_str(&text).with_context(wrong)
    }

    fn named(&self) -> Named<'_> {
        let known = self.metrics.iter().filter(|it| !it.rounds.is_empty());
        known.map(|it| ((&*it.name, &*it.unit), it)).collect()
    }
}

/// Metrics by name and unit; a number with another unit is another number.
type Named<'a> = BTreeMap<(&'a str, &'a str), &'a Metric>;

/// A number of both runs: its class, the probability that it is called changed by chance, and its row.
type Change = (ChangeClass, f64, Value);

pub struct Comparison {
    pub dataset: Dataset,
    verdicts: Vec<ChangeClass>,
    /// Expected count of numbers classified as changed if nothing has changed.
    pub changed_by_chance: f64,
}

impl Comparison {
    pub fn of(before: &Input, after: &Input) -> Self {
        let (old, new) = (before.named(), after.named());
        let both = |(key, old): (_, &&Metric)| change(old, new.get(key)?);
        let mut changes: Vec<Change> = old.iter().filter_map(both).collect();
        // From zero, every change is large.
        let percent = |(.., row): &Change| number(row, "change_percent");
        let size = |change: &Change| percent(change).map_or(f64::INFINITY, f64::abs);
        // Changed ones first, worst on top; stable: in the order of the names otherwise.
        changes.sort_by(|one, other| size(other).total_cmp(&size(one)));
        changes.sort_by_key(|(verdict, ..)| *verdict);
        let mut dataset = Dataset::new("compare", include_str!("compare.toml"));
        let mut runs = Vec::new();
        let both = [("before", before, &old, &new), ("after", after, &new, &old)];
        for (when, run, own, other) in both {
            let only = own.keys().filter(|key| !other.contains_key(*key));
            let only: Vec<&str> = only.map(|(name, _)| *name).collect();
            let (words, first) = (run.environment.run(), &only[..only.len().min(NAMES_MAX)]);
            runs.push(json!({ "when": when, "run": words, "only": only.len(), "first": first }));
            dataset.fact(when, json!(run.environment));
            dataset.fact(&format!("only_{when}"), only);
        }
        dataset.add("runs", runs);
        let changed = changes.partition_point(|(verdict, ..)| *verdict < WithinNoise);
        if changed > 0 {
            let rows = changes[..changed].iter().map(|(.., row)| row.clone());
            let least = LEAST_CHANGE_PERCENT.to_string();
            dataset.add_titled("changes", &[&least], rows.collect());
        }
        let changed_by_chance = changes.iter().map(|(_, by_chance, _)| by_chance).sum();
        let verdicts = changes.iter().map(|(verdict, ..)| *verdict).collect();
        let warnings = warnings(before, after);
        let lines = warnings.iter().map(|words| format!("warning: {words}\n"));
        let lines: String = lines.collect();
        dataset.fact("warnings", warnings);
        dataset.fact("changed_by_chance", changed_by_chance);
        let rows = changes.into_iter().map(|(.., row)| row);
        dataset.add("metrics", rows.collect());
        let mut comparison = Self {
            dataset,
            verdicts,
            changed_by_chance,
        };
        comparison.dataset.note = lines + &comparison.summary();
        comparison
    }

    /// How many numbers may get worse by chance: half of those that change by chance, and a margin.
    pub fn worse_by_chance(&self) -> usize {
        (self.changed_by_chance / 2.0).ceil() as usize + WORSE_MARGIN
    }

    pub fn count(&self, verdict: ChangeClass) -> usize {
        self.verdicts.iter().filter(|it| **it == verdict).count()
    }

    fn summary(&self) -> String {
        let count = |class| format!("{} {}", self.count(class), class.name());
        let counts = ChangeClass::ALL.map(count).join(", ");
        let nothing = if self.count(TooFewRounds) == self.verdicts.len() {
            "Nothing can be compared: too few rounds.\n"
        } else if self.count(Worse) + self.count(Improved) == 0 {
            "Nothing changed beyond noise.\n"
        } else {
            ""
        };
        format!(
            "{nothing}{counts}.\nWithout any change up to {:.1} of these would be called worse or better, by chance \
             alone; more rounds make it rarer (5 in each run: 1 of 126).",
            self.changed_by_chance
        )
    }
}

fn warnings(before: &Input, after: &Input) -> Vec<String> {
    let mut warnings = Vec::new();
    let machines = [before, after].map(|run| run.environment.moving());
    let options = [before, after].map(|run| run.options.clone());
    for (kind, [old, new], consequence) in [
        ("", machines, OTHER_MACHINE),
        ("value of ", options, OTHER_OPTIONS),
    ] {
        let mut names: BTreeSet<&String> = old.keys().chain(new.keys()).collect();
        names.retain(|name| old.get(*name) != new.get(*name));
        for name in names {
            let of = |run: &RunOptions| run.get(name).cloned().unwrap_or("none".to_owned());
            let (old, new) = (of(&old), of(&new));
            warnings.push(format!("another {kind}{name}: {old} before, {new} after"));
        }
        warnings.extend((old != new).then(|| consequence.to_owned()));
    }
    warnings
}

fn change(old: &Metric, new: &Metric) -> Option<Change> {
    let (before, after) = (old.median()?, new.median()?);
    let (old_range, new_range) = (old.range()?, new.range()?);
    let counts = [old.rounds.len(), new.rounds.len()];
    let percent = (before != 0.0).then(|| 100.0 * (after - before) / before.abs());
    let is_small = percent.is_some_and(|percent| percent.abs() <= LEAST_CHANGE_PERCENT);
    let is_apart = old_range.1 < new_range.0 || new_range.1 < old_range.0;
    let is_better = (new.better == Better::Lower) == (after < before);
    let is_judged = counts.iter().all(|count| *count >= ROUNDS_MIN);
    let classes = match counts {
        [1, 1] => [OneValueAlike, OneValueBetter, OneValueWorse],
        _ if is_judged => [WithinNoise, Improved, Worse],
        _ => [TooFewRounds; 3],
    };
    let (is_changed, chance) = (is_apart && !is_small, chance_apart(counts));
    let verdict = classes[usize::from(is_changed) * (2 - usize::from(is_better))];
    let row = json!({
        "name": new.name,
        "unit": new.unit,
        "better": new.better,
        "before": { "median": before, "range": old_range, "rounds": counts[0] },
        "after": { "median": after, "range": new_range, "rounds": counts[1] },
        "change_percent": percent,
        "verdict": verdict,
        // That the rounds are disjoint by chance, if they are disjoint.
        "chance": (is_apart && counts != [1, 1]).then_some(chance),
    });
    Some((verdict, if is_judged { chance } else { 0.0 }, row))
}

/// Probability that values of one source are disjoint: the extreme case of the two-sided rank test.
fn chance_apart([before, after]: [usize; 2]) -> f64 {
    let ways = binomial((before + after) as u64, after as u64);
    // Limited for an empty side and for one value each, which are always disjoint.
    (2.0 / ways).min(1.0)
}
