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

use super::{Found, Pull, Riccati, Smoother, Trial};
use crate::optimizer::{Bounds, Budget, LinearModel, Problem};

/// Largest number of iterations.
const ITERATIONS: u32 = 40;
/// Share of the distance to the boundary that an iteration may use.
const WAY: f64 = 0.995;
/// Initial distance of an unknown from a bound where it stands, as a share of the box.
const INSIDE: f64 = 0.05;
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
pub(super) struct Quadratic<'a> {
    pub model: &'a mut LinearModel,
    pub smoother: &'a mut Smoother,
    /// Some: use a Riccati sweep instead of the smoother, if the weights are large enough.
    pub riccati: Option<&'a mut Riccati>,
    /// Jᵀ r.
    pub gradient: &'a [f64],
    pub damping: f64,
    pub is_rough: bool,
}

impl Quadratic<'_> {
    /// Minimises the cost with the squares of value + A Δ for the constraints to which `weighed` assigns
    /// (value, weight), and with the `pull` of each unknown. Unknowns without a pull stay. None: the budget
    /// was spent, or a number is not finite.
    fn minimise(
        &mut self,
        weighed: impl Fn(usize, f64) -> Option<(f64, f64)>,
        pull: impl Fn(usize) -> Option<Pull>,
        step: &mut [f64],
        budget: &mut Budget<'_>,
    ) -> Option<()> {
        let whole = |i: usize| pull(i).map(|pull| pull.with_own(self.model, i, self.damping));
        if let Some(riccati) = self.riccati.as_deref_mut()
            && riccati.solve(self.model, &weighed, whole, self.is_rough, step, budget)?
        {
            return Some(());
        }
        self.model.weigh_constraints(weighed, budget)?;
        let (model, damping) = (&*self.model, self.damping);
        let solved = self
            .smoother
            .solve_pulled(model, pull, damping, step, budget);
        solved.then_some(())
    }
}

/// Workspace.
#[derive(Debug, Clone)]
pub(super) struct InteriorPoint {
    lower: Vec<Pair>,
    upper: Vec<Pair>,
    constraints: Vec<Pair>,
    /// The step towards which an iteration goes.
    target: Vec<f64>,
    /// Change of each constraint by the iteration.
    changes: Vec<f64>,
}

/// Slack and multiplier (`force`) of a bound or constraint, with their changes in an iteration.
#[derive(Debug, Clone, Copy, Default)]
struct Pair {
    slack: f64,
    force: f64,
    slack_step: f64,
    force_step: f64,
}

impl Pair {
    fn new(slack: f64, force: f64) -> Self {
        Self {
            slack,
            force,
            ..Self::default()
        }
    }

