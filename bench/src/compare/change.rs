//! Change of one number between two runs.

use serde::Serialize;
use serde_json::{Value, json};
use statrs::function::factorial::binomial;

use crate::metric::{Better, Metric};
use crate::named::named;
use ChangeClass::{
    Better as Improved, OneValueAlike, OneValueBetter, OneValueWorse, TooFewRounds, WithinNoise,
    Worse,
};

/// Rounds that each run needs: with fewer, two ranges are too often disjoint by chance.
const ROUNDS_MIN: usize = 3;
/// Smaller changes of the median are ignored, however small the spread \[%\].
pub(super) const LEAST_CHANGE_PERCENT: f64 = 2.0;

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

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Change {
    name: String,
    unit: String,
    better: Better,
    before: Value,
    after: Value,
    /// Change of the median \[%\]; `None` from zero.
    #[serde(rename = "change_percent")]
    pub(super) percent: Option<f64>,
    #[serde(rename = "verdict")]
    pub(super) class: ChangeClass,
    /// Probability that the rounds are disjoint by chance, if they are disjoint.
    pub(super) chance: Option<f64>,
    /// Probability that this number is classified as changed although nothing has changed.
    #[serde(skip)]
    pub(super) false_alarm: f64,
}

impl Change {
    /// `None` without a value in one of the runs.
    pub(super) fn new(old: &Metric, new: &Metric) -> Option<Self> {
        let (before, after) = (old.median()?, new.median()?);
        let (old_range, new_range) = (old.range()?, new.range()?);
        let rounds = [old, new].map(|metric| metric.rounds.len());
        let percent = (before != 0.0).then(|| 100.0 * (after - before) / before.abs());
        let is_large = percent.is_none_or(|percent| percent.abs() > LEAST_CHANGE_PERCENT);
        let is_apart = old_range.1 < new_range.0 || new_range.1 < old_range.0;
        let is_better = (new.better == Better::Lower) == (after < before);
        // Probability that values of one source are disjoint: the extreme case of the two-sided rank test. One value
        // each is always disjoint.
        let ways = binomial((rounds[0] + rounds[1]) as u64, rounds[0] as u64);
        let chance = (2.0 / ways).min(1.0);
        let is_comparable = rounds.iter().all(|count| *count >= ROUNDS_MIN);
        let [same, worse, better] = match rounds {
            [1, 1] => [OneValueAlike, OneValueWorse, OneValueBetter],
            _ if is_comparable => [WithinNoise, Worse, Improved],
            _ => [TooFewRounds; 3],
        };
        let changed = if is_better { better } else { worse };
        Some(Self {
            name: new.name.clone(),
            unit: new.unit.clone(),
            better: new.better,
            before: json!({ "median": before, "range": old_range, "rounds": rounds[0] }),
            after: json!({ "median": after, "range": new_range, "rounds": rounds[1] }),
            percent,
            class: if is_apart && is_large { changed } else { same },
            chance: (is_apart && rounds != [1, 1]).then_some(chance),
            false_alarm: if is_comparable { chance } else { 0.0 },
        })
    }
}
