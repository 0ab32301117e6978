//! Steps that are tried: whole ones, and what a step that takes longer has found so far.

use crate::optimizer::{Bounds, Budget, Candidate, Evaluation, Incumbent, Problem};

/// What became of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Found {
    /// None: the matrix was singular, or the budget was spent.
    Nothing,
    /// The step was found, and not evaluated.
    Step,
    /// The step was found and evaluated; the incumbent took it where it was better.
    Tried,
}

/// The largest component of a step (rad/s in rates) whose gain rounding may hide: a longer step may gain what its model does not know of.
const HIDDEN_STEP: f64 = 1e-6;

/// Offers steps to the incumbent, so that a budget which ends in the middle of one leaves the best of it.
pub(super) struct Trial<'a, P> {
    pub problem: &'a P,
    pub bounds: &'a Bounds,
    /// Where they lead from.
    pub base: &'a [f64],
    /// Where the last one that was tried leads to.
    pub at: &'a mut Vec<f64>,
    pub incumbent: &'a mut Incumbent,
    pub origin: Candidate,
    /// Steps whose largest component is not above this are not worth trying.
    pub step_tolerance: f64,
    /// [`GaussNewtonSettings::is_rough`](super::GaussNewtonSettings::is_rough).
    pub is_rough: bool,
    /// Where [`Problem::rounding`] is some: the residuals of what was evaluated last.
    pub residuals: Option<&'a mut [f64]>,
}

impl<P: Problem> Trial<'_, P> {
    pub(super) fn is_small(&self, step: &[f64]) -> bool {
        step.iter().all(|step| step.abs() <= self.step_tolerance)
    }

    /// Whether rounding hides what a short step gains.
    pub(super) fn hides(&self, step: &[f64], gain: f64) -> bool {
        let is_short = step.iter().all(|step| step.abs() <= HIDDEN_STEP);
        let cost = self.incumbent.cost();
        is_short && !self.incumbent.is_violated() && cost.is_finite() && gain <= f64::EPSILON * cost
    }

    /// Writes where a part of a step leads to, inside the box.
    pub(super) fn lead(&mut self, step: &[f64], part: f64) {
        let walls = self.bounds.lower().iter().zip(self.bounds.upper());
        let led = self.base.iter().zip(step).zip(walls);
        let led = led.map(|((base, step), (&low, &high))| (base + part * step).clamp(low, high));
        self.at.clear();
        self.at.extend(led);
    }

    /// Offers a part of a step, and halves of that while they are not better. The part that was taken, 0 if none was; None: the budget was
    /// spent.
    pub(super) fn descend(
        &mut self,
        step: &[f64],
        mut part: f64,
        halvings: u32,
        budget: &mut Budget<'_>,
    ) -> Option<f64> {
        for _ in 0..=halvings {
            if self.offer(step, part, budget)? {
                return Some(part);
            }
            part *= 0.5;
        }
        Some(0.0)
    }

    /// Offers a step as far as it breaks no constraint and, where that is not better, halves of the step. The part that was taken, 0 if none or
    /// only its beginning was; None: the budget was spent.
    pub(super) fn descend_to_contact(
        &mut self,
        step: &[f64],
        halvings: u32,
        budget: &mut Budget<'_>,
    ) -> Option<f64> {
        match self.offer_to_contact(step, budget)? {
            (true, is_whole) => Some(f64::from(u8::from(is_whole))),
            (false, _) => self.descend(step, 0.5, halvings - 1, budget),
        }
    }

    /// Evaluates a step as far as it breaks no constraint. Whether that is better than the incumbent, which takes it then, and whether it is the
    /// whole step. None: the budget was spent.
    pub(super) fn offer_to_contact(
        &mut self,
        step: &[f64],
        budget: &mut Budget<'_>,
    ) -> Option<(bool, bool)> {
        self.lead(step, 1.0);
        let evaluated = self
            .problem
            .evaluate_to_contact(self.at, self.incumbent, budget);
        let (evaluation, is_whole) = evaluated?;
        Some((self.take(&evaluation), is_whole))
    }

    /// Evaluates a part of a step, and says whether it is better than the incumbent, which takes it then. None: the budget was spent.
    pub(super) fn offer(
        &mut self,
        step: &[f64],
        part: f64,
        budget: &mut Budget<'_>,
    ) -> Option<bool> {
        self.lead(step, part);
        let evaluation = if let Some(residuals) = &mut self.residuals {
            self.problem.evaluate_residuals(self.at, residuals, budget)
        } else {
            let enough = self.incumbent.cost();
            self.problem.evaluate_below(self.at, enough, budget)
        };
        Some(self.take(&evaluation?))
    }

    /// Whether what was tried last is better than the incumbent, which takes it then.
    pub(super) fn take(&mut self, evaluation: &Evaluation<1>) -> bool {
        self.incumbent
            .offer(|i| self.at[i], evaluation, 0, self.origin)
    }
}
