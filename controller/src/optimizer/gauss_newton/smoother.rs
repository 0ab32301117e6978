//! The least-squares step of staged rows, in time linear in the horizon instead of cubic.
//!
//! All rows of a block depend on the earlier blocks by one sum, x' = x + length · u. So J Jᵀ + λI is the
//! covariance of measurements of a random walk. The step Δ = -Jᵀ(J Jᵀ + λI)⁻¹ r is then a forward Kalman
//! filter with a backward disturbance smoother (de Jong, *Biometrika* 76, 1989; docs/model.md §4).
//!
//! Every unknown has variance 1, and every row the noise λ. A fixed unknown has variance 0, and one with a
//! weight ρ has λ/(λ + ρ). An active constraint is one more row.

use pulp::NullaryFnOnce;

use crate::optimizer::stages::{BLOCKS_MAX, WIDTH_MAX};
use crate::optimizer::{Budget, LinearModel, Simd};

/// Workspace, and the results of the filter for the smoother.
#[derive(Debug)]
pub(super) struct Smoother {
    simd: Simd,
    /// Row indices sorted by block.
    order: Vec<u16>,
    /// Start of each block in that order, and the end of the last one.
    begins: [u16; BLOCKS_MAX + 1],
    /// Whether a block of one period has rows at its end only. Such rows depend on its unknowns only by the sum.
    has_end_rows_only: [bool; BLOCKS_MAX],
    /// Prior mean and variance of each unknown.
    means: [f64; WIDTH_MAX * BLOCKS_MAX],
    variances: [f64; WIDTH_MAX * BLOCKS_MAX],
    /// In that order: gain of each row, the inverse of its innovation's variance, and their product.
    gains: Vec<f64>,
    shares: Vec<f64>,
    scaled_innovations: Vec<f64>,
}

/// The term ½ weight Δ² - force Δ of an unknown Δ.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct QuadraticTerm {
    pub(super) weight: f64,
    pub(super) linear: f64,
}

impl QuadraticTerm {
    /// Adds the damping and the weight of the model.
    pub(super) fn with_own(self, model: &LinearModel, i: usize, damping: f64) -> Self {
        let (own, linear) = match model.regulariser() {
            Some((own, distances)) => (own, self.linear - own * distances[i]),
            None => (0.0, self.linear),
        };
        Self {
            weight: damping + (own + self.weight),
            linear,
        }
    }

    /// Prior mean and variance of the unknown, with the rows' noise λ.
    fn prior(self, damping: f64) -> (f64, f64) {
        (self.linear / self.weight, damping / self.weight)
    }
}

/// Prior distribution of a block's unknowns.
struct Prior<const W: usize> {
    mean: [f64; W],
    variance: [f64; W],
}

/// A normal distribution.
struct State<const N: usize> {
    mean: [f64; N],
    covariance: [[f64; N]; N],
}

impl Smoother {
    /// Memory for `rows`, processed with the instructions of `simd`.
    pub(super) fn with_capacity(simd: Simd, rows: usize) -> Self {
        Self {
            simd,
            order: vec![0; rows],
            begins: [0; BLOCKS_MAX + 1],
            has_end_rows_only: [false; BLOCKS_MAX],
            means: [0.0; WIDTH_MAX * BLOCKS_MAX],
            variances: [0.0; WIDTH_MAX * BLOCKS_MAX],
            gains: vec![0.0; rows * 2 * WIDTH_MAX],
            shares: vec![0.0; rows],
            scaled_innovations: vec![0.0; rows],
        }
    }

    /// Solves for the free unknowns of `step`; the others stay. False: a number is not finite, or the budget
    /// was spent.
    pub(super) fn solve(
        &mut self,
        model: &LinearModel,
        free: &[usize],
        damping: f64,
        step: &mut [f64],
        budget: &mut Budget<'_>,
    ) -> bool {
        let unknowns = step.len();
        self.means[..unknowns].copy_from_slice(step);
        self.variances[..unknowns].fill(0.0);
        let prior = |i| {
            let term = QuadraticTerm::default().with_own(model, i, damping);
            term.prior(damping)
        };
        if model.regulariser().is_some() {
            for &i in free {
                (self.means[i], self.variances[i]) = prior(i);
            }
        } else {
            // The damping alone treats all unknowns alike.
            let common = prior(0);
            for &i in free {
                (self.means[i], self.variances[i]) = common;
            }
        }
        self.solve_from_priors(model, damping, step, budget)
    }

