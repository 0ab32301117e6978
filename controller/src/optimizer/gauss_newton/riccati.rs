//! The step of the smoother in information form, for unknowns that each have a weight.
//!
//! The rows of a block give a sum of squares in the bends before the block and in its own unknowns. So a row
//! costs one outer product of its derivatives, and a block one elimination (a Riccati sweep; docs/model.md
//! §4). With many rows this is several times faster than the smoother.
//!
//! Rounding loses an unknown whose weight is 10⁻¹⁶ of the information in the rows. A damping of 10⁻¹⁴ alone
//! is too small; the bounds of an interior point give enough weight.

use super::QuadraticTerm;
use crate::optimizer::stages::RowStage;
use crate::optimizer::{Budget, LinearModel, WIDTH_MAX};

/// Smallest weight of an unknown, as a share of the information about it in the rows.
const WEIGHT_SHARE: f64 = 1e-11;

/// Weight to which a smaller one is raised if `raises_weights`, as the same share.
const RAISED_SHARE: f64 = 1e-9;
/// Weight of a fixed unknown, as the same share.
const FIXED_SHARE: f64 = 1e12;

/// Workspace.
#[derive(Debug)]
pub(super) struct Riccati {
    /// For each block, from rows of the cost: state × state, own × state, own × own, and the linear terms of
    /// both.
    of_cost: Vec<f64>,
    /// The same from all rows; after the backward sweep, the factors for the forward sweep.
    of_all: Vec<f64>,
}

/// Sum of the rows of one stage.
struct Group<const W: usize> {
    stage: RowStage,
    quadratic: [[f64; W]; W],
    linear_terms: [f64; W],
}

/// Numbers stored for one block.
const fn stride(width: usize) -> usize {
    3 * width * width + 2 * width
}

impl Riccati {
    pub(super) fn with_capacity(unknowns: usize) -> Self {
        let numbers = unknowns.div_ceil(WIDTH_MAX) * stride(WIDTH_MAX);
        Self {
            of_cost: Vec::with_capacity(numbers),
            of_all: Vec::with_capacity(numbers),
        }
    }

    /// Whether a sweep takes less time than a pass of the smoother, by the work that both announce.
    pub(super) fn is_faster(model: &LinearModel) -> bool {
        let (stages, constraints) = (model.stages(), model.constraints());
        let has_unit_blocks = stages.lengths().all(|length| length == 1.0);
        let per_row = if has_unit_blocks { 1 } else { 4 };
        let rows = model.cost_rows() + constraints;
        per_row * rows > stages.unknowns() + constraints / 2
    }

    /// Accumulates the rows of the cost. False: the budget was spent.
    pub(super) fn accumulate_cost(&mut self, model: &LinearModel, budget: &mut Budget<'_>) -> bool {
        let stages = model.stages();
        self.of_cost.clear();
        let numbers = stages.blocks() * stride(stages.width());
        // Clearing eight numbers takes a nanosecond.
        if !budget.spend((numbers / 8) as u32) {
            return false;
        }
        self.of_cost.resize(numbers, 0.0);
        match stages.width() {
            2 => self.add_cost_rows::<2>(model, budget),
            4 => self.add_cost_rows::<4>(model, budget),
            6 => self.add_cost_rows::<6>(model, budget),
            8 => self.add_cost_rows::<8>(model, budget),
            10 => self.add_cost_rows::<10>(model, budget),
            _ => self.add_cost_rows::<12>(model, budget),
        }
    }

    /// Minimises |r + J Δ|² plus weight · (value + A Δ)² for each constraint to which `constraint_weight` assigns them,
    /// plus the `term` of each unknown. Unknowns without a term stay. Some(false): a weight is too small and
    /// `raises_weights` is false, or a number is not finite. None: the budget was spent.
    pub(super) fn solve(
        &mut self,
        model: &LinearModel,
        constraint_weight: impl Fn(usize, f64) -> Option<(f64, f64)>,
        term: impl Fn(usize) -> Option<QuadraticTerm>,
        raises_weights: bool,
        step: &mut [f64],
        budget: &mut Budget<'_>,
    ) -> Option<bool> {
        self.of_all.clear();
        let numbers = stride(model.stages().width());
        for of_block in self.of_cost.chunks_exact(numbers) {
            if !budget.spend((numbers / 4) as u32) {
                return None;
            }
            self.of_all.extend_from_slice(of_block);
        }
        match model.stages().width() {
            2 => self.sweep::<2>(model, constraint_weight, term, raises_weights, step, budget),
            4 => self.sweep::<4>(model, constraint_weight, term, raises_weights, step, budget),
            6 => self.sweep::<6>(model, constraint_weight, term, raises_weights, step, budget),
            8 => self.sweep::<8>(model, constraint_weight, term, raises_weights, step, budget),
            10 => self.sweep::<10>(model, constraint_weight, term, raises_weights, step, budget),
            _ => self.sweep::<12>(model, constraint_weight, term, raises_weights, step, budget),
        }
    }

