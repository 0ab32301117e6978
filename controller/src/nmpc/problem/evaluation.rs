//! Cost of plans.

use pulp::NullaryFnOnce;

use super::{SECTION_NS, TrackingProblem};
use crate::nmpc::motion::{ANGLES, Bends, VECTORS};
use crate::nmpc::pose_error;
use crate::nmpc::{Coordinates, NmpcSettings};
use crate::optimizer::{Budget, Cost, Evaluation, Incumbent, Problem, QUANTUM_NS, run_outlined};
use crate::robot::{COORDINATES_MAX, TipSeries};
use crate::wide::{Aligned, Wide, all};

impl TrackingProblem<'_> {
    /// Eq. 5 for W plans at once, in the coordinates selected by P. Stops early when all of them are known to
    /// cost more than `cost_cutoff`.
    #[inline(always)]
    pub(super) fn evaluate_in<'a, const W: usize, const P: usize>(
        &'a self,
        z: &impl Fn(usize) -> Wide<W>,
        tip_series: Option<&'a TipSeries>,
        cost_cutoff: f64,
        budget: &mut Budget<'_>,
        instructions: impl pulp::Simd,
    ) -> Option<Evaluation<W>> {
        let mut rollout = Rollout::<W, P>::new(self, z);
        rollout.tip_series = tip_series;
        for step in 0..self.steps() {
            rollout.advance(step, z, budget, instructions)?;
            if rollout.exceeds_cutoff(cost_cutoff) {
                break;
            }
        }
        Some(rollout.evaluation)
    }

    /// Cost of the first `steps` steps of a plan. None: the budget was spent.
    pub(in crate::nmpc) fn evaluate_first(
        &self,
        steps: usize,
        z: &[f64],
        budget: &mut Budget<'_>,
    ) -> Option<f64> {
        match self.motion.coordinates() {
            Coordinates::BendVector => self.first_in::<VECTORS>(steps, z, budget),
            Coordinates::BendAngles => self.first_in::<ANGLES>(steps, z, budget),
        }
    }

    fn first_in<const P: usize>(
        &self,
        steps: usize,
        z: &[f64],
        budget: &mut Budget<'_>,
    ) -> Option<f64> {
        let rates = |i: usize| Wide([z[i]]);
        let mut rollout = Rollout::<1, P>::new(self, &rates);
        for step in 0..steps {
            rollout.advance(step, &rates, budget, pulp::Scalar)?;
        }
        Some(rollout.evaluation.cost.0[0])
    }

    /// Eq. 5 for one plan, and whether the plan is unchanged. It is cut at the block that would increase a
    /// constraint violation above the incumbent's, or in which the budget ends. The rates from that block on
    /// become zero, or the nearest values in the box.
    pub(super) fn evaluate_until_violation_in<const P: usize>(
        &self,
        z: &mut [f64],
        incumbent: &Incumbent,
        residuals: &mut [f64],
        budget: &mut Budget<'_>,
    ) -> Option<(Evaluation<1>, bool)> {
        if self.is_position_only() {
            return match self.position_residuals::<P>(z, residuals, budget) {
                Ok(evaluation) => Some((evaluation, true)),
                Err(step) => {
                    let first = self.rest_from(self.motion.horizon().block_of(step), z);
                    let nothing = Evaluation::from_cost(Wide([0.0]));
                    let evaluation = self.evaluate_at_rest::<P>(z, first, &nothing)?;
                    Some((evaluation, false))
                }
            };
        }
        let (cost_cutoff, allowed) = (incumbent.cost(), incumbent.violations());
        let mut rollout = Rollout::<1, P>::new(self, &|i: usize| Wide([z[i]]));
        let mut block_begin = (0, rollout);
        let (mut step, mut is_whole) = (0, true);
        while step < self.steps() && !rollout.exceeds_cutoff(cost_cutoff) {
            let block = self.motion.horizon().block_of(step);
            if block != self.motion.horizon().block_of(block_begin.0) {
                block_begin = (step, rollout);
            }
            let rates = |i: usize| Wide([z[i]]);
            let is_left = rollout.advance(step, &rates, budget, pulp::Scalar);
            step += 1;
            let mut violations = rollout.evaluation.violations.iter().zip(allowed);
            let breaks = is_whole && violations.any(|(now, allowed)| now.0[0] > allowed);
            if breaks || is_left.is_none() {
                is_whole = false;
                (step, rollout) = block_begin;
                let first = self.rest_from(block, z);
                if is_left.is_none() {
                    let evaluation = self.evaluate_at_rest::<P>(z, first, &rollout.evaluation)?;
                    return Some((evaluation, false));
                }
            }
        }
        if !is_whole && self.is_regularised() {
            rollout.evaluation = self.evaluate_below(z, cost_cutoff, budget)?;
        }
        Some((rollout.evaluation, is_whole))
    }

    /// Sets the rates from a block on to zero, or to the nearest values in the box. Returns the first of them.
    fn rest_from(&self, block: usize, z: &mut [f64]) -> usize {
        let first = block * self.width();
        z[first..].fill(0.0);
        self.bounds.project(z);
        first
    }

    /// Cost of a plan with zero rates from unknown `first` on, after the budget ended its evaluation. If no
    /// constraint was violated `until` then and all obstacles rest, none is violated later. None otherwise,
    /// or if the evaluation takes more than a quantum.
    fn evaluate_at_rest<const P: usize>(
        &self,
        z: &[f64],
        first: usize,
        until: &Evaluation<1>,
    ) -> Option<Evaluation<1>> {
        let holds = until.violations.iter().all(|kind| kind.0[0] == 0.0);
        let rests = first > 0 && z[first..].iter().all(|rate| *rate == 0.0);
        let is_short = self.sections_ns(SECTION_NS) * self.steps() as u32 <= QUANTUM_NS;
        if !(holds && rests && is_short && self.obstacles.all_at_rest()) {
            return None;
        }
        let rates = |i: usize| Wide([z[i]]);
        let mut rollout = Rollout::<1, P>::new(self, &rates);
        rollout.is_free = true;
        for step in 0..self.steps() {
            rollout.advance(step, &rates, &mut Budget::unlimited(), pulp::Scalar)?;
        }
        Some(rollout.evaluation)
    }

    /// Whether the rates or their change have a weight.
    pub(in crate::nmpc) fn is_regularised(&self) -> bool {
        f64::from(self.settings.rate_weight) > 0.0 || self.settings.rate_change_weight > 0.0
    }

    /// Cost of the rates of one plan, as their distance from those of the posture, and of their change.
    pub(in crate::nmpc) fn regularisation_at(&self, z: &[f64]) -> f64 {
        self.regularisation(&|i: usize| Wide([z[i]])).0[0]
    }

    /// Cost of the rates, as their distance from those of the posture, and of their change from block to block.
    #[inline(always)]
    pub(super) fn regularisation<const W: usize>(&self, z: &impl Fn(usize) -> Wide<W>) -> Wide<W> {
        let NmpcSettings {
            rate_weight,
            rate_change_weight,
            ..
        } = *self.settings;
        let rate_weight = f64::from(rate_weight);
        let mut cost = Wide::splat(0.0);
        if rate_weight > 0.0 {
            for block in 0..self.stages.blocks() {
                let first = block * self.width();
                for (i, posture) in self.posture[..self.width()].iter().enumerate() {
                    let apart = z(first + i) - *posture;
                    cost = cost + apart * apart * rate_weight;
                }
            }
        }
        if rate_change_weight > 0.0 {
            for i in 0..self.dimension() {
                let earlier = i.checked_sub(self.width());
                let before = earlier.map_or_else(|| Wide::splat(self.previous[i]), z);
                let change = z(i) - before;
                cost = cost + change * change * rate_change_weight;
            }
        }
        cost
    }
}

