//! One number in two runs.

use std::cmp::Ordering;

use serde::Serialize;

use crate::metric::{Better, Metric, median, range};

/// Rounds that each run needs: with fewer, two ranges are apart too often by chance.
pub const ROUNDS_MIN: usize = 3;

/// A smaller change of the median is of no account, however small the spread \[%\].
pub const LEAST_CHANGE_PERCENT: f64 = 2.0;

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
    /// Each run has a single value, and that of the later one is worse by more than [`LEAST_CHANGE_PERCENT`].
    OneValueWorse,
    /// The same, and it is better.
    OneValueBetter,
    /// Each run has a single value, and they are alike.
    OneValueAlike,
}

impl Verdict {
    pub fn words(self) -> &'static str {
        match self {
            Self::Worse | Self::OneValueWorse => "worse",
            Self::Better | Self::OneValueBetter => "better",
            Self::WithinNoise => "within noise",
            Self::TooFewRounds => "too few rounds",
            Self::OneValueAlike => "alike",
        }
    }

    pub fn is_changed(self) -> bool {
        matches!(self, Self::Worse | Self::Better)
    }

    pub fn is_one_value_other(self) -> bool {
        matches!(self, Self::OneValueWorse | Self::OneValueBetter)
    }

    /// Whether a range of rounds is behind it, enough of them in each run.
    fn is_of_rounds(self) -> bool {
        matches!(self, Self::Worse | Self::Better | Self::WithinNoise)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Spread {
    pub median: f64,
    pub min: f64,
    pub max: f64,
    pub rounds: usize,
}

impl Spread {
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

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Change {
    pub name: String,
    /// Its unit; empty for a ratio.
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
    pub(super) fn of(before: &Metric, after: &Metric) -> Option<Self> {
        let (old, new) = (Spread::of(&before.rounds)?, Spread::of(&after.rounds)?);
        let verdict = verdict(&old, &new, after.better);
        let is_apart = verdict != Verdict::OneValueAlike
            && !verdict.is_one_value_other()
            && old.is_apart_from(&new);
        Some(Self {
            name: after.name.clone(),
            unit: after.unit.clone(),
            better: after.better,
            change_percent: change_percent(old.median, new.median),
            verdict,
            chance: is_apart.then(|| chance_apart(old.rounds, new.rounds)),
            before: old,
            after: new,
        })
    }

    /// How probable it is that this number is called changed though nothing changed.
    pub(super) fn false_alarm(&self) -> f64 {
        if self.verdict.is_of_rounds() {
            chance_apart(self.before.rounds, self.after.rounds)
        } else {
            0.0
        }
    }

    /// Worse before better before unchanged; among the changed ones, larger changes first.
    pub(super) fn cmp_by_weight(&self, other: &Self) -> Ordering {
        let rank = |change: &Self| match change.verdict {
            Verdict::Worse => 0,
            Verdict::Better => 1,
            Verdict::OneValueWorse => 2,
            Verdict::OneValueBetter => 3,
            Verdict::WithinNoise => 4,
            Verdict::TooFewRounds => 5,
            Verdict::OneValueAlike => 6,
        };
        // From zero, every change is large.
        let size = |change: &Self| match change.change_percent {
            _ if !change.verdict.is_changed() && !change.verdict.is_one_value_other() => 0.0,
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
    let is_one_value = (before.rounds, after.rounds) == (1, 1);
    if before.rounds.min(after.rounds) < ROUNDS_MIN && !is_one_value {
        return Verdict::TooFewRounds;
    }
    let percent = change_percent(before.median, after.median);
    let is_small = percent.is_some_and(|percent| percent.abs() <= LEAST_CHANGE_PERCENT);
    let is_same = is_small || !before.is_apart_from(after);
    let is_better = match better {
        Better::Lower => after.median < before.median,
        Better::Higher => after.median > before.median,
    };
    match (is_one_value, is_same, is_better) {
        (false, true, _) => Verdict::WithinNoise,
        (false, false, true) => Verdict::Better,
        (false, false, false) => Verdict::Worse,
        (true, true, _) => Verdict::OneValueAlike,
        (true, false, true) => Verdict::OneValueBetter,
        (true, false, false) => Verdict::OneValueWorse,
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
    fn single_values_are_compared_directly_and_prove_nothing_of_chance() {
        for (before, after, verdict) in [
            (100.0, 102.0, Verdict::OneValueAlike),
            (100.0, 103.0, Verdict::OneValueWorse),
            (100.0, 97.0, Verdict::OneValueBetter),
            (0.0, 0.0, Verdict::OneValueAlike),
            (0.0, 1e-9, Verdict::OneValueWorse),
        ] {
            let found = change(Better::Lower, &[before], &[after]);
            assert_eq!(
                (found.verdict, found.chance),
                (verdict, None),
                "{before}, {after}"
            );
            assert!(!found.verdict.is_changed() && found.false_alarm() == 0.0);
        }
        let found = change(Better::Lower, &[1.0], &[9.0, 9.0, 9.0]);
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
