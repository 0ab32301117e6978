//! Unknowns in stages along a horizon: a row depends on the blocks before its own only by their sum.

/// Largest number of blocks.
pub(crate) const BLOCKS_MAX: usize = 50;
/// Largest number of unknowns of a block.
pub(crate) const WIDTH_MAX: usize = 12;

/// The unknowns on which a row depends: those of one block, and perhaps those of all blocks before.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RowStage {
    pub(crate) block: usize,
    /// Whether it also depends on the sum of the blocks before, each for its full length.
    pub(crate) since_start: bool,
    /// Number of periods for which the unknowns of its block were in force.
    pub(crate) periods: f64,
}

impl RowStage {
    /// For rows that depend on a single block, or have no stage.
    pub(crate) const FIRST_BLOCK: Self = Self {
        block: 0,
        since_start: true,
        periods: 1.0,
    };
}

/// Consecutive blocks with equally many unknowns, each in force for a number of periods. A block changes the
/// state by period · length times its unknowns. So the change up to the end of block b is the sum over the
/// blocks up to b.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Stages {
    width: usize,
    blocks: usize,
    period: f64,
    /// Periods; bytes, because a solve copies them.
    lengths: [u8; BLOCKS_MAX],
}

impl Stages {
    /// Blocks of `width` unknowns, each in force for the given number of periods.
    pub(crate) fn new(width: usize, period: f64, in_force: impl Iterator<Item = u8>) -> Self {
        let mut stages = Self {
            width,
            blocks: 0,
            period,
            lengths: [0; BLOCKS_MAX],
        };
        for (length, periods) in stages.lengths.iter_mut().zip(in_force) {
            *length = periods;
            stages.blocks += 1;
        }
        stages
    }

    /// Unknowns of a single stage.
    #[cfg(test)]
    pub(crate) fn one(width: usize) -> Self {
        Self::new(width, 1.0, core::iter::once(1))
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
    pub(crate) fn lengths(&self) -> impl DoubleEndedIterator<Item = f64> + ExactSizeIterator {
        let lengths = self.lengths[..self.blocks].iter();
        lengths.map(|&periods| f64::from(periods))
    }

    /// Periods for which one block is in force.
    pub(super) fn length(&self, block: usize) -> f64 {
        f64::from(self.lengths[block])
    }

    /// For each block, the sum of the blocks before it, each times its length.
    pub(super) fn compute_prefix_sums(&self, step: &[f64], sums: &mut Vec<f64>) {
        sums.clear();
        let mut sum = [0.0; WIDTH_MAX];
        let sum = &mut sum[..self.width];
        for (block, length) in step.chunks_exact(self.width).zip(self.lengths()) {
            sums.extend_from_slice(sum);
            for (sum, unknown) in sum.iter_mut().zip(block) {
                *sum += length * unknown;
            }
        }
    }

    /// Change of a staged row by a step; `sums` are those of [`Self::compute_prefix_sums`].
    pub(super) fn change(&self, row: &[f64], stage: RowStage, step: &[f64], sums: &[f64]) -> f64 {
        let first = stage.block * self.width;
        let (own, before) = (&step[first..], &sums[first..]);
        let since = f64::from(u8::from(stage.since_start));
        let terms = row.iter().zip(own).zip(before);
        terms
            .map(|((derivative, own), before)| derivative * (stage.periods * own + since * before))
            .sum()
    }

    /// Adds to each block the sum of the `later` values of all blocks after it, times the length of the
    /// block.
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
