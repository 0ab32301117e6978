//! What became of one number between two runs.

use serde::Serialize;

use crate::metric::{Better, Metric, median, range};
use crate::named::named;

/// Rounds that each run needs: with fewer, two ranges are apart too often by chance.
const ROUNDS_MIN: usize = 3;
/// A smaller change of the median is of no account, however small the spread \[%\].
pub const LEAST_CHANGE_PERCENT: f64 = 2.0;

named! {
    /// What became of a number. One value: each run has a single one, and no chance can be told.
    pub enum Verdict {
        Worse = "worse",
        Better = "better",
        OneValueWorse = "one-value-worse",
        OneValueBetter = "one-value-better",
        WithinNoise = "within-noise",
        TooFewRounds = "too-few-rounds",
        OneValueAlike = "one-value-alike",
    }
}

impl Verdict {
    pub(super) fn is_change(self) -> bool {
        self < Self::WithinNoise
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Spread {
    pub median: f64,
    pub range: (f64, f64),
    pub rounds: usize,
}

impl Spread {
    fn of(rounds: &[f64]) -> Option<Self> {
        Some(Self {
            median: median(rounds.iter().copied())?,
            range: range(rounds.iter().copied())?,
            rounds: rounds.len(),
        })
    }
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Change {
    pub name: String,
    pub unit: String,
    pub better: Better,
    pub before: Spread,
    pub after: Spread,
    /// Of the median \[%\]; none from zero.
    pub change_percent: Option<f64>,
    pub verdict: Verdict,
    /// When the rounds of the two runs are apart: how probable that is if nothing changed.
    pub chance: Option<f64>,
}

impl Change {
    /// Of a number that both runs measured at least once.
    pub(super) fn of(old: &Metric, new: &Metric) -> Option<Self> {
        let (before, after) = (Spread::of(&old.rounds)?, Spread::of(&new.rounds)?);
        let difference = after.median - before.median;
        let change_percent =
            (before.median != 0.0).then(|| 100.0 * difference / before.median.abs());
        let is_small = change_percent.is_some_and(|percent| percent.abs() <= LEAST_CHANGE_PERCENT);
        let is_apart = before.range.1 < after.range.0 || after.range.1 < before.range.0;
        let is_better = (new.better == Better::Lower) == (difference < 0.0);
        let is_one_value = (before.rounds, after.rounds) == (1, 1);
        let (same, better, worse) = match before.rounds.min(after.rounds) {
            _ if is_one_value => (
                Verdict::OneValueAlike,
                Verdict::OneValueBetter,
                Verdict::OneValueWorse,
            ),
            ..ROUNDS_MIN => (
                Verdict::TooFewRounds,
                Verdict::TooFewRounds,
                Verdict::TooFewRounds,
            ),
            _ => (Verdict::WithinNoise, Verdict::Better, Verdict::Worse),
        };
        Some(Self {
            name: new.name.clone(),
            unit: new.unit.clone(),
            better: new.better,
            change_percent,
            verdict: match is_apart && !is_small {
                false => same,
                true if is_better => better,
                true => worse,
            },
            chance: (is_apart && !is_one_value).then(|| chance_apart(before.rounds, after.rounds)),
            before,
            after,
        })
    }

    /// How probable it is that this number is called changed though nothing changed.
    pub(super) fn false_alarm(&self) -> f64 {
        match self.verdict {
            Verdict::Worse | Verdict::Better | Verdict::WithinNoise => {
                chance_apart(self.before.rounds, self.after.rounds)
            }
            _ => 0.0,
        }
    }

    /// By which the larger ones come first; from zero, every change is large.
    pub(super) fn size(&self) -> f64 {
        match self.change_percent {
            _ if !self.verdict.is_change() => 0.0,
            Some(percent) => percent.abs(),
            None => f64::INFINITY,
        }
    }
}

/// Probability that `before` and `after` values of one source lie apart: 2 · n! · m! / (n + m)!, the two-sided
/// rank test at its extreme.
pub(super) fn chance_apart(before: usize, after: usize) -> f64 {
    let ways = (1..=after).fold(1.0, |ways, i| ways * (before + i) as f64 / i as f64);
    // With none on one side, and for one value each, they are always apart.
    (2.0 / ways).min(1.0)
}
