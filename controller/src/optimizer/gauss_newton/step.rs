//! The damped step inside the box that keeps the constraints: an active set around a linear system.

use super::interior_point::Quadratic;
use super::trial::{Found, Trial};
use super::{GaussNewton, HALVINGS, Pull, Riccati};
use crate::optimizer::linear_model::dot;
use crate::optimizer::{Bounds, Budget, Problem, Reach, cholesky};

/// Rounds of fixing unknowns at their bounds and solving again for the others.
const ACTIVE_SET_ROUNDS: usize = 12;
/// Unknowns that meet the border nearly as early as the first are fixed with it. All that stand at it and press on it
/// meet it at once.
const FIRST_SHARE: f64 = 0.9;
/// Halvings of a staged step before constraints are linearised.
const HALVINGS_FIRST: u32 = 2;
/// The part after these.
const PART_NEXT: f64 = 0.125;
/// Steps are taken to go so many times as far as the one in the box: what meets constraints goes round them. Rough ones do not.
const REACH: f64 = 2.0;
/// Rounds of finding a step and meeting the constraints that it breaks.
const CONSTRAINT_ROUNDS: usize = 3;

impl GaussNewton {
    /// Finds the step inside the box that keeps the constraints: what it breaks is met and the rest
    /// solved again.
    pub(super) fn find_step<P: Problem>(
        &mut self,
        trial: &mut Trial<P>,
        damping: f64,
        budget: &mut Budget<'_>,
    ) -> Found {
        if self.model.is_staged() {
            let found = self.find_staged_step(trial, damping, budget);
            return found.unwrap_or(Found::Nothing);
        }
        self.model.release_constraints();
        for _ in 0..CONSTRAINT_ROUNDS {
            if self.find_step_in_box(trial, damping, budget).is_none() {
                return Found::Nothing;
            }
            let step = &self.step[..trial.base.len()];
            if self.model.meet_constraints(step, budget).is_none() {
                break;
            }
        }
        Found::Step
    }

    /// The same for staged rows: by an interior point where the step in the box breaks a constraint. What it finds on the way is tried, so a
    /// budget that ends it leaves that. None: the matrix was singular, or the budget was spent.
    fn find_staged_step<P: Problem>(
        &mut self,
        trial: &mut Trial<P>,
        damping: f64,
        budget: &mut Budget<'_>,
    ) -> Option<Found> {
        self.model.clear_constraints();
        let violations = trial.incumbent.violations();
        if trial.is_rough && !self.riccati.begin(&self.model, budget) {
            return None;
        }
        self.find_step_in_box(trial, damping, budget)?;
        let (problem, z) = (trial.problem, trial.base);
        let step = &mut self.step[..z.len()];
        // A plan that rests where it breaks a constraint, or may break one, has to be mended all the same.
        let is_kept = trial.incumbent.is_evaluated() && !trial.incumbent.is_violated();
        if trial.is_small(step) && is_kept {
            return Some(Found::Step);
        }
        // A step that is better and breaks nothing needs no constraints.
        let part = trial.descend_to_contact(step, HALVINGS_FIRST, budget)?;
        if part == 1.0 && !trial.incumbent.is_violated() {
            return Some(Found::Tried);
        }
        let reach = Reach {
            step,
            times: if trial.is_rough { 1.0 } else { REACH },
            violations,
        };
        if !problem.constrain(z, Some(reach), &mut self.model, budget) {
            return None;
        }
        let kept = self.model.part_kept(step, budget)?;
        if kept >= 1.0 {
            if part == 0.0 {
                trial.descend(step, PART_NEXT, HALVINGS - HALVINGS_FIRST - 1, budget)?;
            }
            return Some(Found::Tried);
        }
        if kept > part {
            trial.offer(step, kept, budget)?;
        }
        let is_informed = trial.is_rough || Riccati::pays(&self.model);
        if is_informed && !trial.is_rough && !self.riccati.begin(&self.model, budget) {
            return None;
        }
        let quadratic = Quadratic {
            is_rough: trial.is_rough,
            model: &mut self.model,
            smoother: &mut self.smoother,
            riccati: is_informed.then_some(&mut self.riccati),
            gradient: &self.gradient,
            damping,
        };
        self.interior_point.solve(quadratic, trial, step, budget)
    }

