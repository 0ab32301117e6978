//! Linear model of a problem at one point: residuals, Jacobian and linearised constraints.

mod rows;

use std::collections::BinaryHeap;

use rows::Rows;

use super::products::{add_times, dot, with_known_size};
use super::stages::{RowStage, Stages, WIDTH_MAX};
use super::{Budget, VIOLATIONS};

/// Residuals r, Jacobian J and linearised constraints h + A Δ ≥ 0 at one point.
///
/// A constraint that a step would violate becomes *active*: a residual of its own, so that the next step ends
/// on the constraint. The problem scales each constraint to outweigh the residuals.
///
/// A dense row has a derivative for each unknown. A *staged* row has only the derivatives of its [`RowStage`],
/// which all blocks it depends on share.
#[derive(Debug)]
pub(crate) struct LinearModel {
    stages: Stages,
    is_staged: bool,
    /// Stored derivatives of a row.
    stride: usize,
    residuals: Rows,
    /// Number of residuals of the cost; the rows after them are active constraints.
    cost_rows: usize,
    constraints: Rows,
    /// For each kind, the slack of each constraint as an ordered integer, and its index; the largest slack on
    /// top.
    heaps_by_slack: [BinaryHeap<(i64, usize)>; VIOLATIONS],
    is_active: Vec<bool>,
    constraints_max: usize,
    /// Weight of the squared distance of each block from `centre`.
    weight: f64,
    centre: [f64; WIDTH_MAX],
    /// That distance, of each unknown.
    distances: Vec<f64>,
    /// Sum of the blocks before each block.
    sums: Vec<f64>,
}

impl LinearModel {
    /// Memory for problems of `unknowns`, and `columns` of them in dense rows.
    pub(crate) fn with_capacity(
        rows: usize,
        constraints: usize,
        columns: usize,
        unknowns: usize,
    ) -> Self {
        Self {
            stages: Stages::new(0, 0.0, core::iter::empty()),
            is_staged: false,
            stride: 0,
            residuals: Rows::with_capacity(rows + constraints, columns),
            cost_rows: 0,
            constraints: Rows::with_capacity(constraints, columns),
            heaps_by_slack: core::array::from_fn(|_| BinaryHeap::with_capacity(constraints)),
            is_active: Vec::with_capacity(constraints),
            constraints_max: constraints,
            weight: 0.0,
            centre: [0.0; WIDTH_MAX],
            distances: Vec::with_capacity(unknowns),
            sums: Vec::with_capacity(unknowns),
        }
    }

    /// Removes all rows, and sets the stages and the layout of the next rows.
    pub(crate) fn clear(&mut self, stages: &Stages, is_staged: bool) {
        self.stages = *stages;
        self.is_staged = is_staged;
        self.stride = if is_staged {
            stages.width()
        } else {
            stages.unknowns()
        };
        self.cost_rows = 0;
        self.clear_constraints();
        self.weight = 0.0;
        self.distances.clear();
    }

    /// Adds a residual with its derivatives with respect to the state, to which the unknowns are rates.
    /// Adding rows in the order of their blocks is fastest.
    #[inline(never)]
    pub(crate) fn push(&mut self, residual: f64, derivatives: &[f64], stage: RowStage) {
        self.push_known(residual, derivatives, stage);
    }

    /// The same inside a caller that knows the number of derivatives.
    #[inline(always)]
    pub(crate) fn push_known(&mut self, residual: f64, derivatives: &[f64], stage: RowStage) {
        self.cost_rows += 1;
        let row = self.residuals.push(residual, stage, self.stride);
        fill(row, derivatives, stage, &self.stages, self.is_staged);
    }

    /// Sets the weight on the squared distance of each block from `centre`, at the point z. It needs no rows.
    pub(crate) fn weight_unknowns(&mut self, weight: f64, centre: &[f64], z: &[f64]) {
        self.weight = weight;
        self.centre[..centre.len()].copy_from_slice(centre);
        self.move_weighted_point(z);
    }

    /// Moves the point of [`Self::weight_unknowns`].
    pub(super) fn move_weighted_point(&mut self, z: &[f64]) {
        self.distances.clear();
        for block in z.chunks_exact(self.stages.width()) {
            let distances = block.iter().zip(&self.centre).map(|(z, centre)| z - centre);
            self.distances.extend(distances);
        }
    }

