//! A problem near one point: residuals, their derivatives, and constraints that a step may meet.

use std::collections::BinaryHeap;

use super::{Budget, Stages, VIOLATIONS};

/// What a row depends on: the unknowns of one block, and perhaps those of all blocks before.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Place {
    pub(crate) block: usize,
    /// Whether it depends on the sum of the blocks before, too, each for its whole length.
    pub(crate) since_start: bool,
    /// For how many periods the unknowns of its block were in force.
    pub(crate) periods: f64,
}

/// Numbers, each with its derivatives.
#[derive(Debug, Clone, Default)]
struct Rows {
    values: Vec<f64>,
    derivatives: Vec<f64>,
    places: Vec<Place>,
}

impl Place {
    /// Of the only block there is, or of none.
    pub(crate) const LAST: Self = Self {
        block: 0,
        since_start: true,
        periods: 1.0,
    };
}

impl Rows {
    fn with_capacity(rows: usize, columns: usize) -> Self {
        Self {
            values: Vec::with_capacity(rows),
            derivatives: Vec::with_capacity(rows * columns),
            places: Vec::with_capacity(rows),
        }
    }

    fn truncate(&mut self, rows: usize, stride: usize) {
        self.values.truncate(rows);
        self.derivatives.truncate(rows * stride);
        self.places.truncate(rows);
    }

    /// Adds a row with all derivatives zero.
    fn push(&mut self, value: f64, place: Place, stride: usize) -> &mut [f64] {
        let start = self.derivatives.len();
        self.values.push(value);
        self.places.push(place);
        self.derivatives.resize(start + stride, 0.0);
        &mut self.derivatives[start..]
    }
}

/// Residuals r, Jacobian J and linearised constraints h + A Δ ≥ 0 at one point.
///
/// A constraint that a step would break becomes a residual of its own, so the step ends on it. Each is
/// written by its problem in a scale in which it outweighs the residuals.
///
/// A row is kept with a derivative for each unknown, or *staged*: with the derivatives of its [`Place`] alone, which every block that
/// it depends on shares.
#[derive(Debug, Clone)]
pub(crate) struct LinearModel {
    stages: Stages,
    is_staged: bool,
    /// Derivatives that are kept of a row.
    stride: usize,
    residuals: Rows,
    /// Residuals of the cost; those after them are constraints that were met.
    cost_rows: usize,
    constraints: Rows,
    /// Of each kind, how far each is from being broken, in the measure of its problem, and its index.
    slackest: [BinaryHeap<(i64, usize)>; VIOLATIONS],
    met: Vec<bool>,
    constraints_max: usize,
    /// Weight of the squared unknowns themselves.
    weight: f64,
    weighed: Vec<f64>,
    /// Memory for the sum of the blocks before a block.
    sums: Vec<f64>,
}