    /// Finds the step inside the box: unknowns that would leave it are fixed at its border and the
    /// others solved again.
    fn find_step_in_box<P: Problem>(
        &mut self,
        trial: &mut Trial<P>,
        damping: f64,
        budget: &mut Budget<'_>,
    ) -> Option<()> {
        let (bounds, z) = (trial.bounds, trial.base);
        let dimension = z.len();
        self.step[..dimension].fill(0.0);
        self.free.clear();
        // What the cost presses on a bound a constraint may pull away from it.
        self.free.extend(0..dimension);
        if !self.model.is_constrained() {
            self.free.retain(|&i| !self.pressed[i]);
        }
        for round in 0..ACTIVE_SET_ROUNDS {
            if !self.solve_free(dimension, damping, trial.is_rough, budget) {
                return None;
            }
            let excess = self.excess_max(bounds, z);
            if excess == 0.0 {
                break;
            }
            if round == 0 && self.model.is_staged() {
                let step = &self.step[..dimension];
                trial.descend_to_contact(step, HALVINGS_FIRST, budget)?;
            }
            self.fix_leavers(bounds, z, excess);
        }
        let walls = bounds.lower().iter().zip(bounds.upper());
        for ((step, z), (&low, &high)) in self.step.iter_mut().zip(z).zip(walls) {
            *step = (z + *step).clamp(low, high) - z;
        }
        Some(())
    }

    /// How many times further than the border of the box the step goes at most; 0: it stays inside.
    fn excess_max(&self, bounds: &Bounds, z: &[f64]) -> f64 {
        let walls = bounds.lower().iter().zip(bounds.upper());
        let mut all = self.step.iter().zip(z).zip(walls);
        if all.all(|((step, z), (low, high))| (low..=high).contains(&&(z + step))) {
            return 0.0;
        }
        let free = self.free.iter();
        free.map(|&i| excess(bounds, i, z[i], self.step[i]).0)
            .fold(0.0, f64::max)
    }

    /// Fixes the free unknowns that meet the border of the box first on the way along the step, at that border: those that go about
    /// `excess_max` times further.
    ///
    /// Only the first: once they are fixed, the others need no longer balance what they would have done
    /// beyond it. Fixing all that leave would bend the step to a corner of the box.
    fn fix_leavers(&mut self, bounds: &Bounds, z: &[f64], excess_max: f64) {
        let step = &mut self.step;
        self.free.retain(|&i| {
            let (excess, border) = excess(bounds, i, z[i], step[i]);
            let first = excess >= FIRST_SHARE * excess_max;
            if first {
                step[i] = border;
            }
            !first
        });
    }

    /// Solves for the free unknowns with the fixed ones at their present step.
    fn solve_free(
        &mut self,
        dimension: usize,
        damping: f64,
        is_rough: bool,
        budget: &mut Budget<'_>,
    ) -> bool {
        if self.free.is_empty() {
            return true;
        }
        if self.model.is_staged() {
            for &i in &self.free {
                self.step[i] = 0.0;
            }
            let step = &mut self.step[..dimension];
            if is_rough {
                let (model, free) = (&self.model, &self.free);
                // The free unknowns are in order.
                let pull = |i: usize| {
                    let is_free = free.binary_search(&i).is_ok();
                    is_free.then(|| Pull::default().with_own(model, i, damping))
                };
                let solved = self
                    .riccati
                    .solve(model, |_, _| None, pull, true, step, budget);
                return solved == Some(true);
            }
            return self
                .smoother
                .solve(&self.model, &self.free, damping, step, budget);
        }
        self.factored = self.free.len();
        let rows = self.model.rows();
        let weight = damping + self.model.weighed().map_or(0.0, |(weight, _)| weight);
        match self.set_out(dimension, damping, budget) {
            None => false,
            Some(true) => self.solve_in_residual_space(rows, weight, budget),
            Some(false) => self.solve_in_unknown_space(dimension, rows, weight, budget),
        }
    }

    /// Begins at the step that weights alone make of the free unknowns, if the system is solved in residual space, else at none, and writes what the
    /// residuals are there. Whether it is solved so; None: the budget was spent.
    fn set_out(&mut self, dimension: usize, damping: f64, budget: &mut Budget<'_>) -> Option<bool> {
        let rows = self.model.rows();
        let by_residuals = rows <= self.free.len();
        let weighed = self.model.weighed().filter(|_| by_residuals);
        for &i in &self.free {
            let own = weighed.map(|(weight, z)| -weight * z[i] / (damping + weight));
            self.step[i] = own.unwrap_or(0.0);
        }
        // What the fixed unknowns do already.
        let at_rest = self.step[..dimension].iter().all(|step| *step == 0.0);
        for row in 0..rows {
            self.residuals[row] = self.model.residual(row);
            if at_rest {
                continue;
            }
            if !budget.spend(dimension as u32) {
                return None;
            }
            self.residuals[row] += dot(self.model.row(row), &self.step[..dimension]);
        }
        Some(by_residuals)
    }