    /// Solves again for other residuals, or another point of a weight, after a solution for the same unknowns by
    /// [`Self::solve`]. Its gains serve again; without the covariances this takes a third of the time. The fixed
    /// unknowns stay where they are. False as above.
    pub(super) fn solve_again(
        &mut self,
        model: &LinearModel,
        free: &[usize],
        damping: f64,
        step: &mut [f64],
        budget: &mut Budget<'_>,
    ) -> bool {
        self.means[..step.len()].fill(0.0);
        if model.regulariser().is_some() {
            for &i in free {
                let term = QuadraticTerm::default().with_own(model, i, damping);
                self.means[i] = term.prior(damping).0;
            }
        }
        self.sweep::<true>(model, damping, step, budget)
    }

    /// Solves for all unknowns whose `term` is some, in addition to the damping. The others stay. False as
    /// above.
    pub(super) fn solve_with_terms(
        &mut self,
        model: &LinearModel,
        term: impl Fn(usize) -> Option<QuadraticTerm>,
        damping: f64,
        step: &mut [f64],
        budget: &mut Budget<'_>,
    ) -> bool {
        for (i, step) in step.iter().enumerate() {
            (self.means[i], self.variances[i]) = match term(i) {
                Some(term) => term.with_own(model, i, damping).prior(damping),
                None => (*step, 0.0),
            };
        }
        self.solve_from_priors(model, damping, step, budget)
    }

    fn solve_from_priors(
        &mut self,
        model: &LinearModel,
        damping: f64,
        step: &mut [f64],
        budget: &mut Budget<'_>,
    ) -> bool {
        self.sort(model);
        self.sweep::<false>(model, damping, step, budget)
    }

    /// One pass forward and back, with the gains of the last one if `AGAIN`.
    fn sweep<const AGAIN: bool>(
        &mut self,
        model: &LinearModel,
        damping: f64,
        step: &mut [f64],
        budget: &mut Budget<'_>,
    ) -> bool {
        let simd = self.simd;
        let sweep = Sweep {
            smoother: self,
            model,
            damping,
            step,
            budget,
        };
        match model.stages().width() {
            2 => simd.run_narrow(OfWidth::<2, 4, AGAIN>(sweep)),
            4 => simd.run_narrow(OfWidth::<4, 8, AGAIN>(sweep)),
            6 => simd.run_narrow(OfWidth::<6, 12, AGAIN>(sweep)),
            8 => simd.run_narrow(OfWidth::<8, 16, AGAIN>(sweep)),
            10 => simd.run_narrow(OfWidth::<10, 20, AGAIN>(sweep)),
            _ => simd.run_narrow(OfWidth::<12, 24, AGAIN>(sweep)),
        }
    }

    /// Sorts the rows by block.
    fn sort(&mut self, model: &LinearModel) {
        let blocks = model.stages().blocks();
        self.begins[..=blocks].fill(0);
        let lengths = model.stages().lengths();
        for (is_so, length) in self.has_end_rows_only.iter_mut().zip(lengths) {
            *is_so = length == 1.0;
        }
        for row in 0..model.rows() {
            let stage = model.stage(row);
            self.begins[stage.block + 1] += 1;
            self.has_end_rows_only[stage.block] &= stage.since_start && stage.periods == 1.0;
        }
        for block in 0..blocks {
            self.begins[block + 1] += self.begins[block];
        }
        let mut next = self.begins;
        for row in 0..model.rows() {
            let at = &mut next[model.stage(row).block];
            self.order[usize::from(*at)] = row as u16;
            *at += 1;
        }
    }

    /// Positions of a block's rows in the order.
    fn rows_of(&self, block: usize) -> core::ops::Range<usize> {
        usize::from(self.begins[block])..usize::from(self.begins[block + 1])
    }

    #[inline(always)]
    fn prior<const W: usize>(&self, block: usize) -> Prior<W> {
        let (mut mean, mut variance) = ([0.0; W], [0.0; W]);
        mean.copy_from_slice(&self.means[block * W..][..W]);
        variance.copy_from_slice(&self.variances[block * W..][..W]);
        Prior { mean, variance }
    }