    /// Adds a dense residual with zero derivatives, and returns them for the caller to fill in.
    pub(crate) fn push_dense(&mut self, residual: f64) -> &mut [f64] {
        debug_assert!(!self.is_staged, "a row of no place");
        self.cost_rows += 1;
        let row = self
            .residuals
            .push(residual, RowStage::FIRST_BLOCK, self.stride);
        row.fill(0.0);
        row
    }

    /// Adds a constraint h + A Δ ≥ 0 of a kind (below [`VIOLATIONS`]), with derivatives as in [`Self::push`].
    /// Beyond the capacity, those with the least `slack` are kept. No kind takes more than its equal share
    /// while another kind needs it.
    pub(crate) fn push_constraint(
        &mut self,
        kind: usize,
        h: f64,
        slack: f64,
        derivatives: &[f64],
        stage: RowStage,
    ) {
        let order = in_order(slack);
        let rows = &mut self.constraints;
        let mut index = rows.values.len();
        if index < self.constraints_max {
            rows.push(h, stage, self.stride);
            self.is_active.push(false);
        } else {
            let crowded = if self.heaps_by_slack[kind].len() < self.constraints_max / VIOLATIONS {
                self.heaps_by_slack.iter_mut().max_by_key(|heap| heap.len())
            } else {
                let own = &mut self.heaps_by_slack[kind];
                own.peek().is_some_and(|most| order < most.0).then_some(own)
            };
            let Some((_, freed)) = crowded.and_then(BinaryHeap::pop) else {
                return;
            };
            index = freed;
            rows.values[index] = h;
            rows.row_stages[index] = stage;
        }
        self.heaps_by_slack[kind].push((order, index));
        let row = &mut rows.derivatives[index * self.stride..][..self.stride];
        fill(row, derivatives, stage, &self.stages, self.is_staged);
    }

    pub(super) fn stages(&self) -> &Stages {
        &self.stages
    }

    pub(super) fn is_staged(&self) -> bool {
        self.is_staged
    }

    /// The weight of [`Self::weight_unknowns`], and the distances that it squares.
    pub(super) fn regulariser(&self) -> Option<(f64, &[f64])> {
        (self.weight > 0.0).then_some((self.weight, &self.distances))
    }

    /// Number of residuals of the cost, which precede all others.
    pub(crate) fn cost_rows(&self) -> usize {
        self.cost_rows
    }

    /// Number of residuals, active constraints included.
    pub(crate) fn rows(&self) -> usize {
        self.residuals.values.len()
    }

    pub(crate) fn residual(&self, index: usize) -> f64 {
        self.residuals.values[index]
    }

    /// All residuals.
    pub(super) fn residuals(&self) -> &[f64] {
        &self.residuals.values
    }

    /// The residuals of the cost, to be replaced by those of another point.
    pub(super) fn residuals_mut(&mut self) -> &mut [f64] {
        &mut self.residuals.values[..self.cost_rows]
    }

    /// The stored derivatives of a row.
    pub(crate) fn row(&self, index: usize) -> &[f64] {
        &self.residuals.derivatives[index * self.stride..][..self.stride]
    }

    pub(super) fn stage(&self, index: usize) -> RowStage {
        self.residuals.row_stages[index]
    }

    /// Whether a constraint is active.
    pub(super) fn has_active_constraints(&self) -> bool {
        self.rows() > self.cost_rows
    }

    /// Removes all constraints.
    pub(super) fn clear_constraints(&mut self) {
        self.residuals.truncate(self.cost_rows);
        self.constraints.truncate(0);
        self.heaps_by_slack.iter_mut().for_each(BinaryHeap::clear);
        self.is_active.clear();
    }

    /// Makes all constraints inactive.
    pub(super) fn deactivate_constraints(&mut self) {
        self.residuals.truncate(self.cost_rows);
        self.is_active.fill(false);
    }