    fn add_cost_rows<const W: usize>(
        &mut self,
        model: &LinearModel,
        budget: &mut Budget<'_>,
    ) -> bool {
        let mut group = Group::<W>::new(RowStage::FIRST_BLOCK);
        for row in 0..model.cost_rows() {
            if !budget.spend((W * W / 2) as u32) {
                return false;
            }
            group.move_to(model.stage(row), &mut self.of_cost);
            group.add_row(model.row(row), model.residual(row), 1.0);
        }
        group.store(&mut self.of_cost);
        true
    }

    fn sweep<const W: usize>(
        &mut self,
        model: &LinearModel,
        constraint_weight: impl Fn(usize, f64) -> Option<(f64, f64)>,
        term: impl Fn(usize) -> Option<QuadraticTerm>,
        raises_weights: bool,
        step: &mut [f64],
        budget: &mut Budget<'_>,
    ) -> Option<bool> {
        let mut group = Group::<W>::new(RowStage::FIRST_BLOCK);
        for index in 0..model.constraints() {
            if !budget.spend((W * W / 2) as u32) {
                return None;
            }
            if let Some((value, weight)) = constraint_weight(index, model.constraint(index)) {
                let (stage, row) = model.constraint_row(index);
                group.move_to(stage, &mut self.of_all);
                group.add_row(row, value, weight);
            }
        }
        group.store(&mut self.of_all);
        let stages = model.stages();
        let mut after = CostToGo::<W> {
            raises_weights,
            quadratic: [[0.0; W]; W],
            linear_terms: [0.0; W],
        };
        let blocks = self.of_all.chunks_exact_mut(stride(W));
        for (block, of_block) in blocks.enumerate().rev() {
            // In halves: a block of six sections exceeds a quantum.
            for _ in 0..2 {
                if !budget.spend((W * W * W / 2) as u32) {
                    return None;
                }
            }
            let term_of = |i: usize| term(block * W + i);
            let at = &step[block * W..][..W];
            if !after.eliminate(of_block, stages.length(block), at, term_of) {
                return Some(false);
            }
        }
        let mut state = [0.0; W];
        let blocks = self.of_all.chunks_exact(stride(W));
        for ((of_block, step), length) in blocks.zip(step.chunks_exact_mut(W)).zip(stages.lengths())
        {
            if !budget.spend((W * W) as u32) {
                return None;
            }
            forward::<W>(of_block, &state, step);
            for (state, step) in state.iter_mut().zip(&*step) {
                *state += length * step;
            }
        }
        Some(step.iter().all(|step| step.is_finite()))
    }
}

impl<const W: usize> Group<W> {
    fn new(stage: RowStage) -> Self {
        Self {
            stage,
            quadratic: [[0.0; W]; W],
            linear_terms: [0.0; W],
        }
    }

    /// Stores the sum of the previous stage in its block, if the stage changes.
    fn move_to(&mut self, stage: RowStage, blocks: &mut [f64]) {
        if stage != self.stage {
            self.store(blocks);
            *self = Self::new(stage);
        }
    }

    fn add_row(&mut self, row: &[f64], value: f64, weight: f64) {
        let row = &row[..W];
        for i in 0..W {
            let by = weight * row[i];
            self.linear_terms[i] += by * value;
            for k in 0..W {
                self.quadratic[i][k] += by * row[k];
            }
        }
    }

    fn store(&self, blocks: &mut [f64]) {
        let of_block = &mut blocks[self.stage.block * stride(W)..][..stride(W)];
        let since = f64::from(u8::from(self.stage.since_start));
        let own = self.stage.periods;
        let (quadratic, linear_terms) = of_block.split_at_mut(3 * W * W);
        for (part, share) in [since, since * own, own * own].into_iter().enumerate() {
            let targets = quadratic[part * W * W..][..W * W].chunks_exact_mut(W);
            for (target, square) in targets.zip(&self.quadratic) {
                for (target, square) in target.iter_mut().zip(square) {
                    *target += share * square;
                }
            }
        }
        for (part, share) in [since, own].into_iter().enumerate() {
            for (target, term) in linear_terms[part * W..][..W]
                .iter_mut()
                .zip(&self.linear_terms)
            {
                *target += share * term;
            }
        }
    }
}