impl LinearModel {
    /// Room for problems of `unknowns`, `columns` of which are kept where rows are not staged.
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
            slackest: core::array::from_fn(|_| BinaryHeap::with_capacity(constraints)),
            met: Vec::with_capacity(constraints),
            constraints_max: constraints,
            weight: 0.0,
            weighed: Vec::with_capacity(unknowns),
            sums: Vec::with_capacity(unknowns),
        }
    }

    /// Forgets all rows; those that come are staged or not.
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
        self.weighed.clear();
    }

    /// Adds a residual, with its derivatives by what unknowns do in a unit of time. Places come in the order of their blocks.
    pub(crate) fn push(&mut self, residual: f64, derivatives: &[f64], place: Place) {
        self.cost_rows += 1;
        let row = self.residuals.push(residual, place, self.stride);
        fill(row, derivatives, place, &self.stages, self.is_staged);
    }

    /// The weight on the square of each unknown, which is at zᵢ. No row is kept of it.
    pub(crate) fn weigh(&mut self, weight: f64, z: &[f64]) {
        self.weight = weight;
        self.weighed.clear();
        self.weighed.extend_from_slice(z);
    }

    /// Adds a residual with all derivatives zero, and returns them for the caller to fill in. Not for what is staged.
    pub(crate) fn push_alone(&mut self, residual: f64) -> &mut [f64] {
        debug_assert!(!self.is_staged, "a row of no place");
        self.cost_rows += 1;
        self.residuals.push(residual, Place::LAST, self.stride)
    }

    /// Adds a constraint h + A Δ ≥ 0 of a kind (below [`VIOLATIONS`]) with its derivatives as those of a residual. Of more than there
    /// is room for, steps see those with the least `slack`.
    /// No kind takes more than its equal part of the room while another needs it.
    pub(crate) fn push_constraint(
        &mut self,
        kind: usize,
        h: f64,
        slack: f64,
        derivatives: &[f64],
        place: Place,
    ) {
        let order = in_order(slack);
        let rows = &mut self.constraints;
        let mut index = rows.values.len();
        if index < self.constraints_max {
            rows.push(h, place, self.stride);
            self.met.push(false);
        } else {
            let crowded = if self.slackest[kind].len() < self.constraints_max / VIOLATIONS {
                self.slackest.iter_mut().max_by_key(|heap| heap.len())
            } else {
                let own = &mut self.slackest[kind];
                own.peek().is_some_and(|most| order < most.0).then_some(own)
            };
            let Some((_, freed)) = crowded.and_then(BinaryHeap::pop) else {
                return;
            };
            index = freed;
            rows.values[index] = h;
            rows.places[index] = place;
            rows.derivatives[index * self.stride..][..self.stride].fill(0.0);
        }
        self.slackest[kind].push((order, index));
        let row = &mut rows.derivatives[index * self.stride..][..self.stride];
        fill(row, derivatives, place, &self.stages, self.is_staged);
    }

    pub(super) fn stages(&self) -> &Stages {
        &self.stages
    }

    pub(super) fn is_staged(&self) -> bool {
        self.is_staged
    }

    /// The weight of the square of each unknown, and where it was: what [`Self::weigh`] was told.
    pub(super) fn weighed(&self) -> Option<(f64, &[f64])> {
        (self.weight > 0.0).then_some((self.weight, &self.weighed))
    }

    /// Residuals of the cost: the first of all.
    pub(crate) fn cost_rows(&self) -> usize {
        self.cost_rows
    }

    /// Residuals, with those of constraints that were met.
    pub(crate) fn rows(&self) -> usize {
        self.residuals.values.len()
    }

    pub(crate) fn residual(&self, index: usize) -> f64 {
        self.residuals.values[index]
    }

    /// The residuals of the cost, for those of another point.
    pub(super) fn residuals_mut(&mut self) -> &mut [f64] {
        &mut self.residuals.values[..self.cost_rows]
    }

    /// The derivatives that are kept of a row.
    pub(crate) fn row(&self, index: usize) -> &[f64] {
        &self.residuals.derivatives[index * self.stride..][..self.stride]
    }

    pub(super) fn place(&self, index: usize) -> Place {
        self.residuals.places[index]
    }

    /// Whether a constraint was met.
    pub(super) fn is_constrained(&self) -> bool {
        self.rows() > self.cost_rows
    }

    /// Forgets all constraints.
    pub(super) fn clear_constraints(&mut self) {
        self.residuals.truncate(self.cost_rows, self.stride);
        self.constraints.truncate(0, 0);
        self.slackest.iter_mut().for_each(BinaryHeap::clear);
        self.met.clear();
    }

    /// Forgets which constraints were met.
    pub(super) fn release_constraints(&mut self) {
        self.residuals.truncate(self.cost_rows, self.stride);
        self.met.fill(false);
    }

    /// Makes residuals of the constraints that `step` breaks. None when it breaks none that were not met
    /// before, or the budget was spent.
    pub(crate) fn meet_constraints(&mut self, step: &[f64], budget: &mut Budget<'_>) -> Option<()> {
        let before = self.rows();
        self.sum_up(step);
        for index in 0..self.constraints() {
            let change = self.change_of_constraint(index, step, budget)?;
            if !self.met[index] && self.constraint(index) + change < 0.0 {
                self.met[index] = true;
                self.push_met(index, self.constraint(index), 1.0);
            }
        }
        (self.rows() > before).then_some(())
    }

    /// Constraints that steps see.
    pub(super) fn constraints(&self) -> usize {
        self.constraints.values.len()
    }

    /// Place and derivatives of a constraint.
    pub(super) fn constraint_row(&self, index: usize) -> (Place, &[f64]) {
        let row = &self.constraints.derivatives[index * self.stride..][..self.stride];
        (self.constraints.places[index], row)
    }

    /// The number h of a constraint h + A Δ ≥ 0.
    pub(super) fn constraint(&self, index: usize) -> f64 {
        self.constraints.values[index]
    }

    /// What `step` changes of each constraint. None: the budget was spent.
    pub(super) fn change_constraints(
        &mut self,
        step: &[f64],
        into: &mut [f64],
        budget: &mut Budget<'_>,
    ) -> Option<()> {
        self.sum_up(step);
        for (index, change) in into.iter_mut().enumerate().take(self.constraints()) {
            *change = self.change_of_constraint(index, step, budget)?;
        }
        Some(())
    }

    /// The part of `step`, up to all of it, that breaks no constraint; 0 where one is broken before, and after the step still. None: the budget
    /// was spent.
    pub(super) fn part_kept(&mut self, step: &[f64], budget: &mut Budget<'_>) -> Option<f64> {
        self.sum_up(step);
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

    /// Makes residuals, in place of those that were met, of all constraints whose (value, weight) by index and h is some: the square of
    /// value + A Δ counts so much.
    /// None: the budget was spent.
    pub(super) fn weigh_constraints(
        &mut self,
        weighed: impl Fn(usize, f64) -> Option<(f64, f64)>,
        budget: &mut Budget<'_>,
    ) -> Option<()> {
        self.residuals.truncate(self.cost_rows, self.stride);
        for index in 0..self.constraints() {
            if !budget.spend(self.stride as u32) {
                return None;
            }
            if let Some((value, weight)) = weighed(index, self.constraint(index)) {
                self.push_met(index, value, weight.sqrt());
            }
        }
        Some(())
    }

    /// Adds a constraint to the residuals, times `scale`.
    fn push_met(&mut self, index: usize, value: f64, scale: f64) {
        let (stride, constraints) = (self.stride, &self.constraints);
        let row = &constraints.derivatives[index * stride..][..stride];
        let place = constraints.places[index];
        let into = self.residuals.push(scale * value, place, stride);
        for (target, derivative) in into.iter_mut().zip(row) {
            *target = scale * derivative;
        }
    }

    fn sum_up(&mut self, step: &[f64]) {
        if self.is_staged {
            self.stages.sum_up(step, &mut self.sums);
        }
    }

    /// What `step`, which was summed up, changes of a constraint. None: the budget was spent.
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
                let place = self.constraints.places[index];
                self.stages.change(row, place, step, &self.sums)
            } else {
                dot(row, step)
            }
        })
    }

    /// Half the gradient of the cost, Jᵀr, and what its norm would be if all rows pulled one way: the Frobenius
    /// norm of J times the norm of r. None: the budget was spent.
    pub(crate) fn gradient(&mut self, into: &mut [f64], budget: &mut Budget<'_>) -> Option<f64> {
        into.fill(0.0);
        self.sums.clear();
        if self.is_staged {
            self.sums.resize(into.len(), 0.0);
        }
        let (mut jacobian, mut residuals) = (0.0, 0.0);
        // Of the blocks before that of a row: most rows come in their order.
        let (mut blocks, mut squared_periods) = (0, 0.0);
        for index in 0..self.rows() {
            if !budget.spend(self.stride as u32) {
                return None;
            }
            let (residual, place) = (self.residual(index), self.place(index));
            let row = &self.residuals.derivatives[index * self.stride..][..self.stride];
            let square = dot(row, row);
            residuals += residual * residual;
            if !self.is_staged {
                add_times(residual, row, into);
                jacobian += square;
                continue;
            }
            let first = place.block * self.stride;
            add_times(place.periods * residual, row, &mut into[first..]);
            if place.since_start {
                add_times(residual, row, &mut self.sums[first..]);
            }
            if place.block < blocks {
                (blocks, squared_periods) = (0, 0.0);
            }
            let lengths = self.stages.lengths().iter();
            for length in lengths.take(place.block).skip(blocks) {
                squared_periods += length * length;
            }
            blocks = place.block;
            let before = if place.since_start {
                squared_periods
            } else {
                0.0
            };
            jacobian += square * (before + place.periods * place.periods);
        }
        if self.is_staged {
            self.stages.add_later(&self.sums, into);
        }
        if let Some((weight, z)) = self.weighed() {
            add_times(weight, z, into);
            residuals += weight * dot(z, z);
            jacobian += weight * z.len() as f64;
        }
        Some(f64::sqrt(jacobian * residuals))
    }
}