    /// One pass forward and back. It is inlined with all that it calls, into a function compiled for the instruction set.
    #[inline(always)]
    fn smooth<const W: usize, const D: usize, const AGAIN: bool>(
        &mut self,
        model: &LinearModel,
        damping: f64,
        step: &mut [f64],
        budget: &mut Budget<'_>,
    ) -> bool {
        let mut state = State::<W> {
            mean: [0.0; W],
            covariance: [[0.0; W]; W],
        };
        for block in 0..model.stages().blocks() {
            let prior = self.prior::<W>(block);
            let filtered = if self.has_end_rows_only[block] {
                state.add(&prior);
                self.filter::<W, AGAIN>(model, block, damping, &mut state, budget)
            } else {
                let mut joint = state.joint_with::<D>(&prior);
                let filtered = self.filter::<D, AGAIN>(model, block, damping, &mut joint, budget);
                state = joint.after_block(model.stages().length(block));
                filtered
            };
            if !filtered {
                return false;
            }
        }
        let mut adjoint = [0.0; W];
        for block in (0..model.stages().blocks()).rev() {
            let of_unknowns = if self.has_end_rows_only[block] {
                self.backward_update(model, block, &mut adjoint);
                adjoint
            } else {
                let length = model.stages().length(block);
                let mut joint = [0.0; D];
                for i in 0..W {
                    (joint[i], joint[W + i]) = (adjoint[i], length * adjoint[i]);
                }
                self.backward_update(model, block, &mut joint);
                let mut of_unknowns = [0.0; W];
                adjoint.copy_from_slice(&joint[..W]);
                of_unknowns.copy_from_slice(&joint[W..]);
                of_unknowns
            };
            let prior = self.prior::<W>(block);
            for i in 0..W {
                step[block * W + i] = prior.mean[i] - prior.variance[i] * of_unknowns[i];
            }
        }
        step.iter().all(|step| step.is_finite())
    }

    /// Processes the rows of a block one by one. False: the budget was spent.
    #[inline(always)]
    fn filter<const N: usize, const AGAIN: bool>(
        &mut self,
        model: &LinearModel,
        block: usize,
        damping: f64,
        state: &mut State<N>,
        budget: &mut Budget<'_>,
    ) -> bool {
        for position in self.rows_of(block) {
            if !budget.spend(if AGAIN { 2 * N } else { N * N } as u32) {
                return false;
            }
            let row = usize::from(self.order[position]);
            let by: [f64; N] = derivatives(model, row);
            let innovation = model.residual(row) + product(&by, &state.mean);
            let gain = &mut self.gains[position * 2 * WIDTH_MAX..][..N];
            if !AGAIN {
                self.shares[position] = state.update_covariance(&by, damping, gain);
            }
            for (mean, gain) in state.mean.iter_mut().zip(gain) {
                *mean -= *gain * innovation;
            }
            self.scaled_innovations[position] = innovation * self.shares[position];
        }
        true
    }

    /// Backward pass: adds the effect of a block's rows on the state before it.
    #[inline(always)]
    fn backward_update<const N: usize>(
        &self,
        model: &LinearModel,
        block: usize,
        adjoint: &mut [f64; N],
    ) {
        for position in self.rows_of(block).rev() {
            let by: [f64; N] = derivatives(model, usize::from(self.order[position]));
            let gain = &self.gains[position * 2 * WIDTH_MAX..][..N];
            let met = product(gain, adjoint);
            let force = self.scaled_innovations[position] - met;
            for (adjoint, derivative) in adjoint.iter_mut().zip(by) {
                *adjoint += derivative * force;
            }
        }
    }
}

/// One solution for unknowns with priors.
struct Sweep<'a, 'b> {
    smoother: &'a mut Smoother,
    model: &'a LinearModel,
    damping: f64,
    step: &'a mut [f64],
    budget: &'a mut Budget<'b>,
}

/// The same for W unknowns in each block.
struct OfWidth<'a, 'b, const W: usize, const D: usize, const AGAIN: bool>(Sweep<'a, 'b>);

impl<const W: usize, const D: usize, const AGAIN: bool> NullaryFnOnce
    for OfWidth<'_, '_, W, D, AGAIN>
{
    type Output = bool;

    #[inline(always)]
    fn call(self) -> bool {
        let Sweep {
            smoother,
            model,
            damping,
            step,
            budget,
        } = self.0;
        smoother.smooth::<W, D, AGAIN>(model, damping, step, budget)
    }
}

