//! What changed between two runs beyond the noise of their rounds.
//!
//! The rounds of a run are taken in turns with its baselines, so their range shows what the machine does to a
//! number that nobody touched. A number is called changed when the ranges of the two runs are apart and their
//! medians differ by more than [`LEAST_CHANGE_PERCENT`].

mod change;
mod input;
mod text;

use std::collections::BTreeMap;

pub use change::{Change, LEAST_CHANGE_PERCENT, ROUNDS_MIN, Spread, Verdict};
pub use input::Input;
use serde::Serialize;
pub use text::text;

use crate::environment::Environment;
use crate::metric::Metric;

/// Two runs beside each other.
#[derive(Debug, Clone, Serialize)]
pub struct Comparison {
    /// The run before.
    pub before: Environment,
    /// The run after.
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
    /// Of two runs.
    pub fn of(before: &Input, after: &Input) -> Self {
        let (old, new) = (by_name(&before.metrics), by_name(&after.metrics));
        let mut metrics: Vec<Change> = old
            .iter()
            .filter_map(|(key, metric)| Change::of(metric, new.get(key)?))
            .collect();
        metrics.sort_by(Change::cmp_by_weight);
        Self {
            warnings: warnings(&before.environment, &after.environment),
            changed_by_chance: metrics.iter().map(Change::false_alarm).sum(),
            metrics,
            only_before: missing(&old, &new),
            only_after: missing(&new, &old),
            before: before.environment.clone(),
            after: after.environment.clone(),
        }
    }

    /// How many numbers came out so.
    pub fn count(&self, verdict: Verdict) -> usize {
        let all = self.metrics.iter();
        all.filter(|change| change.verdict == verdict).count()
    }
}

/// A name, and the unit in which it is told: another unit is another number.
type Key<'a> = (&'a str, &'a str);

/// Those that have a value.
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

/// What differs between two machines that moves absolute times.
fn warnings(before: &Environment, after: &Environment) -> Vec<String> {
    let pairs = [
        ("build", build(before), build(after)),
        (
            "processor",
            before.processor.model.clone(),
            after.processor.model.clone(),
        ),
        (
            "number of cores",
            before.processor.cores.to_string(),
            after.processor.cores.to_string(),
        ),
        (
            "kernel",
            before.kernel.release.clone(),
            after.kernel.release.clone(),
        ),
        ("right to real time", granted(before), granted(after)),
    ];
    let differing = pairs.into_iter().filter(|(_, old, new)| old != new);
    let mut warnings: Vec<String> = differing
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

fn build(environment: &Environment) -> String {
    let is_debug = environment.debug_build;
    if is_debug {
        "not optimised"
    } else {
        "optimised"
    }
    .to_owned()
}

fn granted(environment: &Environment) -> String {
    let is_granted = environment.privileges.realtime;
    if is_granted { "granted" } else { "refused" }.to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn input(metrics: Vec<Metric>) -> Input {
        Input {
            environment: Environment::default(),
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
}
