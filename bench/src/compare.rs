//! What changed between two runs beyond the noise of their rounds.
//!
//! The rounds of a run are taken in turns with its baselines, so their range shows what the machine does to a
//! number that nobody touched. A number is called changed when the ranges of the two runs are apart and their
//! medians differ by more than [`LEAST_CHANGE_PERCENT`]. Numbers with one value in each run are told apart.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::dataset::{Column, Sheet, fixed, shorted, signed, word};
use crate::environment::Environment;
use crate::metric::{Better, Metric, range};
use crate::named::named;
use crate::run_options::RunOptions;

/// Rounds that each run needs: with fewer, two ranges are apart too often by chance.
const ROUNDS_MIN: usize = 3;
/// A smaller change of the median is of no account, however small the spread \[%\].
pub const LEAST_CHANGE_PERCENT: f64 = 2.0;
/// Chance has a spread of its own: so many more may get worse.
const WORSE_MARGIN: usize = 2;
/// More names than this are not listed.
const NAMES_MAX: usize = 12;
const OTHER_MACHINE: &str = "absolute times of the two runs cannot be compared then; the ratios to the bare loop, which \
                             each run measured itself, can";
const OTHER_OPTIONS: &str = "numbers may differ for this reason alone, ratios too";

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

named! {
    /// What became of a number. One value: each run has a single one, and no chance can be told.
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

    /// By name and unit: another unit is another number.
    fn named(&self) -> BTreeMap<(&str, &str), &Metric> {
        let known = self
            .metrics
            .iter()
            .filter(|metric| !metric.rounds.is_empty());
        known
            .map(|metric| ((&*metric.name, &*metric.unit), metric))
            .collect()
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
        let (old, new) = (before.named(), after.named());
        let both = old
            .iter()
            .filter_map(|(key, metric)| Change::of(metric, new.get(key)?));
        let mut metrics: Vec<Change> = both.collect();
        metrics.sort_by(|one, other| {
            let by_verdict = one.verdict.cmp(&other.verdict);
            by_verdict
                .then(other.size.total_cmp(&one.size))
                .then(one.name.cmp(&other.name))
        });
        let names =
            |keys: Vec<&(&str, &str)>| keys.iter().map(|(name, _)| (*name).to_owned()).collect();
        Self {
            warnings: warnings(before, after),
            changed_by_chance: metrics.iter().map(|change| change.false_alarm).sum(),
            metrics,
            only_before: names(old.keys().filter(|key| !new.contains_key(*key)).collect()),
            only_after: names(new.keys().filter(|key| !old.contains_key(*key)).collect()),
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

    pub fn count(&self, verdict: ChangeClass) -> usize {
        self.metrics
            .iter()
            .filter(|change| change.verdict == verdict)
            .count()
    }

    /// Numbers that changed in a table, all others as counts.
    pub fn text(&self) -> Result<String> {
        let (before, after) = (self.before.run(), self.after.run());
        let mut text = format!("before: {before}\nafter:  {after}\n");
        for warning in &self.warnings {
            writeln!(text, "warning: {warning}")?;
        }
        let changed = self
            .metrics
            .iter()
            .filter(|change| change.verdict < ChangeClass::WithinNoise);
        let rows: Vec<Value> = changed.map(|change| json!(change)).collect();
        if rows.iter().all(|change| change["chance"].is_null()) {
            text.push_str("\nNothing changed beyond noise.\n");
        }
        if !rows.is_empty() {
            let title = format!(
                "Worse or better: the rounds of the two runs are apart, and their medians differ by more than \
                 {LEAST_CHANGE_PERCENT} %. With one value each, a change only where the number is exact"
            );
            write!(text, "\n{}", Sheet::of(&title, &COLUMNS, rows).text())?;
        }
        let counts =
            ChangeClass::ALL.map(|verdict| format!("{} {}", self.count(verdict), verdict.name()));
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

/// Why two runs are no measure of each other.
fn warnings(before: &Input, after: &Input) -> Vec<String> {
    let differing = before.environment.differing(&after.environment).into_iter();
    let mut warnings: Vec<String> = differing
        .map(|(what, old, new)| format!("another {what}: {old} before, {new} after"))
        .collect();
    if !warnings.is_empty() {
        warnings.push(OTHER_MACHINE.to_owned());
    }
    if let (Some(old), Some(new)) = (&before.options, &after.options) {
        let differing = old.differing(new);
        warnings.extend(differing.iter().map(|(name, old, new)| {
            format!("asked for with another value of {name}: {old} before, {new} after")
        }));
        warnings.extend((!differing.is_empty()).then(|| OTHER_OPTIONS.to_owned()));
    } else if before.options.is_some() || after.options.is_some() {
        let when = if before.options.is_none() {
            "before"
        } else {
            "after"
        };
        let words = "does not say what it was asked for: it may have measured something else";
        warnings.push(format!("the run {when} {words}"));
    }
    warnings
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Change {
    pub name: String,
    unit: String,
    better: Better,
    before: Value,
    after: Value,
    /// Of the median \[%\]; none from zero.
    #[serde(rename = "change_percent")]
    percent: Option<f64>,
    pub verdict: ChangeClass,
    /// When the rounds of the two runs are apart: how probable that is if nothing changed.
    chance: Option<f64>,
    /// How probable it is that this number is called changed though nothing changed.
    #[serde(skip)]
    false_alarm: f64,
    /// By which the larger changes come first; from zero, every change is large.
    #[serde(skip)]
    size: f64,
}

impl Change {
    /// Of a number that both runs measured at least once.
    fn of(old: &Metric, new: &Metric) -> Option<Self> {
        let [before, after] = [old, new]
            .map(|metric| Some((metric.median()?, range(metric.rounds.iter().copied())?)));
        let ((before, old_range), (after, new_range)) = (before?, after?);
        let (old_count, new_count) = (old.rounds.len(), new.rounds.len());
        let percent = (before != 0.0).then(|| 100.0 * (after - before) / before.abs());
        let is_small = percent.is_some_and(|percent| percent.abs() <= LEAST_CHANGE_PERCENT);
        let is_apart = old_range.1 < new_range.0 || new_range.1 < old_range.0;
        let is_better = (new.better == Better::Lower) == (after < before);
        let is_one_value = (old_count, new_count) == (1, 1);
        let [same, better, worse] = match old_count.min(new_count) {
            _ if is_one_value => [
                ChangeClass::OneValueAlike,
                ChangeClass::OneValueBetter,
                ChangeClass::OneValueWorse,
            ],
            ..ROUNDS_MIN => [ChangeClass::TooFewRounds; 3],
            _ => [
                ChangeClass::WithinNoise,
                ChangeClass::Better,
                ChangeClass::Worse,
            ],
        };
        let verdict = match is_apart && !is_small {
            false => same,
            true if is_better => better,
            true => worse,
        };
        let chance = chance_apart(old_count, new_count);
        let may_change = !is_one_value && verdict != ChangeClass::TooFewRounds;
        let spread = |median: f64, range, rounds: usize| json!({ "median": median, "range": range, "rounds": rounds });
        Some(Self {
            name: new.name.clone(),
            unit: new.unit.clone(),
            better: new.better,
            before: spread(before, old_range, old_count),
            after: spread(after, new_range, new_count),
            percent,
            verdict,
            chance: (is_apart && !is_one_value).then_some(chance),
            false_alarm: if may_change { chance } else { 0.0 },
            size: percent.map_or(f64::INFINITY, f64::abs),
        })
    }
}

/// Probability that `before` and `after` values of one source lie apart: 2 · n! · m! / (n + m)!, the two-sided
/// rank test at its extreme.
fn chance_apart(before: usize, after: usize) -> f64 {
    let ways = (1..=after).fold(1.0, |ways, i| ways * (before + i) as f64 / i as f64);
    // With none on one side, and for one value each, they are always apart.
    (2.0 / ways).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lower(name: &str, unit: &str, rounds: &[f64]) -> Metric {
        Metric::new(name, unit, Better::Lower, rounds.iter().copied())
    }

    #[test]
    #[rustfmt::skip]
    fn what_became_of_a_number_is_told_from_its_rounds() {
        use Better::{Higher, Lower};
        use ChangeClass::{Better as Improved, OneValueAlike, OneValueBetter, OneValueWorse, TooFewRounds, WithinNoise, Worse};
        let (low, high): (&[f64], &[f64]) = (&[1.0, 2.0, 3.0], &[3.1, 4.0, 5.0]);
        for (better, before, after, verdict) in [
            (Lower, low, high, Worse),
            (Lower, high, low, Improved),
            (Higher, low, high, Improved),
            (Higher, high, low, Worse),
            // Ranges that touch; a change of 2 %, though the rounds are apart.
            (Lower, low, &[3.0, 4.0, 5.0], WithinNoise),
            (Lower, &[100.0, 100.1, 100.2], &[101.9, 102.0, 102.05], WithinNoise),
            // From zero every change counts.
            (Lower, &[0.0, 0.0, 0.0], &[4.0, 5.0, 6.0], Worse),
            (Lower, &[0.0, 0.0, 0.0], &[0.0, 0.0, 0.0], WithinNoise),
            // Two rounds prove nothing, and single values nothing of chance.
            (Lower, &[1.0, 1.0], &[9.0, 9.0, 9.0], TooFewRounds),
            (Lower, &[1.0], &[9.0, 9.0, 9.0], TooFewRounds),
            (Lower, &[100.0], &[102.0], OneValueAlike),
            (Lower, &[100.0], &[103.0], OneValueWorse),
            (Lower, &[100.0], &[97.0], OneValueBetter),
            (Lower, &[0.0], &[1e-9], OneValueWorse),
        ] {
            let [before, after] = [before, after].map(|rounds| Metric::new("a", "µs", better, rounds.iter().copied()));
            let found = Change::of(&before, &after).expect("both have values");
            assert_eq!(found.verdict, verdict, "{found:?}");
            let is_change = [Worse, Improved, WithinNoise].contains(&verdict);
            assert_eq!(found.false_alarm > 0.0, is_change, "{found:?}");
        }
    }

    #[test]
    fn the_chance_is_that_of_the_rank_test() {
        for (before, after, expected) in [
            (3, 3, 0.1),
            (1, 1, 1.0),
            (5, 5, 2.0 / 252.0),
            (3, 6, 2.0 / 84.0),
        ] {
            for found in [chance_apart(before, after), chance_apart(after, before)] {
                assert!(
                    (found - expected).abs() < 1e-12,
                    "{before}, {after}: {found}"
                );
            }
        }
    }

    fn input(metrics: &[(&str, &str, &[f64])]) -> Input {
        Input {
            environment: Environment::default(),
            options: None,
            metrics: metrics
                .iter()
                .map(|(name, unit, rounds)| lower(name, unit, rounds))
                .collect(),
        }
    }

    #[test]
    fn every_number_is_in_one_list() {
        let one: &[f64] = &[1.0, 1.1, 1.2];
        let before = [
            ("same", "µs", one),
            ("worse", "µs", one),
            ("gone", "µs", one),
            ("other unit", "µs", one),
            ("empty", "µs", &[]),
        ];
        let worse: &[f64] = &[2.0, 2.1, 2.2];
        let after = [
            ("same", "µs", one),
            ("worse", "µs", worse),
            ("new", "µs", one),
            ("other unit", "ms", one),
            ("empty", "µs", one),
        ];
        let found = Comparison::of(&input(&before), &input(&after));
        let names: Vec<&str> = found.metrics.iter().map(|change| &*change.name).collect();
        assert_eq!(names, ["worse", "same"], "changed ones first");
        assert_eq!(found.only_before, ["gone", "other unit"]);
        assert_eq!(found.only_after, ["empty", "new", "other unit"]);
        assert!(found.warnings.is_empty());
        // 2 of the 20 ways to deal six rounds leave three and three apart.
        assert!((found.changed_by_chance - 0.2).abs() < 1e-12, "{found:?}");
    }

    #[test]
    fn another_machine_and_other_options_are_told() {
        let run = |release: &str, rounds: Option<&str>| Input {
            environment: serde_json::from_value(json!({ "kernel": { "release": release } }))
                .expect("a machine"),
            options: rounds
                .map(|n| serde_json::from_value(json!({ "rounds": n })).expect("options")),
            ..input(&[])
        };
        let few = run("6.1", Some("3"));
        for (other, words) in [
            (run("6.1", Some("3")), &[][..]),
            (
                run("7.0", Some("3")),
                &["another kernel release: \"6.1\" before", "bare loop"],
            ),
            (
                run("6.1", Some("6")),
                &[
                    "another value of rounds: 3 before, 6 after",
                    "for this reason",
                ],
            ),
            (run("6.1", None), &["the run after does not say"]),
        ] {
            let warnings = Comparison::of(&few, &other).warnings;
            assert_eq!(warnings.len(), words.len(), "{warnings:?}");
            let mut pairs = warnings.iter().zip(words);
            assert!(
                pairs.all(|(warning, words)| warning.contains(words)),
                "{warnings:?}"
            );
        }
    }

    #[test]
    fn some_may_get_worse_by_chance() {
        let names: Vec<String> = (0..31).map(|i| format!("a/{i}")).collect();
        let metrics: Vec<_> = names
            .iter()
            .map(|name| (&**name, "µs", &[10.0, 11.0, 12.0][..]))
            .collect();
        // 31 numbers, 10 % of which chance moves: half of 3.1, rounded up, and two.
        assert_eq!(
            Comparison::of(&input(&metrics), &input(&metrics)).worse_by_chance(),
            4
        );
    }
}