/// The derivatives of a row with respect to the sum of the blocks before. If N allows both, those with
/// respect to its own block follow.
#[inline(always)]
fn derivatives<const N: usize>(model: &LinearModel, row: usize) -> [f64; N] {
    let (of_row, stage) = (model.row(row), model.stage(row));
    if let Some(before) = of_row.first_chunk() {
        return *before;
    }
    let mut by = [0.0; N];
    let (before, own) = by.split_at_mut(of_row.len());
    for ((own, before), derivative) in own.iter_mut().zip(before).zip(of_row) {
        *own = stage.periods * derivative;
        *before = if stage.since_start { *derivative } else { 0.0 };
    }
    by
}

/// Scalar product of an even number of terms, in two sums.
#[inline(always)]
fn product<const N: usize>(a: &[f64], b: &[f64; N]) -> f64 {
    const { assert!(N.is_multiple_of(2)) };
    let mut sums = [0.0; 2];
    for (a, b) in a.chunks_exact(2).zip(b.chunks_exact(2)) {
        sums[0] += a[0] * b[0];
        sums[1] += a[1] * b[1];
    }
    sums[0] + sums[1]
}

impl<const N: usize> State<N> {
    /// Processes one row: residual + `by` · state, the innovation, has noise of variance `noise`. Writes the gain,
    /// and returns the inverse of the innovation's variance. The mean stays.
    #[inline(always)]
    fn update_covariance(&mut self, by: &[f64; N], noise: f64, gain: &mut [f64]) -> f64 {
        // Short chains of additions: the next row waits for this one.
        let mut spread = [0.0; N];
        let pairs = self.covariance.chunks_exact(2).zip(by.chunks_exact(2));
        for (lines, by) in pairs {
            for (i, spread) in spread.iter_mut().enumerate() {
                *spread += lines[0][i] * by[0] + lines[1][i] * by[1];
            }
        }
        let variance = product(by, &spread).max(0.0) + noise;
        let share = 1.0 / variance;
        // The inverse of the root; the root does not wait for the division. A product of two equal factors keeps the
        // matrix symmetric to the bit.
        let root = share * variance.sqrt();
        let mut scaled = spread;
        for scaled in &mut scaled {
            *scaled *= root;
        }
        for (line, scale) in self.covariance.iter_mut().zip(scaled) {
            for (covariance, other) in line.iter_mut().zip(scaled) {
                *covariance -= scale * other;
            }
        }
        for (gain, spread) in gain.iter_mut().zip(spread) {
            *gain = spread * share;
        }
        share
    }

    /// Adds unknowns that are in force for one period.
    #[inline(always)]
    fn add(&mut self, prior: &Prior<N>) {
        for i in 0..N {
            self.mean[i] += prior.mean[i];
            self.covariance[i][i] += prior.variance[i];
        }
    }

    /// The joint distribution of this state and the unknowns of a block.
    #[inline(always)]
    fn joint_with<const D: usize>(&self, prior: &Prior<N>) -> State<D> {
        let mut joint = State {
            mean: [0.0; D],
            covariance: [[0.0; D]; D],
        };
        for i in 0..N {
            joint.mean[i] = self.mean[i];
            joint.mean[N + i] = prior.mean[i];
            joint.covariance[i][..N].copy_from_slice(&self.covariance[i]);
            joint.covariance[N + i][N + i] = prior.variance[i];
        }
        joint
    }

    /// The state after unknowns that were in force for `length` periods: the first half plus `length` times
    /// the second.
    #[inline(always)]
    fn after_block<const W: usize>(&self, length: f64) -> State<W> {
        let p = &self.covariance;
        let mut after = State {
            mean: [0.0; W],
            covariance: [[0.0; W]; W],
        };
        for i in 0..W {
            after.mean[i] = self.mean[i] + length * self.mean[W + i];
            for k in 0..W {
                let across = p[i][W + k] + p[k][W + i];
                after.covariance[i][k] = p[i][k] + length * (across + length * p[W + i][W + k]);
            }
        }
        after
    }
}

#[cfg(test)]
mod tests;