/// Cost of all later blocks as a function of the state x before them: ½ xᵀ Q x + q·x, Q: `quadratic`, q: `linear_terms`.
struct CostToGo<const W: usize> {
    /// Whether weights that are too small are raised.
    raises_weights: bool,
    quadratic: [[f64; W]; W],
    linear_terms: [f64; W],
}

impl<const W: usize> CostToGo<W> {
    /// Eliminates the unknowns of the block before. Stores the factor, and its inverse applied to the state
    /// and linear terms, in the block's numbers. False: the weight of an unknown is too small, or a pivot is
    /// not positive.
    fn eliminate(
        &mut self,
        of_block: &mut [f64],
        length: f64,
        at: &[f64],
        term: impl Fn(usize) -> Option<QuadraticTerm>,
    ) -> bool {
        let share_min = if self.raises_weights {
            RAISED_SHARE
        } else {
            WEIGHT_SHARE
        };
        let (quadratic, linear_terms) = of_block.split_at_mut(3 * W * W);
        let (by_state, own) = quadratic.split_at_mut(W * W);
        let (by_both, own) = own.split_at_mut(W * W);
        let (at_state, at_own) = linear_terms.split_at_mut(W);
        for i in 0..W {
            for k in 0..W {
                let later = self.quadratic[i][k];
                own[i * W + k] += length * length * later;
                by_both[i * W + k] += length * later;
                by_state[i * W + k] += later;
            }
            at_own[i] += length * self.linear_terms[i];
            at_state[i] += self.linear_terms[i];
            let known = own[i * W + i];
            let least = share_min * known;
            let QuadraticTerm { weight, linear } = term(i).unwrap_or_else(|| {
                let weight = FIXED_SHARE * (known + f64::MIN_POSITIVE);
                QuadraticTerm {
                    weight,
                    linear: weight * at[i],
                }
            });
            if weight < least && !self.raises_weights {
                return false;
            }
            own[i * W + i] += weight.max(least);
            at_own[i] -= linear;
        }
        if !factorise::<W>(own) {
            return false;
        }
        // Factor⁻¹ times the terms of the state and the linear terms.
        for i in 0..W {
            for j in 0..i {
                let share = own[i * W + j];
                for k in 0..W {
                    by_both[i * W + k] -= share * by_both[j * W + k];
                }
                at_own[i] -= share * at_own[j];
            }
            let scale = 1.0 / own[i * W + i];
            for k in 0..W {
                by_both[i * W + k] *= scale;
            }
            at_own[i] *= scale;
        }
        self.linear_terms.copy_from_slice(at_state);
        for (quadratic, by_state) in self.quadratic.iter_mut().zip(by_state.chunks_exact(W)) {
            quadratic.copy_from_slice(by_state);
        }
        for j in 0..W {
            for i in 0..W {
                let share = by_both[j * W + i];
                for k in 0..W {
                    self.quadratic[i][k] -= share * by_both[j * W + k];
                }
                self.linear_terms[i] -= share * at_own[j];
            }
        }
        true
    }
}

/// Cholesky factorisation in place, lower triangle, with a width known at compile time; its time is announced
/// with that of the block. False: not positive definite.
fn factorise<const W: usize>(matrix: &mut [f64]) -> bool {
    for column in 0..W {
        let pivot = matrix[column * W + column];
        if !(pivot > 0.0 && pivot.is_finite()) {
            return false;
        }
        let root = pivot.sqrt();
        let scale = 1.0 / root;
        matrix[column * W + column] = root;
        for row in column + 1..W {
            matrix[row * W + column] *= scale;
        }
        for row in column + 1..W {
            let share = matrix[row * W + column];
            for other in column + 1..=row {
                matrix[row * W + other] -= share * matrix[other * W + column];
            }
        }
    }
    true
}

/// The unknowns of a block, given the state before it.
fn forward<const W: usize>(of_block: &[f64], state: &[f64; W], step: &mut [f64]) {
    let (by_both, own) = of_block[W * W..3 * W * W].split_at(W * W);
    let at_own = &of_block[3 * W * W + W..];
    for i in (0..W).rev() {
        let by_state = by_both[i * W..][..W].iter().zip(state);
        let mut sum = at_own[i] + by_state.map(|(by, state)| by * state).sum::<f64>();
        for k in i + 1..W {
            sum += own[k * W + i] * step[k];
        }
        step[i] = -sum / own[i * W + i];
    }
}

