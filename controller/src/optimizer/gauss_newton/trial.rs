//! Evaluation of steps: whole ones, parts of them, and intermediate results of longer computations.

use crate::optimizer::{Bounds, Budget, Candidate, Evaluation, Incumbent, Problem};

/// Result of finding a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FoundStep {
    /// No step: the matrix was singular, or the budget was spent.
    Nothing,
    /// A step that was not evaluated.
    NotEvaluated,
    /// A step that was evaluated, and adopted by the incumbent if better.
    Evaluated,
}

/// Largest component (rad/s in rates) of a step whose gain may be hidden by rounding. A longer step may gain
/// more than the model predicts.
const ROUNDING_STEP_MAX: f64 = 1e-6;

/// Offers steps to the incumbent, so that the best of them remains when the budget ends.
pub(super) struct Trial<'a, P> {
    pub problem: &'a P,
    pub bounds: &'a Bounds,
    /// Start of the steps.
    pub base: &'a [f64],
    /// End of the last step tried.
    pub point: &'a mut Vec<f64>,
    pub incumbent: &'a mut Incumbent,
    pub origin: Candidate,
    /// Steps whose largest component is at most this are not tried.
    pub step_tolerance: f64,
    /// Whether another linearisation may follow this step.
    pub is_followed: bool,
    /// [`GaussNewtonSettings::is_rough`](super::GaussNewtonSettings::is_rough).
    pub is_rough: bool,
    /// Residuals of the last evaluated point, if [`Problem::rounding`] is some.
    pub residuals: Option<&'a mut [f64]>,
    /// Whether that point was better than the incumbent.
    pub is_last_better: bool,
}

impl<P: Problem> Trial<'_, P> {
    pub(super) fn is_small(&self, step: &[f64]) -> bool {
        step.iter().all(|step| step.abs() <= self.step_tolerance)
    }

    /// Whether rounding hides the gain of a short step.
    pub(super) fn is_gain_rounding(&self, step: &[f64], gain: f64) -> bool {
        let is_short = step.iter().all(|step| step.abs() <= ROUNDING_STEP_MAX);
        let cost = self.incumbent.cost();
        is_short && !self.incumbent.is_violated() && cost.is_finite() && gain <= f64::EPSILON * cost
    }

    /// Writes the end of a part of a step, clamped to the box.
    pub(super) fn compute_point(&mut self, step: &[f64], step_length: f64) {
        let intervals = self.bounds.lower().iter().zip(self.bounds.upper());
        let point = self.base.iter().zip(step).zip(intervals);
        let point =
            point.map(|((base, step), (&low, &high))| (base + step_length * step).clamp(low, high));
        self.point.clear();
        self.point.extend(point);
    }

    /// Backtracking line search: offers a part of a step, and halves it until it is better. Returns the
    /// accepted part, 0 if none. None: the budget was spent.
    pub(super) fn backtrack(
        &mut self,
        step: &[f64],
        mut step_length: f64,
        halvings: u32,
        budget: &mut Budget<'_>,
    ) -> Option<f64> {
        for _ in 0..=halvings {
            if self.offer(step, step_length, budget)? {
                return Some(step_length);
            }
            step_length *= 0.5;
        }
        Some(0.0)
    }

    /// Offers a step up to its first new constraint violation and, if that is not better, halves of the step.
    /// Returns the accepted part, 0 if none or if the step was cut. None: the budget was spent.
    pub(super) fn backtrack_until_violation(
        &mut self,
        step: &[f64],
        halvings: u32,
        budget: &mut Budget<'_>,
    ) -> Option<f64> {
        match self.offer_until_violation(step, budget)? {
            (true, is_whole) => Some(f64::from(u8::from(is_whole))),
            (false, _) => self.backtrack(step, 0.5, halvings - 1, budget),
        }
    }

    /// Evaluates a step up to its first new constraint violation. Returns whether it improved the incumbent,
    /// and whether the step is whole. None: the budget was spent.
    pub(super) fn offer_until_violation(
        &mut self,
        step: &[f64],
        budget: &mut Budget<'_>,
    ) -> Option<(bool, bool)> {
        self.compute_point(step, 1.0);
        let residuals = self.residuals.as_deref_mut().unwrap_or_default();
        let (point, incumbent) = (&mut *self.point, &*self.incumbent);
        let evaluated = self
            .problem
            .evaluate_until_violation(point, incumbent, residuals, budget);
        let (evaluation, is_whole) = evaluated?;
        Some((self.offer_evaluated(&evaluation), is_whole))
    }

    /// Evaluates a part of a step. Returns whether it improved the incumbent. None: the budget was spent.
    pub(super) fn offer(
        &mut self,
        step: &[f64],
        step_length: f64,
        budget: &mut Budget<'_>,
    ) -> Option<bool> {
        self.compute_point(step, step_length);
        let evaluation = if let Some(residuals) = &mut self.residuals {
            self.problem
                .evaluate_residuals(self.point, residuals, budget)
        } else {
            let cost_cutoff = self.incumbent.cost();
            self.problem.evaluate_below(self.point, cost_cutoff, budget)
        };
        Some(self.offer_evaluated(&evaluation?))
    }

    /// Offers the last tried point to the incumbent. Returns whether it was better.
    pub(super) fn offer_evaluated(&mut self, evaluation: &Evaluation<1>) -> bool {
        let point = |i| self.point[i];
        self.is_last_better = self.incumbent.offer(point, evaluation, 0, self.origin);
        self.is_last_better
    }
}