    /// A soft constraint of this value: s - y equals the value.
    fn giving_way(value: f64, mu: f64) -> Self {
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

    fn product(&self) -> f64 {
        self.slack * self.force
    }

    /// Newton step for a bound of the box whose slack changes by `change`.
    fn follow(&mut self, change: f64, mu: f64) {
        self.slack_step = change;
        self.force_step = (mu - self.force * change) / self.slack - self.force;
    }

    /// Newton step for a soft constraint whose value changes by `change`.
    fn give_way(&mut self, change: f64, mu: f64) {
        self.force_step = (mu - self.product() - self.force * change) / (self.slack + self.force);
        self.slack_step = change + self.force_step;
    }

    /// The part of the step after which slack or multiplier is zero.
    fn part_max(&self) -> f64 {
        let part = |at: f64, step: f64| {
            if step < 0.0 {
                -at / step
            } else {
                f64::INFINITY
            }
        };
        part(self.slack, self.slack_step).min(part(self.force, self.force_step))
    }

    fn advance(&mut self, part: f64) {
        self.slack += part * self.slack_step;
        self.force += part * self.force_step;
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
        mut problem: Quadratic,
        trial: &mut Trial<P>,
        step: &mut [f64],
        budget: &mut Budget<'_>,
    ) -> Option<Found> {
        let (bounds, z) = (trial.bounds, trial.base);
        let mu_share = [MU_SHARE, MU_SHARE_ROUGH][usize::from(trial.is_rough)];
        let mu_end = self.begin(&mut problem, (bounds, z), mu_share, step, budget)?;
        let mut centring = 0.1;
        for iteration in 1..=ITERATIONS {
            let mu = centring * self.mean_product();
            let part = self.iterate(&mut problem, mu, step, budget)?;
            // Only a full step balances multipliers and gradient.
            if part > 0.99 && self.mean_product() <= mu_end {
                break;
            }
            if iteration > 1 && iteration.is_power_of_two() {
                let taken = trial.offer_to_contact(step, budget)?;
                if trial.is_rough && iteration >= ROUGH_ITERATIONS && taken == (true, true) {
                    return Some(Found::Tried);
                }
            }
            centring = if part > 0.9 { 0.05 } else { 1.0 - 0.9 * part };
        }
        let borders = bounds.lower().iter().zip(bounds.upper());
        for ((step, z), (lower, upper)) in step.iter_mut().zip(z).zip(borders) {
            *step = (z + *step).clamp(*lower, *upper) - z;
        }
        let is_finite = step.iter().all(|step| step.is_finite());
        is_finite.then_some(Found::Step)
    }

    /// Sets the start inside the box. Returns the final µ. None: the budget was spent.
    fn begin(
        &mut self,
        problem: &mut Quadratic,
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
        let pulled = MU_BEGIN * pull / count;
        let broken = (0..problem.model.constraints()).map(|i| problem.model.constraint(i).min(0.0));
        let broken: f64 = broken.map(|h| h * h).sum();
        let mu_end = (MU_END * problem.damping * square / count).max(mu_share * pulled);
        let mu = pulled.max(broken / count).max(mu_end);
        self.lower.clear();
        self.upper.clear();
        for ((step, z), (lower, upper)) in step.iter_mut().zip(z).zip(bounds) {
            let (lower, upper) = (lower - z, upper - z);
            let inside = INSIDE * (upper - lower);
            *step = if inside > 0.0 {
                0.0_f64.clamp(lower + inside, upper - inside)
            } else {
                lower
            };
            let border = |slack: f64| Pair::new(slack, mu / slack);
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
            .extend(values.map(|value| Pair::giving_way(value, mu)));
        Some(mu_end)
    }

    /// Whether an unknown can move.
    fn is_free(&self, i: usize) -> bool {
        self.lower[i].slack > 0.0 && self.upper[i].slack > 0.0
    }

    fn mean_product(&self) -> f64 {
        let free = (0..self.lower.len()).filter(|&i| self.is_free(i));
        let (mut sum, mut count) = (0.0, 0.0);
        for i in free {
            sum += self.lower[i].product() + self.upper[i].product();
            count += 2.0;
        }
        for constraint in &self.constraints {
            sum += constraint.product();
            count += 1.0;
        }
        sum / f64::max(count, 1.0)
    }

    /// One Newton step towards s y = µ. Returns the part taken. None: the budget was spent, or a number is
    /// not finite.
    fn iterate(
        &mut self,
        problem: &mut Quadratic,
        mu: f64,
        step: &mut [f64],
        budget: &mut Budget<'_>,
    ) -> Option<f64> {
        let least = NEGLIGIBLE * problem.damping;
        if !budget.spend(BORDER_NS / 2 * self.lower.len() as u32) {
            return None;
        }
        let weighed = |index: usize, h: f64| {
            let Pair { slack, force, .. } = self.constraints[index];
            let weight = force / (slack + force);
            (weight > least).then(|| (h - slack - mu / force, weight))
        };
        let mut target = core::mem::take(&mut self.target);
        target.clear();
        target.extend_from_slice(step);
        let pull = |i: usize| {
            let (lower, upper) = (&self.lower[i], &self.upper[i]);
            let weight = lower.force / lower.slack + upper.force / upper.slack;
            let force = weight * step[i] + mu / lower.slack - mu / upper.slack;
            self.is_free(i).then_some(Pull { weight, force })
        };
        let solved = problem.minimise(weighed, pull, &mut target, budget);
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
        let mut part = 1.0 / WAY;
        for i in 0..step.len() {
            if !budget.spend(2 * BORDER_NS) {
                return None;
            }
            if self.is_free(i) {
                self.lower[i].follow(self.target[i], mu);
                self.upper[i].follow(-self.target[i], mu);
                part = part
                    .min(self.lower[i].part_max())
                    .min(self.upper[i].part_max());
            }
        }
        for (constraint, change) in self.constraints.iter_mut().zip(&self.changes) {
            if !budget.spend(BORDER_NS) {
                return None;
            }
            constraint.give_way(*change, mu);
            part = part.min(constraint.part_max());
        }
        let part = WAY * part;
        for i in 0..step.len() {
            if self.is_free(i) {
                step[i] += part * self.target[i];
                self.lower[i].advance(part);
                self.upper[i].advance(part);
            }
        }
        for constraint in &mut self.constraints {
            constraint.advance(part);
        }
        Some(part)
    }
}