    /// The columns of the free unknowns, row by row, side by side in memory.
    fn gather_free_columns(&mut self, rows: usize, budget: &mut Budget<'_>) -> bool {
        let width = self.free.len();
        for row in 0..rows {
            if !budget.spend(width as u32) {
                return false;
            }
            let source = self.model.row(row);
            let target = &mut self.columns[row * width..][..width];
            if width == source.len() {
                target.copy_from_slice(source);
                continue;
            }
            for (target, &i) in target.iter_mut().zip(&self.free) {
                *target = source[i];
            }
        }
        true
    }

    /// Δ = -Jᵀ y with (J Jᵀ + wI) y = r, where w is the damping, and the weight of the unknowns.
    fn solve_in_residual_space(
        &mut self,
        rows: usize,
        weight: f64,
        budget: &mut Budget<'_>,
    ) -> bool {
        let width = self.free.len();
        if !self.gather_free_columns(rows, budget) {
            return false;
        }
        for a in 0..rows {
            let row_a = &self.columns[a * width..][..width];
            let line = self.matrix[a * rows..][..=a].iter_mut();
            let line = line.zip(self.columns.chunks_exact(width));
            for (b, (entry, row_b)) in line.enumerate() {
                if !budget.spend(width as u32 / 4) {
                    return false;
                }
                *entry = dot(row_a, row_b) + if a == b { weight } else { 0.0 };
            }
        }
        cholesky::factorise(&mut self.matrix[..rows * rows], rows, budget)
            && self.step_in_residual_space(rows, budget)
    }

    /// The same with the factor of the matrix.
    fn step_in_residual_space(&mut self, rows: usize, budget: &mut Budget<'_>) -> bool {
        let right_side = &mut self.right_side[..rows];
        right_side.copy_from_slice(&self.residuals[..rows]);
        if !cholesky::substitute(&self.matrix[..rows * rows], rows, right_side, budget) {
            return false;
        }
        for row in 0..rows {
            if !budget.spend(self.free.len() as u32) {
                return false;
            }
            let (weight, derivatives) = (self.right_side[row], self.model.row(row));
            if self.free.len() == derivatives.len() {
                for (step, derivative) in self.step.iter_mut().zip(derivatives) {
                    *step -= derivative * weight;
                }
                continue;
            }
            for &i in &self.free {
                self.step[i] -= derivatives[i] * weight;
            }
        }
        true
    }

    /// Solves again where the model has other residuals now, with the matrix of the last solution, for what was free in it; what was not rests. False, too,
    /// where fewer are free now.
    pub(super) fn solve_again(
        &mut self,
        dimension: usize,
        damping: f64,
        budget: &mut Budget<'_>,
    ) -> bool {
        if self.free.is_empty() || self.free.len() != self.factored {
            return false;
        }
        self.step[..dimension].fill(0.0);
        let rows = self.model.rows();
        match self.set_out(dimension, damping, budget) {
            None => false,
            Some(true) => self.step_in_residual_space(rows, budget),
            Some(false) => self.step_in_unknown_space(rows, budget),
        }
    }

    /// JᵀJ of the cost's rows, lower triangle, once for each linearisation.
    fn fill_gram(&mut self, dimension: usize, budget: &mut Budget<'_>) -> bool {
        if self.gram_is_current {
            return true;
        }
        let gram = &mut self.gram[..dimension * dimension];
        gram.fill(0.0);
        for row in 0..self.model.cost_rows() {
            let derivatives = self.model.row(row);
            for (i, target) in gram.chunks_exact_mut(dimension).enumerate() {
                // Early steps know nothing of late blocks.
                if derivatives[i] == 0.0 {
                    continue;
                }
                if !budget.spend(i as u32 / 2) {
                    return false;
                }
                for (sum, derivative) in target[..=i].iter_mut().zip(derivatives) {
                    *sum += derivatives[i] * derivative;
                }
            }
        }
        self.gram_is_current = true;
        true
    }

    /// The part of JᵀJ that belongs to the free unknowns, with the rows of constraints that were met.
    fn gather_free_matrix(
        &mut self,
        dimension: usize,
        rows: usize,
        budget: &mut Budget<'_>,
    ) -> bool {
        let order = self.free.len();
        for (a, &i) in self.free.iter().enumerate() {
            if !budget.spend(a as u32) {
                return false;
            }
            for (b, &k) in self.free[..=a].iter().enumerate() {
                self.matrix[a * order + b] = self.gram[i * dimension + k];
            }
        }
        for row in self.model.cost_rows()..rows {
            let derivatives = self.model.row(row);
            for (a, &i) in self.free.iter().enumerate() {
                if !budget.spend(a as u32) {
                    return false;
                }
                for (b, &k) in self.free[..=a].iter().enumerate() {
                    self.matrix[a * order + b] += derivatives[i] * derivatives[k];
                }
            }
        }
        true
    }

