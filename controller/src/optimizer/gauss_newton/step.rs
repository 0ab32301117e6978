//! The damped step inside the box that satisfies the constraints: an active set around a linear system.

use super::interior_point::QuadraticProgram;
use super::trial::{FoundStep, Trial};
use super::{GaussNewton, HALVINGS, QuadraticTerm, Riccati};
use crate::optimizer::{Bounds, Budget, Problem, Reach};

/// Largest number of active-set rounds: fix unknowns at their bounds, and solve again for the others.
const ACTIVE_SET_ROUNDS: usize = 12;
/// The same for a staged step that another linearisation follows: far from the solution, that gains more in the time of
/// two rounds.
const STAGED_ROUNDS: usize = 8;
/// A staged step that is clamped to the box and reduces the cost to this share is taken as it is: near the solution, the
/// next linearisation starts with the right unknowns at their bounds.
const CLAMPED_SHARE: f64 = 0.01;
/// An unknown whose excess is at least this share of the largest is fixed in the same round. Unknowns at a
/// bound have an infinite excess, so they are fixed together.
const FIRST_SHARE: f64 = 0.9;
/// Halvings of a staged step before constraints are linearised.
const HALVINGS_FIRST: u32 = 2;
/// The part of the step after these halvings.
const LENGTH_NEXT: f64 = 0.125;
/// Constraints are linearised for steps up to this many times as long as the step in the box, because a step
/// around constraints is longer. Rough steps use 1.
const REACH: f64 = 2.0;
/// Largest number of rounds: find a step, and activate the constraints that it violates.
const CONSTRAINT_ROUNDS: usize = 3;

impl GaussNewton {
    /// Finds the step inside the box. Activates the constraints that it violates, and solves again.
    pub(super) fn find_step<P: Problem>(
        &mut self,
        trial: &mut Trial<P>,
        damping: f64,
        budget: &mut Budget<'_>,
    ) -> FoundStep {
        if self.model.is_staged() {
            let found = self.find_staged_step(trial, damping, budget);
            return found.unwrap_or(FoundStep::Nothing);
        }
        self.model.deactivate_constraints();
        for _ in 0..CONSTRAINT_ROUNDS {
            if self.find_step_in_box(trial, damping, budget).is_none() {
                return FoundStep::Nothing;
            }
            let step = &self.step[..trial.base.len()];
            if self.model.activate_violated(step, budget).is_none() {
                break;
            }
        }
        FoundStep::NotEvaluated
    }

    /// The same for staged rows, with an interior point method if the step in the box violates a constraint.
    /// Intermediate steps are offered to the incumbent, so they remain when the budget ends. None: the matrix
    /// was singular, or the budget was spent.
    fn find_staged_step<P: Problem>(
        &mut self,
        trial: &mut Trial<P>,
        damping: f64,
        budget: &mut Budget<'_>,
    ) -> Option<FoundStep> {
        self.model.clear_constraints();
        let violations = trial.incumbent.violations();
        if trial.is_rough && !self.riccati.accumulate_cost(&self.model, budget) {
            return None;
        }
        if self.find_step_in_box(trial, damping, budget)? {
            return Some(FoundStep::Evaluated);
        }
        let (problem, z) = (trial.problem, trial.base);
        let step = &mut self.step[..z.len()];
        // A base point that violates a constraint, or was not evaluated, needs the constraints even for a
        // small step.
        let is_kept = trial.incumbent.is_evaluated() && !trial.incumbent.is_violated();
        if trial.is_small(step) && is_kept {
            return Some(FoundStep::NotEvaluated);
        }
        // A better step without violations needs no constraints.
        let step_length = trial.backtrack_until_violation(step, HALVINGS_FIRST, budget)?;
        if step_length == 1.0 && !trial.incumbent.is_violated() {
            return Some(FoundStep::Evaluated);
        }
        let reach = Reach {
            step,
            times: if trial.is_rough { 1.0 } else { REACH },
            violations,
        };
        if !problem.constrain(z, Some(reach), &mut self.model, budget) {
            return None;
        }
        let feasible_length = self.model.feasible_step_length(step, budget)?;
        if feasible_length >= 1.0 {
            if step_length == 0.0 {
                trial.backtrack(step, LENGTH_NEXT, HALVINGS - HALVINGS_FIRST - 1, budget)?;
            }
            return Some(FoundStep::Evaluated);
        }
        if feasible_length > step_length {
            trial.offer(step, feasible_length, budget)?;
        }
        let is_informed = trial.is_rough || Riccati::is_faster(&self.model);
        if is_informed && !trial.is_rough && !self.riccati.accumulate_cost(&self.model, budget) {
            return None;
        }
        let quadratic = QuadraticProgram {
            is_rough: trial.is_rough,
            model: &mut self.model,
            smoother: &mut self.smoother,
            riccati: is_informed.then_some(&mut self.riccati),
            gradient: &self.gradient,
            damping,
        };
        self.interior_point.solve(quadratic, trial, step, budget)
    }

