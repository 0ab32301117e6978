//! One number in two runs.

use std::cmp::Ordering;

use serde::Serialize;

use crate::metric::{Better, Metric, median, range};

/// Rounds that each run needs: with fewer, two ranges are apart too often by chance.
pub const ROUNDS_MIN: usize = 3;

/// A smaller change of the median is of no account, however small the spread \[%\].
pub const LEAST_CHANGE_PERCENT: f64 = 2.0;

/// What became of a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// It changed for the worse, beyond noise.
    Worse,
    /// It changed for the better, beyond noise.
    Better,
    /// It did not change, as far as can be told.
    WithinNoise,
    /// One of the runs has fewer than [`ROUNDS_MIN`] rounds.
    TooFewRounds,
}

impl Verdict {
    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Worse => "worse",
            Self::Better => "better",
            Self::WithinNoise => "within noise",
            Self::TooFewRounds => "too few rounds",
        }
    }

    /// Whether it changed beyond noise.
    pub fn is_changed(self) -> bool {
        matches!(self, Self::Worse | Self::Better)
    }
}

/// The rounds of one run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Spread {
    /// Median.
    pub median: f64,
    /// Smallest.
    pub min: f64,
    /// Largest.
    pub max: f64,
    /// How many.
    pub rounds: usize,
}

impl Spread {
    /// Of at least one round.
    fn of(rounds: &[f64]) -> Option<Self> {
        let (min, max) = range(rounds)?;
        Some(Self {
            median: median(rounds)?,
            min,
            max,
            rounds: rounds.len(),
        })
    }

    fn is_apart_from(&self, other: &Self) -> bool {
        self.max < other.min || other.max < self.min
    }
}

/// One number before and after.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Change {
    /// What it is.
    pub name: String,
    /// Its unit; empty for a ratio.
    pub unit: String,
    /// Which way is better.
    pub better: Better,
    /// Before.
    pub before: Spread,
    /// After.
    pub after: Spread,
    /// Of the median \[%\]; none from zero.
    pub change_percent: Option<f64>,
    /// What became of it.
    pub verdict: Verdict,
    /// When the rounds of the two runs are apart: how probable that is if nothing changed.
    pub chance: Option<f64>,
}

impl Change {
    /// Of a number that both runs measured at least once.
    pub(super) fn of(before: &Metric, after: &Metric) -> Option<Self> {
        let (old, new) = (Spread::of(&before.rounds)?, Spread::of(&after.rounds)?);
        let is_apart = old.is_apart_from(&new);
        Some(Self {
            name: after.name.clone(),
            unit: after.unit.clone(),
            better: after.better,
            change_percent: change_percent(old.median, new.median),
            verdict: verdict(&old, &new, after.better),
            chance: is_apart.then(|| chance_apart(old.rounds, new.rounds)),
            before: old,
            after: new,
        })
    }

    /// How probable it is that this number is called changed though nothing changed.
    pub(super) fn false_alarm(&self) -> f64 {
        match self.verdict {
            Verdict::TooFewRounds => 0.0,
            _ => chance_apart(self.before.rounds, self.after.rounds),
        }
    }

    /// Worse before better before unchanged; among the changed ones, larger changes first.
    pub(super) fn cmp_by_weight(&self, other: &Self) -> Ordering {
        let rank = |change: &Self| match change.verdict {
            Verdict::Worse => 0,
            Verdict::Better => 1,
            Verdict::WithinNoise => 2,
            Verdict::TooFewRounds => 3,
        };
        // From zero, every change is large.
        let size = |change: &Self| match change.change_percent {
            _ if !change.verdict.is_changed() => 0.0,
            Some(percent) => percent.abs(),
            None => f64::INFINITY,
        };
        rank(self)
            .cmp(&rank(other))
            .then(size(other).total_cmp(&size(self)))
            .then_with(|| self.name.cmp(&other.name))
    }
}

fn change_percent(before: f64, after: f64) -> Option<f64> {
    (before != 0.0).then(|| 100.0 * (after - before) / before.abs())
}

fn verdict(before: &Spread, after: &Spread, better: Better) -> Verdict {
    if before.rounds.min(after.rounds) < ROUNDS_MIN {
        return Verdict::TooFewRounds;
    }
    let percent = change_percent(before.median, after.median);
    let is_small = percent.is_some_and(|percent| percent.abs() <= LEAST_CHANGE_PERCENT);
    if is_small || !before.is_apart_from(after) {
        return Verdict::WithinNoise;
    }
    let is_better = match better {
        Better::Lower => after.median < before.median,
        Better::Higher => after.median > before.median,
    };
    if is_better {
        Verdict::Better
    } else {
        Verdict::Worse
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

    fn change(better: Better, before: &[f64], after: &[f64]) -> Change {
        let metric = |rounds: &[f64]| Metric {
            name: "a".to_owned(),
            unit: "µs".to_owned(),
            better,
            rounds: rounds.to_vec(),
        };
        Change::of(&metric(before), &metric(after)).expect("both have values")
    }

    #[test]
    fn ranges_that_touch_are_noise() {
        let found = change(Better::Lower, &[1.0, 2.0, 3.0], &[3.0, 4.0, 5.0]);
        assert_eq!((found.verdict, found.chance), (Verdict::WithinNoise, None));
        assert_eq!(found.change_percent, Some(100.0));
    }

    #[test]
    fn apart_is_changed_and_the_metric_says_which_way_is_better() {
        let (low, high) = ([1.0, 2.0, 3.0], [3.1, 4.0, 5.0]);
        for (better, before, after, expected) in [
            (Better::Lower, low, high, Verdict::Worse),
            (Better::Lower, high, low, Verdict::Better),
            (Better::Higher, low, high, Verdict::Better),
            (Better::Higher, high, low, Verdict::Worse),
        ] {
            assert_eq!(change(better, &before, &after).verdict, expected);
        }
    }

    #[test]
    fn a_change_of_two_percent_is_of_no_account() {
        let found = change(
            Better::Lower,
            &[100.0, 100.1, 100.2],
            &[101.9, 102.0, 102.05],
        );
        assert_eq!(found.verdict, Verdict::WithinNoise);
        assert!(found.chance.is_some(), "though the rounds are apart");
    }

    #[test]
    fn from_zero_every_change_counts() {
        let found = change(Better::Lower, &[0.0, 0.0, 0.0], &[4.0, 5.0, 6.0]);
        assert_eq!(
            (found.verdict, found.change_percent),
            (Verdict::Worse, None)
        );
        let same = change(Better::Lower, &[0.0, 0.0, 0.0], &[0.0, 0.0, 0.0]);
        assert_eq!(same.verdict, Verdict::WithinNoise);
    }

    #[test]
    fn two_rounds_prove_nothing() {
        let found = change(Better::Lower, &[1.0, 1.0], &[9.0, 9.0, 9.0]);
        assert_eq!(found.verdict, Verdict::TooFewRounds);
    }

    #[test]
    fn the_chance_is_that_of_the_rank_test() {
        for (before, after, expected) in [
            (3, 3, 0.1),
            (1, 1, 1.0),
            (5, 5, 2.0 / 252.0),
            (3, 6, 2.0 / 84.0),
        ] {
            let found = chance_apart(before, after);
            assert!(
                (found - expected).abs() < 1e-12,
                "{before}, {after}: {found}"
            );
            assert!((chance_apart(after, before) - expected).abs() < 1e-12);
        }
    }
}