    /// Activates the constraints that `step` violates. None when it violates no inactive constraint, or the
    /// budget was spent.
    pub(crate) fn activate_violated(
        &mut self,
        step: &[f64],
        budget: &mut Budget<'_>,
    ) -> Option<()> {
        let before = self.rows();
        self.compute_prefix_sums(step);
        for index in 0..self.constraints() {
            let change = self.change_of_constraint(index, step, budget)?;
            if !self.is_active[index] && self.constraint(index) + change < 0.0 {
                self.is_active[index] = true;
                self.push_active(index, self.constraint(index), 1.0);
            }
        }
        (self.rows() > before).then_some(())
    }

    /// Number of stored constraints.
    pub(super) fn constraints(&self) -> usize {
        self.constraints.values.len()
    }

    /// Stage and derivatives of a constraint.
    pub(super) fn constraint_row(&self, index: usize) -> (RowStage, &[f64]) {
        let row = &self.constraints.derivatives[index * self.stride..][..self.stride];
        (self.constraints.row_stages[index], row)
    }

    /// The value h of a constraint h + A Δ ≥ 0.
    pub(super) fn constraint(&self, index: usize) -> f64 {
        self.constraints.values[index]
    }

    /// Change of each constraint by `step`. None: the budget was spent.
    pub(super) fn change_constraints(
        &mut self,
        step: &[f64],
        into: &mut [f64],
        budget: &mut Budget<'_>,
    ) -> Option<()> {
        self.compute_prefix_sums(step);
        for (index, change) in into.iter_mut().enumerate().take(self.constraints()) {
            *change = self.change_of_constraint(index, step, budget)?;
        }
        Some(())
    }

    /// The largest part of `step`, at most 1, that violates no constraint. 0 if the step leaves a constraint
    /// violated that was violated before. None: the budget was spent.
    pub(super) fn feasible_step_length(
        &mut self,
        step: &[f64],
        budget: &mut Budget<'_>,
    ) -> Option<f64> {
        self.compute_prefix_sums(step);
        let mut part = 1.0;
        for index in 0..self.constraints() {
            let change = self.change_of_constraint(index, step, budget)?;
            let h = self.constraint(index);
            if h + change < 0.0 {
                part = if h > 0.0 {
                    f64::min(part, h / -change)
                } else {
                    0.0
                };
            }
        }
        Some(part)
    }

    /// Replaces the active constraints by those for which `constraint_weight`, called with index and h, returns (value,
    /// weight). Each adds weight · (value + A Δ)² to the cost. None: the budget was spent.
    pub(super) fn weight_constraints(
        &mut self,
        constraint_weight: impl Fn(usize, f64) -> Option<(f64, f64)>,
        budget: &mut Budget<'_>,
    ) -> Option<()> {
        self.residuals.truncate(self.cost_rows);
        for index in 0..self.constraints() {
            if !budget.spend(self.stride as u32) {
                return None;
            }
            if let Some((value, weight)) = constraint_weight(index, self.constraint(index)) {
                self.push_active(index, value, weight.sqrt());
            }
        }
        Some(())
    }

    /// Adds a constraint to the residuals, multiplied by `scale`.
    fn push_active(&mut self, index: usize, value: f64, scale: f64) {
        let (stride, constraints) = (self.stride, &self.constraints);
        let row = &constraints.derivatives[index * stride..][..stride];
        let stage = constraints.row_stages[index];
        let active = self.residuals.push(scale * value, stage, stride);
        for (target, derivative) in active.iter_mut().zip(row) {
            *target = scale * derivative;
        }
    }

    fn compute_prefix_sums(&mut self, step: &[f64]) {
        if self.is_staged {
            self.stages.compute_prefix_sums(step, &mut self.sums);
        }
    }

    /// Change of a constraint by `step`, after [`Self::compute_prefix_sums`]. None: the budget was spent.
    fn change_of_constraint(
        &self,
        index: usize,
        step: &[f64],
        budget: &mut Budget<'_>,
    ) -> Option<f64> {
        let row = &self.constraints.derivatives[index * self.stride..][..self.stride];
        let is_left = budget.spend(self.stride as u32);
        is_left.then(|| {
            if self.is_staged {
                let stage = self.constraints.row_stages[index];
                self.stages.change(row, stage, step, &self.sums)
            } else {
                dot(row, step)
            }
        })
    }