    /// (JᵀJ + wI) Δ = -Jᵀ r - ρ z, where ρ is the weight of the unknowns, and w that and the damping.
    fn solve_in_unknown_space(
        &mut self,
        dimension: usize,
        rows: usize,
        weight: f64,
        budget: &mut Budget<'_>,
    ) -> bool {
        let order = self.free.len();
        if !self.fill_gram(dimension, budget) || !self.gather_free_matrix(dimension, rows, budget) {
            return false;
        }
        for a in 0..order {
            self.matrix[a * order + a] += weight;
        }
        cholesky::factorise(&mut self.matrix[..order * order], order, budget)
            && self.step_in_unknown_space(rows, budget)
    }

    /// The same with the factor of the matrix.
    fn step_in_unknown_space(&mut self, rows: usize, budget: &mut Budget<'_>) -> bool {
        let order = self.free.len();
        let weighed = self.model.weighed();
        for (side, &i) in self.right_side.iter_mut().zip(&self.free) {
            // A fixed unknown has its step already, a free one none.
            *side = weighed.map_or(0.0, |(weight, z)| -weight * z[i]);
        }
        for row in 0..rows {
            if !budget.spend(order as u32) {
                return false;
            }
            let (residual, derivatives) = (self.residuals[row], self.model.row(row));
            for (sum, &i) in self.right_side.iter_mut().zip(&self.free) {
                *sum -= derivatives[i] * residual;
            }
        }
        let right_side = &mut self.right_side[..order];
        if !cholesky::substitute(&self.matrix[..order * order], order, right_side, budget) {
            return false;
        }
        for (a, &i) in self.free.iter().enumerate() {
            self.step[i] = self.right_side[a];
        }
        true
    }
}

/// How many times further than the border a step of unknown `i` from `z` goes, 0 where it stays inside, and the step to that border.
fn excess(bounds: &Bounds, i: usize, z: f64, step: f64) -> (f64, f64) {
    let (lower, upper) = (bounds.lower()[i], bounds.upper()[i]);
    let border = if step > 0.0 { upper - z } else { lower - z };
    let is_inside = (lower..=upper).contains(&(z + step));
    let excess = if is_inside {
        0.0
    } else {
        (step / border).abs()
    };
    (excess, border)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_that_press_on_the_border_where_they_stand_are_fixed_together() {
        let mut gauss_newton = GaussNewton::with_capacity(20, 20, 1, 0);
        let mut bounds = Bounds::with_capacity(20);
        bounds.set_symmetric(&std::iter::repeat_n(1.0, 20), 1);
        // Sixteen stand at the border and are to go beyond it, each by another amount; four have room.
        let mut z = [1.0; 20];
        z[16..].fill(0.0);
        gauss_newton.free.extend(0..20);
        for (i, step) in gauss_newton.step.iter_mut().enumerate() {
            *step = if i < 16 { 1.0 + i as f64 } else { 5.0 };
        }
        let excess = gauss_newton.excess_max(&bounds, &z);
        assert_eq!(excess, f64::INFINITY);
        gauss_newton.fix_leavers(&bounds, &z, excess);
        assert_eq!(gauss_newton.free, [16, 17, 18, 19]);
        assert_eq!(gauss_newton.step[..16], [0.0; 16]);
        let excess = gauss_newton.excess_max(&bounds, &z);
        assert_eq!(excess, 5.0);
        gauss_newton.fix_leavers(&bounds, &z, excess);
        assert!(gauss_newton.free.is_empty());
        assert_eq!(gauss_newton.step[16..20], [1.0; 4]);
        assert_eq!(gauss_newton.excess_max(&bounds, &z), 0.0);
    }

    /// A cost that does not tell unknowns apart takes them to the border together, but for rounding. Unknowns that get there clearly later may yet stay inside.
    #[test]
    fn ties_are_fixed_together_and_no_other_unknown() {
        let mut gauss_newton = GaussNewton::with_capacity(4, 4, 1, 0);
        let mut bounds = Bounds::with_capacity(4);
        bounds.set_symmetric(&std::iter::repeat_n(1.0, 4), 1);
        gauss_newton.free.extend(0..4);
        gauss_newton.step[..4].copy_from_slice(&[2.0, -1.999, 1.85, 1.6]);
        let excess = gauss_newton.excess_max(&bounds, &[0.0; 4]);
        gauss_newton.fix_leavers(&bounds, &[0.0; 4], excess);
        assert_eq!(gauss_newton.free, [3]);
        assert_eq!(gauss_newton.step[..4], [1.0, -1.0, 1.0, 1.6]);
    }
}
