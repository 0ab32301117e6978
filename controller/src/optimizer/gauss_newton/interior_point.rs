//! The least-squares step inside the box that satisfies the constraints, if the unconstrained solution
//! violates some.
//!
//! A primal-dual interior point method (Nocedal & Wright, *Numerical Optimization*, ch. 16.6). Every bound
//! and every constraint has a slack s and a multiplier y with s y = µ, and µ decreases to nearly zero. A
//! bound adds a weight to its unknown, and a constraint is a weighted row. So each iteration is one pass of
//! the smoother, or one Riccati sweep (`riccati`).
//!
//! Constraints are soft: the square of a shortfall counts like that of a residual. So there is always a
//! solution, and a constraint weighs no more than an active row.

use super::{FoundStep, QuadraticTerm, Riccati, Smoother, Trial};
use crate::optimizer::{Bounds, Budget, LinearModel, Problem};

/// Largest number of iterations.
const ITERATIONS: u32 = 40;
/// Share of the distance to the boundary that an iteration may use.
const FRACTION_TO_BOUNDARY: f64 = 0.995;
/// Initial distance of an unknown from a bound where it stands, as a share of the box.
const INITIAL_DISTANCE_SHARE: f64 = 0.05;
/// Initial µ, relative to the mean of |gradient| times the width of the box. The mean square of the
/// violations applies if larger. So large that no bound is reached early.
const MU_BEGIN: f64 = 10.0;
/// Final µ, relative to the damping times the square of the box: the bounds then deflect the step less than
/// the damping.
const MU_END: f64 = 1e-3;
/// Final µ, relative to the initial µ from the gradient; less is rounding.
const MU_SHARE: f64 = 1e-9;
/// The same for a rough step.
const MU_SHARE_ROUGH: f64 = 1e-4;
/// Smallest number of iterations of a rough step.
const ROUGH_ITERATIONS: u32 = 4;
/// Nominal time of one bound in a pass over all \[ns\].
const BORDER_NS: u32 = 10;
/// Constraints with a weight below this share of the damping are omitted.
const NEGLIGIBLE: f64 = 1e-4;

/// The quadratic program: |r + J Δ|² + λ |Δ|² subject to bounds and constraints.
pub(super) struct QuadraticProgram<'a> {
    pub model: &'a mut LinearModel,
    pub smoother: &'a mut Smoother,
    /// Some: use a Riccati sweep instead of the smoother, if the weights are large enough.
    pub riccati: Option<&'a mut Riccati>,
    /// Jᵀ r.
    pub gradient: &'a [f64],
    pub damping: f64,
    pub is_rough: bool,
}

impl QuadraticProgram<'_> {
    /// Minimises the cost with the squares of value + A Δ for the constraints to which `constraint_weight` assigns
    /// (value, weight), and with the `term` of each unknown. Unknowns without a term stay. None: the budget
    /// was spent, or a number is not finite.
    fn minimise(
        &mut self,
        constraint_weight: impl Fn(usize, f64) -> Option<(f64, f64)>,
        term: impl Fn(usize) -> Option<QuadraticTerm>,
        step: &mut [f64],
        budget: &mut Budget<'_>,
    ) -> Option<()> {
        let whole = |i: usize| term(i).map(|term| term.with_own(self.model, i, self.damping));
        if let Some(riccati) = self.riccati.as_deref_mut()
            && riccati.solve(
                self.model,
                &constraint_weight,
                whole,
                self.is_rough,
                step,
                budget,
            )?
        {
            return Some(());
        }
        self.model.weight_constraints(constraint_weight, budget)?;
        let (model, damping) = (&*self.model, self.damping);
        let solved = self
            .smoother
            .solve_with_terms(model, term, damping, step, budget);
        solved.then_some(())
    }
}

/// Workspace.
#[derive(Debug)]
pub(super) struct InteriorPoint {
    lower: Vec<ComplementaryPair>,
    upper: Vec<ComplementaryPair>,
    constraints: Vec<ComplementaryPair>,
    /// The step towards which an iteration goes.
    target: Vec<f64>,
    /// Change of each constraint by the iteration.
    changes: Vec<f64>,
}

/// Slack and multiplier (`multiplier`) of a bound or constraint, with their changes in an iteration.
#[derive(Debug, Clone, Copy, Default)]
struct ComplementaryPair {
    slack: f64,
    multiplier: f64,
    slack_step: f64,
    multiplier_step: f64,
}

impl ComplementaryPair {
    fn new(slack: f64, multiplier: f64) -> Self {
        Self {
            slack,
            multiplier,
            ..Self::default()
        }
    }

    /// A soft constraint of this value: s - y equals the value.
    fn from_soft_constraint(value: f64, mu: f64) -> Self {
        let root = (value * value + 4.0 * mu).sqrt();
        // The larger of both is computed without cancellation.
        let larger = 0.5 * (value.abs() + root);
        let smaller = mu / larger;
        if value >= 0.0 {
            Self::new(larger, smaller)
        } else {
            Self::new(smaller, larger)
        }
    }