    /// Finds the step inside the box: unknowns that would leave it are fixed at the bound, and the system is
    /// solved again for the others. Returns whether the clamped step was so good that the incumbent adopted it. None: the
    /// matrix was singular, or the budget was spent.
    fn find_step_in_box<P: Problem>(
        &mut self,
        trial: &mut Trial<P>,
        damping: f64,
        budget: &mut Budget<'_>,
    ) -> Option<bool> {
        let (bounds, z) = (trial.bounds, trial.base);
        let dimension = z.len();
        self.step[..dimension].fill(0.0);
        self.free.clear();
        // An active constraint may pull an unknown away from the bound on which the gradient presses it.
        self.free.extend(0..dimension);
        if !self.model.has_active_constraints() {
            self.free.retain(|&i| !self.at_active_bound[i]);
        }
        let is_staged = self.model.is_staged();
        let is_short = is_staged && trial.is_followed;
        let rounds = [ACTIVE_SET_ROUNDS, STAGED_ROUNDS][usize::from(is_short)];
        let mut is_taken = false;
        for round in 0..rounds {
            if !self.solve_free(dimension, damping, trial.is_rough, budget) {
                return None;
            }
            let excess = self.excess_max(bounds, z);
            if excess == 0.0 {
                break;
            }
            if round == 0 && is_staged {
                let most = CLAMPED_SHARE * trial.incumbent.cost();
                let may_take = trial.is_followed && trial.incumbent.is_evaluated();
                let step = &self.step[..dimension];
                let step_length = trial.backtrack_until_violation(step, HALVINGS_FIRST, budget)?;
                let incumbent = &trial.incumbent;
                is_taken = may_take
                    && step_length == 1.0
                    && incumbent.cost() < most
                    && !incumbent.is_violated();
                if is_taken {
                    break;
                }
            }
            self.fix_at_bounds(bounds, z, excess);
        }
        let intervals = bounds.lower().iter().zip(bounds.upper());
        for ((step, z), (&low, &high)) in self.step.iter_mut().zip(z).zip(intervals) {
            *step = (z + *step).clamp(low, high) - z;
        }
        Some(is_taken)
    }

    /// Largest excess of the free unknowns over the box, see [`excess`]; 0: the step stays inside.
    fn excess_max(&mut self, bounds: &Bounds, z: &[f64]) -> f64 {
        let intervals = bounds.lower().iter().zip(bounds.upper());
        let mut all = self.step.iter().zip(z).zip(intervals);
        if all.all(|((step, z), (low, high))| (low..=high).contains(&&(z + step))) {
            return 0.0;
        }
        let free = self.free.iter();
        let excesses = free.map(|&i| excess(bounds, i, z[i], self.step[i]));
        self.excesses.clear();
        self.excesses.extend(excesses);
        let larger = |most, excess| if excess > most { excess } else { most };
        self.excesses.iter().copied().fold(0.0, larger)
    }

    /// Fixes at their bounds the free unknowns that reach them first along the step: those with an excess
    /// near `excess_max`, the result of [`Self::excess_max`].
    ///
    /// The others stay free, because they need no longer compensate for the part outside the box. Fixing all
    /// at once would deflect the step to a corner of the box.
    fn fix_at_bounds(&mut self, bounds: &Bounds, z: &[f64], excess_max: f64) {
        let (step, mut excesses) = (&mut self.step, self.excesses.iter());
        self.free.retain(|&i| {
            let first = excesses
                .next()
                .is_some_and(|excess| *excess >= FIRST_SHARE * excess_max);
            if first {
                step[i] = to_bound(bounds, i, z[i], step[i]);
            }
            !first
        });
    }