/// The problem in the coordinates selected by P.
pub(in crate::nmpc) struct SwarmCost<'a, const P: usize> {
    problem: &'a TrackingProblem<'a>,
    tip_series: Option<TipSeries>,
}

impl<'a, const P: usize> SwarmCost<'a, P> {
    pub(in crate::nmpc) fn new(problem: &'a TrackingProblem<'a>) -> Self {
        let tip_series = problem.tip_series();
        Self {
            problem,
            tip_series,
        }
    }
}

impl<const P: usize> Cost for SwarmCost<'_, P> {
    #[inline(always)]
    fn evaluate<const W: usize>(
        &self,
        z: impl Fn(usize) -> Wide<W>,
        _: &mut [Aligned<W>],
        budget: &mut Budget<'_>,
        instructions: impl pulp::Simd,
    ) -> Option<Evaluation<W>> {
        let (tip_series, cost_cutoff) = (self.tip_series.as_ref(), f64::INFINITY);
        self.problem
            .evaluate_in::<W, P>(&z, tip_series, cost_cutoff, budget, instructions)
    }
}

/// W rollouts and their cost so far.
#[derive(Clone, Copy)]
struct Rollout<'a, const W: usize, const P: usize> {
    problem: &'a TrackingProblem<'a>,
    bends: Bends<W, P>,
    evaluation: Evaluation<W>,
    /// Set if all plans stay near the start.
    tip_series: Option<&'a TipSeries>,
    // Constant over the horizon.
    step_ns: u32,
    is_free: bool,
}