    fn complementarity(&self) -> f64 {
        self.slack * self.multiplier
    }

    /// Newton step for a bound of the box whose slack changes by `change`.
    fn set_bound_step(&mut self, change: f64, mu: f64) {
        self.slack_step = change;
        self.multiplier_step = (mu - self.multiplier * change) / self.slack - self.multiplier;
    }

    /// Newton step for a soft constraint whose value changes by `change`.
    fn set_soft_constraint_step(&mut self, change: f64, mu: f64) {
        self.multiplier_step = (mu - self.complementarity() - self.multiplier * change)
            / (self.slack + self.multiplier);
        self.slack_step = change + self.multiplier_step;
    }

    /// The part of the step after which slack or multiplier is zero, if less than `step_length`, which is returned
    /// otherwise. Most pairs need no division.
    fn limit(&self, step_length: f64) -> f64 {
        /// More than the rounding of a product and of a quotient.
        const ROUNDING: f64 = 1.0 + 1e-14;
        let limit = |step_length: f64, at: f64, step: f64| {
            if step < 0.0 && at <= step_length * (-step * ROUNDING) {
                step_length.min(-at / step)
            } else {
                step_length
            }
        };
        let by_slack = limit(step_length, self.slack, self.slack_step);
        limit(by_slack, self.multiplier, self.multiplier_step)
    }

    fn advance(&mut self, step_length: f64) {
        self.slack += step_length * self.slack_step;
        self.multiplier += step_length * self.multiplier_step;
    }
}

impl InteriorPoint {
    pub(super) fn with_capacity(unknowns: usize, constraints: usize) -> Self {
        Self {
            lower: Vec::with_capacity(unknowns),
            upper: Vec::with_capacity(unknowns),
            constraints: Vec::with_capacity(constraints),
            target: Vec::with_capacity(unknowns),
            changes: Vec::with_capacity(constraints),
        }
    }

    /// Finds the step, and offers the intermediate steps after 2, 4, 8, … iterations. A rough step ends with
    /// the first whole intermediate step that is better, from the fourth iteration on. None: the budget was
    /// spent, or a number is not finite.
    pub(super) fn solve<P: Problem>(
        &mut self,
        mut problem: QuadraticProgram,
        trial: &mut Trial<P>,
        step: &mut [f64],
        budget: &mut Budget<'_>,
    ) -> Option<FoundStep> {
        let (bounds, z) = (trial.bounds, trial.base);
        let mu_share = [MU_SHARE, MU_SHARE_ROUGH][usize::from(trial.is_rough)];
        let mu_end = self.initialise(&mut problem, (bounds, z), mu_share, step, budget)?;
        let mut centring = 0.1;
        for iteration in 1..=ITERATIONS {
            let mu = centring * self.mean_complementarity();
            let step_length = self.iterate(&mut problem, mu, step, budget)?;
            // Only a full step balances multipliers and gradient.
            if step_length > 0.99 && self.mean_complementarity() <= mu_end {
                break;
            }
            if iteration > 1 && iteration.is_power_of_two() {
                let taken = trial.offer_until_violation(step, budget)?;
                if trial.is_rough && iteration >= ROUGH_ITERATIONS && taken == (true, true) {
                    return Some(FoundStep::Evaluated);
                }
            }
            centring = if step_length > 0.9 {
                0.05
            } else {
                1.0 - 0.9 * step_length
            };
        }
        let intervals = bounds.lower().iter().zip(bounds.upper());
        for ((step, z), (lower, upper)) in step.iter_mut().zip(z).zip(intervals) {
            *step = (z + *step).clamp(*lower, *upper) - z;
        }
        let is_finite = step.iter().all(|step| step.is_finite());
        is_finite.then_some(FoundStep::NotEvaluated)
    }

