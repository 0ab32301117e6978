//! The newest values of a series, for a bar chart and percentiles.

use std::collections::VecDeque;

use crate::spread::Spread;

#[derive(Debug, Clone, Default)]
pub(super) struct Recent {
    /// Oldest first; NaN for a missing value.
    values: VecDeque<f64>,
    kept: usize,
    /// Values so far, including those dropped.
    total: u64,
}

impl Recent {
    pub(super) fn new(kept: usize) -> Self {
        Self {
            kept,
            ..Self::default()
        }
    }

    /// NaN is a missing value.
    pub(super) fn push(&mut self, value: f64) {
        if self.values.len() >= self.kept {
            self.values.pop_front();
        }
        self.values.push_back(value);
        self.total += 1;
    }

    /// Percentiles of the kept finite values.
    pub(super) fn percentiles(&self) -> Option<Spread> {
        let values = self.values.iter().copied();
        Spread::from_values(values.filter(|value| value.is_finite()))
    }

    /// The largest value of each of `count` stretches of equal length, the newest last; `None` for a stretch
    /// without values. Stretches are aligned to the total count, so that bars do not flicker.
    pub(super) fn columns(&self, count: usize) -> Vec<Option<f64>> {
        let stretch = self.kept.div_ceil(count.max(1)).max(1);
        let mut columns = vec![None; count];
        let newest = self.total.saturating_sub(1) / stretch as u64;
        for (back, value) in self.values.iter().rev().enumerate() {
            let column = (self.total - 1 - back as u64) / stretch as u64;
            let Some(place) = count.checked_sub(1 + (newest - column) as usize) else {
                break;
            };
            if value.is_finite() {
                let most: &mut Option<f64> = &mut columns[place];
                *most = Some(most.map_or(*value, |most| most.max(*value)));
            }
        }
        columns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filled(kept: usize, values: impl IntoIterator<Item = f64>) -> Recent {
        let mut recent = Recent::new(kept);
        values.into_iter().for_each(|value| recent.push(value));
        recent
    }

    #[test]
    fn percentiles_are_of_what_is_kept_and_finite() {
        assert_eq!(filled(5, [f64::NAN]).percentiles(), None);
        let recent = filled(100, (0..=200).map(f64::from));
        let percentiles = recent.percentiles().expect("there are values");
        assert_eq!(
            (percentiles.p50, percentiles.p99, percentiles.max),
            (150.0, 199.0, 200.0)
        );
        let one = filled(9, [7.0, f64::INFINITY]).percentiles().expect("one");
        assert_eq!((one.p50, one.p99, one.max), (7.0, 7.0, 7.0));
    }

    #[test]
    fn columns_hold_the_most_of_their_stretch_and_do_not_flicker() {
        let recent = filled(8, [1.0, 2.0, 3.0, 4.0, 5.0]);
        assert_eq!(recent.columns(4), [None, Some(2.0), Some(4.0), Some(5.0)]);
        let later = filled(8, [1.0, 2.0, 3.0, 4.0, 5.0, 1.0, 0.5]);
        assert_eq!(
            later.columns(4),
            [Some(2.0), Some(4.0), Some(5.0), Some(0.5)]
        );
        assert_eq!(filled(8, [f64::NAN, 1.0]).columns(2), [None, Some(1.0)]);
        assert!(filled(8, [1.0]).columns(0).is_empty());
        assert_eq!(Recent::default().columns(3), [None; 3]);
    }
}
