//! What changed between two runs beyond the noise of their rounds.
//!
//! The rounds of a run are taken in turns with its baselines, so their range shows what the machine does to a
//! number that nobody touched. A number is called changed when the ranges of the two runs are apart and their
//! medians differ by more than [`LEAST_CHANGE_PERCENT`]. Numbers with one value in each run are told apart.

mod change;
mod input;
mod text;

use std::collections::BTreeMap;

pub use change::{Change, LEAST_CHANGE_PERCENT, ROUNDS_MIN, Spread, Verdict};
pub use input::Input;
use serde::Serialize;
pub use text::text;

use crate::environment::{Environment, Options, granted, told};
use crate::metric::Metric;

/// Chance has a spread of its own: so many more may get worse.
const WORSE_MARGIN: usize = 2;

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
    /// Numbers that only the run before has.
    pub only_before: Vec<String>,
    /// Numbers that only the run after has.
    pub only_after: Vec<String>,
}

impl Comparison {
    pub fn of(before: &Input, after: &Input) -> Self {
        let (old, new) = (by_name(&before.metrics), by_name(&after.metrics));
        let mut metrics: Vec<Change> = old
            .iter()
            .filter_map(|(key, metric)| Change::of(metric, new.get(key)?))
            .collect();
        metrics.sort_by(Change::cmp_by_weight);
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
        let half = (self.changed_by_chance / 2.0).ceil();
        half as usize + WORSE_MARGIN
    }

    /// How many numbers came out so.
    pub fn count(&self, verdict: Verdict) -> usize {
        let all = self.metrics.iter();
        all.filter(|change| change.verdict == verdict).count()
    }
}

/// A name, and the unit in which it is told: another unit is another number.
type Key<'a> = (&'a str, &'a str);

fn by_name(metrics: &[Metric]) -> BTreeMap<Key<'_>, &Metric> {
    let known = metrics.iter().filter(|metric| !metric.rounds.is_empty());
    known
        .map(|metric| ((&*metric.name, &*metric.unit), metric))
        .collect()
}

/// The names of `these` that are not among `others`.
fn missing(these: &BTreeMap<Key<'_>, &Metric>, others: &BTreeMap<Key<'_>, &Metric>) -> Vec<String> {
    let lone = these.keys().filter(|key| !others.contains_key(*key));
    lone.map(|(name, _)| (*name).to_owned()).collect()
}

/// Why two runs are no measure of each other.
fn warnings(before: &Input, after: &Input) -> Vec<String> {
    let mut warnings = machine_warnings(&before.environment, &after.environment);
    warnings.extend(options_warnings(
        before.options.as_ref(),
        after.options.as_ref(),
    ));
    warnings
}