/// Adds a row times a factor, as far as both go.
fn add_times(factor: f64, row: &[f64], into: &mut [f64]) {
    for (sum, derivative) in into.iter_mut().zip(row) {
        *sum += derivative * factor;
    }
}

/// Writes derivatives into a row as it is kept: times the periods for which each block was in force, or as they are.
fn fill(row: &mut [f64], derivatives: &[f64], place: Place, stages: &Stages, is_staged: bool) {
    let width = stages.width();
    if is_staged {
        for (target, derivative) in row.iter_mut().zip(derivatives) {
            *target = stages.period() * derivative;
        }
        return;
    }
    for (index, block) in row
        .chunks_exact_mut(width)
        .enumerate()
        .take(place.block + 1)
    {
        let periods = match index == place.block {
            true => place.periods,
            false if place.since_start => stages.lengths()[index],
            false => 0.0,
        };
        let factor = stages.period() * periods;
        for (target, derivative) in block.iter_mut().zip(derivatives) {
            *target = factor * derivative;
        }
    }
}

/// An integer that is in the order of [`f64::total_cmp`].
fn in_order(number: f64) -> i64 {
    let bits = number.to_bits().cast_signed();
    bits ^ ((bits >> 63).cast_unsigned() >> 1).cast_signed()
}

/// Σ aᵢ bᵢ over the shorter length, in eight sums side by side: the order is fixed, and no product waits for the
/// one before it.
#[inline]
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let length = a.len().min(b.len());
    if length < 8 {
        return 0.0 + a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    }
    dot_eights(a, b, length)
}

fn dot_eights(a: &[f64], b: &[f64], length: usize) -> f64 {
    let (a, a_rest) = a[..length].as_chunks::<8>();
    let (b, b_rest) = b[..length].as_chunks::<8>();
    let mut sums = [0.0; 8];
    for (a, b) in a.iter().zip(b) {
        for i in 0..8 {
            sums[i] += a[i] * b[i];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    let [s0, s1, s2, s3, s4, s5, s6, s7] = sums;
    ((s0 + s1) + (s2 + s3)) + ((s4 + s5) + (s6 + s7)) + rest
}

#[cfg(test)]
mod tests;