    /// Writes half the gradient of the cost, Jᵀr. Returns its upper bound, the Frobenius norm of J times the
    /// norm of r. None: the budget was spent.
    pub(crate) fn gradient(&mut self, into: &mut [f64], budget: &mut Budget<'_>) -> Option<f64> {
        into.fill(0.0);
        let stride = self.stride;
        let sums = if self.is_staged {
            with_known_size!(stride, self.add_staged_gradient(stride, into, budget))
        } else {
            with_known_size!(stride, self.add_dense_gradient(stride, into, budget))
        };
        let (mut jacobian, mut residuals) = sums?;
        if let Some((weight, distances)) = self.regulariser() {
            add_times(weight, distances, into);
            residuals += weight * dot(distances, distances);
            jacobian += weight * distances.len() as f64;
        }
        Some(f64::sqrt(jacobian * residuals))
    }

    /// Adds Jᵀr of dense rows. Returns the squared norms of J and r. None: the budget was spent.
    #[inline(always)]
    fn add_dense_gradient(
        &self,
        stride: usize,
        into: &mut [f64],
        budget: &mut Budget<'_>,
    ) -> Option<(f64, f64)> {
        let (mut jacobian, mut residuals) = (0.0, 0.0);
        for (index, &residual) in self.residuals().iter().enumerate() {
            if !budget.spend(stride as u32) {
                return None;
            }
            let row = &self.row(index)[..stride];
            residuals += residual * residual;
            add_times(residual, row, &mut into[..stride]);
            jacobian += dot(row, row);
        }
        Some((jacobian, residuals))
    }

    /// The same of staged rows.
    #[inline(always)]
    fn add_staged_gradient(
        &mut self,
        stride: usize,
        into: &mut [f64],
        budget: &mut Budget<'_>,
    ) -> Option<(f64, f64)> {
        self.sums.clear();
        self.sums.resize(into.len(), 0.0);
        let (mut jacobian, mut residuals) = (0.0, 0.0);
        // Squared lengths of the blocks before that of the row; most rows come in the order of their blocks.
        let (mut blocks, mut squared_periods) = (0, 0.0);
        for index in 0..self.rows() {
            if !budget.spend(stride as u32) {
                return None;
            }
            let (residual, stage) = (self.residual(index), self.stage(index));
            let row = &self.residuals.derivatives[index * stride..][..stride];
            let square = dot(row, row);
            residuals += residual * residual;
            let first = stage.block * stride;
            add_times(stage.periods * residual, row, &mut into[first..][..stride]);
            if stage.since_start {
                add_times(residual, row, &mut self.sums[first..][..stride]);
            }
            if stage.block < blocks {
                (blocks, squared_periods) = (0, 0.0);
            }
            for block in blocks..stage.block {
                let length = self.stages.length(block);
                squared_periods += length * length;
            }
            blocks = stage.block;
            let before = if stage.since_start {
                squared_periods
            } else {
                0.0
            };
            jacobian += square * (before + stage.periods * stage.periods);
        }
        self.stages.add_later(&self.sums, into);
        Some((jacobian, residuals))
    }
}

/// Fills a row. Dense: derivatives times the time for which each block was in force. Staged: derivatives
/// times the period.
#[inline(always)]
fn fill(row: &mut [f64], derivatives: &[f64], stage: RowStage, stages: &Stages, is_staged: bool) {
    let width = derivatives.len();
    // A row of the first block may leave out its last unknowns.
    debug_assert!(width == stages.width() || (stage.block == 0 && !is_staged));
    if is_staged {
        for (target, derivative) in row.iter_mut().zip(derivatives) {
            *target = stages.period() * derivative;
        }
        return;
    }
    let mut later = row;
    for index in 0..=stage.block {
        let (block, rest) = later.split_at_mut(width);
        later = rest;
        let periods = match index == stage.block {
            true => stage.periods,
            false if stage.since_start => stages.length(index),
            false => 0.0,
        };
        let factor = stages.period() * periods;
        for (target, derivative) in block.iter_mut().zip(derivatives) {
            *target = factor * derivative;
        }
    }
    later.fill(0.0);
}

/// An integer in the order of [`f64::total_cmp`].
fn in_order(number: f64) -> i64 {
    let bits = number.to_bits().cast_signed();
    bits ^ ((bits >> 63).cast_unsigned() >> 1).cast_signed()
}

#[cfg(test)]
mod tests;