/// A property of the machine, and how it is told.
type Property = (&'static str, fn(&Environment) -> String);

/// What differs between two machines that moves absolute times.
fn machine_warnings(before: &Environment, after: &Environment) -> Vec<String> {
    let properties: [Property; 10] = [
        ("build", build),
        ("processor", |it| it.processor.model.clone()),
        ("number of cores", |it| it.processor.cores.to_string()),
        ("governor", |it| told(it.processor.governor.clone())),
        ("virtual machine", Environment::virtual_words),
        ("kernel", |it| it.kernel.release.clone()),
        ("core isolation", |it| it.kernel.isolation_words()),
        ("clock source", |it| told(it.kernel.clock_source.clone())),
        ("right to real time", |it| granted(it.privileges.realtime)),
        ("right to lock memory", |it| {
            granted(it.privileges.lock_memory)
        }),
    ];
    let mut warnings: Vec<String> = properties
        .into_iter()
        .map(|(what, value)| (what, value(before), value(after)))
        .filter(|(_, old, new)| old != new)
        .map(|(what, old, new)| format!("another {what}: {old} before, {new} after"))
        .collect();
    if !warnings.is_empty() {
        warnings.push(
            "absolute times of the two runs cannot be compared then; the ratios to the bare loop, which each \
             run measured itself, can"
                .to_owned(),
        );
    }
    warnings
}

/// What the two runs were asked for. A file of an older version does not say.
fn options_warnings(before: Option<&Options>, after: Option<&Options>) -> Vec<String> {
    let (before, after) = match (before, after) {
        (Some(before), Some(after)) => (before, after),
        (None, None) => return Vec::new(),
        (before, _) => {
            let when = if before.is_none() { "before" } else { "after" };
            return vec![format!(
                "the run {when} does not say what it was asked for: it may have measured something else"
            )];
        }
    };
    let differing = before.differing(after).into_iter();
    let mut warnings: Vec<String> = differing
        .map(|(name, old, new)| {
            format!("asked for with another value of {name}: {old} before, {new} after")
        })
        .collect();
    if !warnings.is_empty() {
        warnings.push("numbers may differ for this reason alone, ratios too".to_owned());
    }
    warnings
}

fn build(environment: &Environment) -> String {
    let is_debug = environment.debug_build;
    if is_debug {
        "not optimised"
    } else {
        "optimised"
    }
    .to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn input(metrics: Vec<Metric>) -> Input {
        Input {
            environment: Environment::default(),
            options: None,
            metrics,
        }
    }

    #[test]
    fn every_number_is_in_one_list() {
        let before = input(vec![
            Metric::lower("same", "µs", [1.0, 1.1, 1.2]),
            Metric::lower("worse", "µs", [1.0, 1.1, 1.2]),
            Metric::lower("gone", "µs", [1.0]),
            Metric::lower("other unit", "µs", [1.0]),
            Metric::lower("empty", "µs", []),
        ]);
        let after = input(vec![
            Metric::lower("same", "µs", [1.1, 1.1, 1.3]),
            Metric::lower("worse", "µs", [2.0, 2.1, 2.2]),
            Metric::lower("new", "µs", [1.0]),
            Metric::lower("other unit", "ms", [1.0]),
            Metric::lower("empty", "µs", [1.0]),
        ]);
        let found = Comparison::of(&before, &after);
        let names: Vec<&str> = found.metrics.iter().map(|change| &*change.name).collect();
        assert_eq!(names, ["worse", "same"], "changed ones first");
        assert_eq!(
            (found.count(Verdict::Worse), found.count(Verdict::Better)),
            (1, 0)
        );
        assert_eq!(found.only_before, ["gone", "other unit"]);
        assert_eq!(found.only_after, ["empty", "new", "other unit"]);
        assert!(found.warnings.is_empty());
        // 2 of the 20 ways to deal six rounds leave three and three apart.
        assert!((found.changed_by_chance - 0.2).abs() < 1e-12, "{found:?}");
    }

    #[test]
    fn another_machine_is_told() {
        let before = input(Vec::new());
        let mut after = input(Vec::new());
        after.environment.kernel.release = "7.0".to_owned();
        after.environment.privileges.realtime = true;
        let warnings = Comparison::of(&before, &after).warnings;
        assert_eq!(warnings.len(), 3, "{warnings:?}");
        assert!(
            warnings[1].contains("refused before, granted after"),
            "{warnings:?}"
        );
        assert!(warnings[2].contains("bare loop"), "{warnings:?}");
    }

    #[test]
    fn other_options_are_told() {
        let asked = |json: &str| Input {
            options: serde_json::from_str(json).expect("options"),
            ..input(Vec::new())
        };
        let (few, many) = (asked(r#"{"rounds":"3"}"#), asked(r#"{"rounds":"6"}"#));
        assert!(Comparison::of(&few, &few).warnings.is_empty());
        let warnings = Comparison::of(&few, &many).warnings;
        assert_eq!(warnings.len(), 2, "{warnings:?}");
        let expected = "asked for with another value of rounds: 3 before, 6 after";
        assert_eq!(warnings[0], expected);
        let warnings = Comparison::of(&few, &input(Vec::new())).warnings;
        assert!(
            warnings[0].contains("the run after does not say"),
            "{warnings:?}"
        );
    }

    #[test]
    fn some_may_get_worse_by_chance() {
        let many = |from: f64| {
            let metric = |i| Metric::lower(format!("a/{i}"), "µs", [from, from + 1.0, from + 2.0]);
            input((0..31).map(metric).collect())
        };
        let found = Comparison::of(&many(10.0), &many(10.0));
        // 31 numbers, 10 % of which chance moves: half of 3.1, rounded up, and two.
        assert_eq!(found.worse_by_chance(), 4);
    }
}