impl<'a, const W: usize, const P: usize> Rollout<'a, W, P> {
    #[inline(always)]
    fn new(problem: &'a TrackingProblem<'_>, z: &impl Fn(usize) -> Wide<W>) -> Self {
        Self {
            problem,
            bends: problem.motion.start(),
            evaluation: Evaluation::from_cost(problem.regularisation(z)),
            tip_series: None,
            step_ns: problem.step_ns(),
            is_free: problem.is_free(),
        }
    }

    /// Advances by one step. None: the budget was spent.
    #[inline(always)]
    fn advance(
        &mut self,
        step: usize,
        z: &impl Fn(usize) -> Wide<W>,
        budget: &mut Budget<'_>,
        instructions: impl pulp::Simd,
    ) -> Option<()> {
        if !budget.spend(self.step_ns) {
            return None;
        }
        let problem = self.problem;
        // Avoids a copy that nothing compares with; `then_some` may copy all the same.
        let before = if self.is_free {
            None
        } else {
            Some(self.bends.bend_rad)
        };
        problem.motion.advance(&mut self.bends, z, step);
        if let Some(target) = problem.target(step) {
            let bend_rad = |i: usize| self.bends.bend_rad[i];
            let weights = problem.weights(step);
            let error = pose_error::squared_error(
                problem.robot,
                bend_rad,
                self.tip_series,
                target,
                &weights,
            );
            self.evaluation.cost = self.evaluation.cost + error;
        }
        if let Some(before) = before {
            let penalties = Penalties {
                problem,
                step,
                before: &before,
                after: &self.bends.bend_rad,
                evaluation: &mut self.evaluation,
                budget,
            };
            run_outlined(instructions, penalties)?;
        }
        Some(())
    }

    /// Whether all plans are known to cost more than `cost_cutoff`: no term is negative, so the cost only grows.
    #[inline(always)]
    fn exceeds_cutoff(&self, cost_cutoff: f64) -> bool {
        let cost = self.evaluation.cost;
        !self.is_free && cost_cutoff < f64::INFINITY && all(Wide::splat(cost_cutoff).less(cost))
    }
}

/// Penalties of limits and obstacles in the cost of W plans at the end of a step. None: the budget was spent.
///
/// A separate function, because compile time grows faster than the size of a function, and this is most of
/// the code (docs/decisions/0011-build.md).
struct Penalties<'a, 'b, const W: usize> {
    problem: &'a TrackingProblem<'a>,
    step: usize,
    before: &'a [Wide<W>; COORDINATES_MAX],
    after: &'a [Wide<W>; COORDINATES_MAX],
    evaluation: &'a mut Evaluation<W>,
    budget: &'a mut Budget<'b>,
}

impl<const W: usize> NullaryFnOnce for Penalties<'_, '_, W> {
    type Output = Option<()>;

    #[inline(always)]
    fn call(self) -> Option<()> {
        let problem = self.problem;
        if problem.limits.any_reachable() {
            problem
                .limits
                .add_penalties(self.before, self.after, self.evaluation);
        }
        if problem.obstacles.any_reachable() {
            problem.obstacles.add_penalties(
                problem.robot,
                problem.settings,
                problem.step_time(self.step),
                self.after,
                self.evaluation,
                self.budget,
            )?;
        }
        Some(())
    }
}