    /// Solves for the free unknowns, with the fixed ones at their present step.
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
            self.factored = if is_rough { 0 } else { self.free.len() };
            if is_rough {
                let (model, free) = (&self.model, &self.free);
                // The free unknowns are sorted.
                let term = |i: usize| {
                    let is_free = free.binary_search(&i).is_ok();
                    is_free.then(|| QuadraticTerm::default().with_own(model, i, damping))
                };
                let solved = self
                    .riccati
                    .solve(model, |_, _| None, term, true, step, budget);
                return solved == Some(true);
            }
            return self
                .smoother
                .solve(&self.model, &self.free, damping, step, budget);
        }
        self.solve_dense(dimension, damping, budget)
    }
}

/// Ratio of the step of unknown `i` to its distance from the bound, 0 if it stays inside.
fn excess(bounds: &Bounds, i: usize, z: f64, step: f64) -> f64 {
    if (bounds.lower()[i]..=bounds.upper()[i]).contains(&(z + step)) {
        0.0
    } else {
        (step / to_bound(bounds, i, z, step)).abs()
    }
}

/// Distance of unknown `i` from the bound in the direction of its step.
fn to_bound(bounds: &Bounds, i: usize, z: f64, step: f64) -> f64 {
    let bound = if step > 0.0 {
        bounds.upper()[i]
    } else {
        bounds.lower()[i]
    };
    bound - z
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optimizer::Simd;

    #[test]
    fn all_that_press_on_the_border_where_they_stand_are_fixed_together() {
        let mut gauss_newton = GaussNewton::with_capacity(Simd::best(), 20, 20, 1, 0);
        let mut bounds = Bounds::with_capacity(20);
        bounds.set_symmetric(std::iter::repeat_n(1.0, 20), 1);
        // Sixteen are at the bound and would cross it by different amounts; four have space.
        let mut z = [1.0; 20];
        z[16..].fill(0.0);
        gauss_newton.free.extend(0..20);
        for (i, step) in gauss_newton.step.iter_mut().enumerate() {
            *step = if i < 16 { 1.0 + i as f64 } else { 5.0 };
        }
        let excess = gauss_newton.excess_max(&bounds, &z);
        assert_eq!(excess, f64::INFINITY);
        gauss_newton.fix_at_bounds(&bounds, &z, excess);
        assert_eq!(gauss_newton.free, [16, 17, 18, 19]);
        assert_eq!(gauss_newton.step[..16], [0.0; 16]);
        let excess = gauss_newton.excess_max(&bounds, &z);
        assert_eq!(excess, 5.0);
        gauss_newton.fix_at_bounds(&bounds, &z, excess);
        assert!(gauss_newton.free.is_empty());
        assert_eq!(gauss_newton.step[16..20], [1.0; 4]);
        assert_eq!(gauss_newton.excess_max(&bounds, &z), 0.0);
    }

    /// If the cost treats unknowns alike, they reach the bounds together except for rounding. Unknowns that
    /// reach them clearly later may still stay inside.
    #[test]
    fn ties_are_fixed_together_and_no_other_unknown() {
        let mut gauss_newton = GaussNewton::with_capacity(Simd::best(), 4, 4, 1, 0);
        let mut bounds = Bounds::with_capacity(4);
        bounds.set_symmetric(std::iter::repeat_n(1.0, 4), 1);
        gauss_newton.free.extend(0..4);
        gauss_newton.step[..4].copy_from_slice(&[2.0, -1.999, 1.85, 1.6]);
        let excess = gauss_newton.excess_max(&bounds, &[0.0; 4]);
        gauss_newton.fix_at_bounds(&bounds, &[0.0; 4], excess);
        assert_eq!(gauss_newton.free, [3]);
        assert_eq!(gauss_newton.step[..4], [1.0, -1.0, 1.0, 1.6]);
    }
}