#[cfg(test)]
mod tests {
    use super::super::Smoother;
    use super::*;
    use crate::optimizer::{Simd, Stages, cycle_seed};

    const BLOCKS: usize = 3;
    const DAMPING: f64 = 1e-9;
    const WIDTHS: [usize; 4] = [2, 4, 6, 12];

    /// A pseudo-random number between -1 and 1.
    fn number(i: usize, k: usize) -> f64 {
        (cycle_seed(i as u64, k as u64) >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    /// Rows of every kind of stage, and constraints.
    fn model(width: usize) -> LinearModel {
        let unknowns = BLOCKS * width;
        let mut model = LinearModel::with_capacity(60, 60, unknowns, unknowns);
        model.clear(&Stages::new(width, 0.5, [1, 2, 1].into_iter()), true);
        model.weight_unknowns(1e-3, &vec![0.1; width], &vec![0.3; unknowns]);
        for i in 0..12 {
            let stage = RowStage {
                block: i / 4,
                since_start: i % 3 != 0,
                periods: 1.0 + f64::from(u8::from(i / 4 == 1 && i % 2 == 1)),
            };
            let derivatives: Vec<f64> = (0..width).map(|k| number(i, k)).collect();
            model.push(number(i, 20), &derivatives, stage);
            let h = 0.1 * number(i, 21);
            let steeper: Vec<f64> = derivatives.iter().map(|d| 30.0 * d).collect();
            model.push_constraint(0, h, h, &steeper, stage);
        }
        model
    }

    fn term(i: usize) -> Option<QuadraticTerm> {
        let weight = 10_f64.powf(-3.0 + 4.0 * number(i, 22));
        let linear = number(i, 23);
        (i != 5).then_some(QuadraticTerm { weight, linear })
    }

    fn constraint_weight(index: usize, h: f64) -> Option<(f64, f64)> {
        (index % 4 != 2).then_some((h - 0.01, 1.0 / (1.0 + index as f64)))
    }

    fn by_riccati(
        model: &LinearModel,
        term: impl Fn(usize) -> Option<QuadraticTerm>,
        raises_weights: bool,
    ) -> (Option<bool>, Vec<f64>) {
        let (unknowns, mut budget) = (model.stages().unknowns(), Budget::unlimited());
        let mut riccati = Riccati::with_capacity(unknowns);
        assert!(riccati.accumulate_cost(model, &mut budget));
        let term = |i| term(i).map(|term| term.with_own(model, i, DAMPING));
        let mut step = vec![0.3; unknowns];
        let solved = riccati.solve(
            model,
            constraint_weight,
            term,
            raises_weights,
            &mut step,
            &mut budget,
        );
        (solved, step)
    }

    #[test]
    fn it_is_the_step_of_the_smoother() {
        for width in WIDTHS {
            let (mut model, mut budget) = (model(width), Budget::unlimited());
            let steps =
                [false, true].map(|raises_weights| by_riccati(&model, term, raises_weights));
            model
                .weight_constraints(constraint_weight, &mut budget)
                .unwrap();
            let mut smoother = Smoother::with_capacity(Simd::best(), 60);
            let mut smoothed = vec![0.3; BLOCKS * width];
            assert!(smoother.solve_with_terms(&model, term, DAMPING, &mut smoothed, &mut budget));
            for (solved, step) in steps {
                assert_eq!(solved, Some(true));
                for (step, smoothed) in step.iter().zip(&smoothed) {
                    let most = 1e-9 * (1.0 + smoothed.abs());
                    assert!((step - smoothed).abs() < most, "{width}: {step} {smoothed}");
                }
                assert!((step[5] - 0.3).abs() < 1e-9, "it was fixed: {}", step[5]);
            }
        }
    }

    #[test]
    fn an_unknown_that_weighs_too_little_is_found_and_can_be_lifted() {
        let light = |i: usize| {
            let weight = if i == 0 { 0.0 } else { 1.0 };
            Some(QuadraticTerm {
                weight,
                linear: 0.0,
            })
        };
        for width in WIDTHS {
            let model = model(width);
            let of = |raises_weights| {
                let mut riccati = Riccati::with_capacity(BLOCKS * width);
                let mut budget = Budget::unlimited();
                assert!(riccati.accumulate_cost(&model, &mut budget));
                let mut step = vec![0.0; BLOCKS * width];
                let step = &mut step;
                riccati.solve(
                    &model,
                    |_, _| None,
                    light,
                    raises_weights,
                    step,
                    &mut budget,
                )
            };
            assert_eq!([false, true].map(of), [Some(false), Some(true)]);
        }
    }
}