    /// Sets the start inside the box. Returns the final µ. None: the budget was spent.
    fn initialise(
        &mut self,
        problem: &mut QuadraticProgram,
        (bounds, z): (&Bounds, &[f64]),
        mu_share: f64,
        step: &mut [f64],
        budget: &mut Budget<'_>,
    ) -> Option<f64> {
        let bounds = bounds.lower().iter().zip(bounds.upper());
        let widths = bounds.clone().map(|(lower, upper)| upper - lower);
        let pulls = problem.gradient.iter().zip(widths.clone());
        let pull: f64 = pulls.map(|(gradient, width)| gradient.abs() * width).sum();
        let square: f64 = widths.map(|width| width * width).sum();
        let count = step.len() as f64;
        let mu_from_gradient = MU_BEGIN * pull / count;
        let violation_squares =
            (0..problem.model.constraints()).map(|i| problem.model.constraint(i).min(0.0));
        let violation_squares: f64 = violation_squares.map(|h| h * h).sum();
        let mu_end = (MU_END * problem.damping * square / count).max(mu_share * mu_from_gradient);
        let mu = mu_from_gradient.max(violation_squares / count).max(mu_end);
        self.lower.clear();
        self.upper.clear();
        for ((step, z), (lower, upper)) in step.iter_mut().zip(z).zip(bounds) {
            let (lower, upper) = (lower - z, upper - z);
            let inside = INITIAL_DISTANCE_SHARE * (upper - lower);
            *step = if inside > 0.0 {
                0.0_f64.clamp(lower + inside, upper - inside)
            } else {
                lower
            };
            let border = |slack: f64| ComplementaryPair::new(slack, mu / slack);
            self.lower.push(border(*step - lower));
            self.upper.push(border(upper - *step));
        }
        let constraints = problem.model.constraints();
        self.changes.clear();
        self.changes.resize(constraints, 0.0);
        let changes = &mut self.changes;
        problem.model.change_constraints(step, changes, budget)?;
        self.constraints.clear();
        let values = changes.iter().enumerate();
        let values = values.map(|(index, change)| problem.model.constraint(index) + change);
        self.constraints
            .extend(values.map(|value| ComplementaryPair::from_soft_constraint(value, mu)));
        Some(mu_end)
    }

    /// Whether an unknown can move.
    fn is_free(&self, i: usize) -> bool {
        self.lower[i].slack > 0.0 && self.upper[i].slack > 0.0
    }

    fn mean_complementarity(&self) -> f64 {
        let free = (0..self.lower.len()).filter(|&i| self.is_free(i));
        let (mut sum, mut count) = (0.0, 0.0);
        for i in free {
            sum += self.lower[i].complementarity() + self.upper[i].complementarity();
            count += 2.0;
        }
        for constraint in &self.constraints {
            sum += constraint.complementarity();
            count += 1.0;
        }
        sum / f64::max(count, 1.0)
    }

    /// One Newton step towards s y = µ. Returns the part taken. None: the budget was spent, or a number is
    /// not finite.
    fn iterate(
        &mut self,
        problem: &mut QuadraticProgram,
        mu: f64,
        step: &mut [f64],
        budget: &mut Budget<'_>,
    ) -> Option<f64> {
        let least = NEGLIGIBLE * problem.damping;
        if !budget.spend(BORDER_NS / 2 * self.lower.len() as u32) {
            return None;
        }
        let constraint_weight = |index: usize, h: f64| {
            let ComplementaryPair {
                slack, multiplier, ..
            } = self.constraints[index];
            let weight = multiplier / (slack + multiplier);
            (weight > least).then(|| (h - slack - mu / multiplier, weight))
        };
        let mut target = core::mem::take(&mut self.target);
        target.clear();
        target.extend_from_slice(step);
        let term = |i: usize| {
            let (lower, upper) = (&self.lower[i], &self.upper[i]);
            let weight = lower.multiplier / lower.slack + upper.multiplier / upper.slack;
            let linear = weight * step[i] + mu / lower.slack - mu / upper.slack;
            self.is_free(i).then_some(QuadraticTerm { weight, linear })
        };
        let solved = problem.minimise(constraint_weight, term, &mut target, budget);
        self.target = target;
        solved?;
        for (target, step) in self.target.iter_mut().zip(&*step) {
            *target -= step;
        }
        let changes = &mut self.changes;
        problem
            .model
            .change_constraints(&self.target, changes, budget)?;
        self.advance(mu, step, budget)
    }

    /// Moves along the changes while slacks and multipliers stay positive. Returns the part taken. None: the
    /// budget was spent.
    fn advance(&mut self, mu: f64, step: &mut [f64], budget: &mut Budget<'_>) -> Option<f64> {
        let mut step_length = 1.0 / FRACTION_TO_BOUNDARY;
        for i in 0..step.len() {
            if !budget.spend(2 * BORDER_NS) {
                return None;
            }
            if self.is_free(i) {
                self.lower[i].set_bound_step(self.target[i], mu);
                self.upper[i].set_bound_step(-self.target[i], mu);
                step_length = self.upper[i].limit(self.lower[i].limit(step_length));
            }
        }
        for (constraint, change) in self.constraints.iter_mut().zip(&self.changes) {
            if !budget.spend(BORDER_NS) {
                return None;
            }
            constraint.set_soft_constraint_step(*change, mu);
            step_length = constraint.limit(step_length);
        }
        let step_length = FRACTION_TO_BOUNDARY * step_length;
        for i in 0..step.len() {
            if self.is_free(i) {
                step[i] += step_length * self.target[i];
                self.lower[i].advance(step_length);
                self.upper[i].advance(step_length);
            }
        }
        for constraint in &mut self.constraints {
            constraint.advance(step_length);
        }
        Some(step_length)
    }
}
