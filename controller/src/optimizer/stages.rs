//! Unknowns in stages, as a horizon has them: what a row knows of the blocks before is their sum.

use super::linear_model::Place;

/// Blocks at most.
pub(crate) const BLOCKS_MAX: usize = 50;
/// Unknowns of a block at most.
pub(crate) const WIDTH_MAX: usize = 12;

/// Blocks of equally many unknowns, one after the other, each in force for some periods. A state is moved on by period · length times the
/// unknowns of a block, so that at the end of block b it has moved by the sum over all blocks up to b.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Stages {
    width: usize,
    blocks: usize,
    period: f64,
    lengths: [f64; BLOCKS_MAX],
}

impl Stages {
    /// Blocks of `width` unknowns, each in force for so many periods.
    pub(crate) fn new(width: usize, period: f64, in_force: impl Iterator<Item = f64>) -> Self {
        let mut stages = Self {
            width,
            blocks: 0,
            period,
            lengths: [0.0; BLOCKS_MAX],
        };
        for (length, periods) in stages.lengths.iter_mut().zip(in_force) {
            *length = periods;
            stages.blocks += 1;
        }
        stages
    }

    /// Unknowns that belong to no time.
    #[cfg(test)]
    pub(crate) fn one(width: usize) -> Self {
        Self::new(width, 1.0, core::iter::once(1.0))
    }

    pub(crate) fn width(&self) -> usize {
        self.width
    }

    pub(crate) fn blocks(&self) -> usize {
        self.blocks
    }

    pub(crate) fn unknowns(&self) -> usize {
        self.width * self.blocks
    }

    pub(super) fn period(&self) -> f64 {
        self.period
    }

    /// Periods for which each block is in force.
    pub(crate) fn lengths(&self) -> &[f64] {
        &self.lengths[..self.blocks]
    }

    /// For each block the sum of the blocks before it, each times its length.
    pub(super) fn sum_up(&self, step: &[f64], sums: &mut Vec<f64>) {
        sums.clear();
        let mut sum = [0.0; WIDTH_MAX];
        let sum = &mut sum[..self.width];
        for (block, length) in step.chunks_exact(self.width).zip(self.lengths) {
            sums.extend_from_slice(sum);
            for (sum, unknown) in sum.iter_mut().zip(block) {
                *sum += length * unknown;
            }
        }
    }

    /// What a step changes of a staged row; `sums` as [`Self::sum_up`] makes them.
    pub(super) fn change(&self, row: &[f64], place: Place, step: &[f64], sums: &[f64]) -> f64 {
        let first = place.block * self.width;
        let (own, before) = (&step[first..], &sums[first..]);
        let since = f64::from(u8::from(place.since_start));
        let terms = row.iter().zip(own).zip(before);
        terms
            .map(|((derivative, own), before)| derivative * (place.periods * own + since * before))
            .sum()
    }

    /// Adds to each block the `later` parts of all blocks after it, times its length.
    pub(super) fn add_later(&self, later: &[f64], into: &mut [f64]) {
        let mut sum = [0.0; WIDTH_MAX];
        let blocks = into
            .chunks_exact_mut(self.width)
            .zip(later.chunks_exact(self.width));
        for ((into, later), length) in blocks.zip(self.lengths()).rev() {
            for ((into, sum), later) in into.iter_mut().zip(&mut sum).zip(later) {
                *into += length * *sum;
                *sum += later;
            }
        }
    }
}
