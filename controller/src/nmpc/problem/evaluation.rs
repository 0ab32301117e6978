//! What plans cost.

use pulp::NullaryFnOnce;

use super::TrackingProblem;
use crate::nmpc::NmpcSettings;
use crate::nmpc::motion::Bends;
use crate::nmpc::pose_error;
use crate::optimizer::{Budget, Evaluation, Incumbent, Problem, apart};
use crate::robot::COORDINATES_MAX;
use crate::wide::{Wide, all};

impl TrackingProblem<'_> {
    /// Eq. 5 for W plans side by side, in the coordinates that P stands for; as far as it takes to know that all cost more than `enough`.
    #[inline(always)]
    pub(super) fn evaluate_in<const W: usize, const P: usize>(
        &self,
        z: &impl Fn(usize) -> Wide<W>,
        enough: f64,
        budget: &mut Budget<'_>,
        instructions: impl pulp::Simd,
    ) -> Option<Evaluation<W>> {
        let mut bends: Bends<W, P> = self.motion.start();
        let mut evaluation = Evaluation::from_cost(self.regularisation(z));
        for step in 0..self.steps() {
            self.add_step(step, z, (&mut bends, &mut evaluation), budget, instructions)?;
            if self.is_enough(&evaluation, enough) {
                break;
            }
        }
        Some(evaluation)
    }

    /// The same for one plan, and whether it stays as it is: from the block on in which it would break a constraint by more than the incumbent does,
    /// its rates become zero, or what is nearest to that in the box.
    pub(super) fn to_contact_in<const P: usize>(
        &self,
        z: &mut [f64],
        incumbent: &Incumbent,
        budget: &mut Budget<'_>,
    ) -> Option<(Evaluation<1>, bool)> {
        let (enough, allowed) = (incumbent.cost(), incumbent.violations());
        let mut evaluation = Evaluation::from_cost(self.regularisation(&|i: usize| Wide([z[i]])));
        let mut bends: Bends<1, P> = self.motion.start();
        let mut block_begin = (0, bends, evaluation);
        let (mut step, mut is_whole) = (0, true);
        while step < self.steps() && !self.is_enough(&evaluation, enough) {
            let block = self.motion.horizon().block_of(step);
            if block != self.motion.horizon().block_of(block_begin.0) {
                block_begin = (step, bends, evaluation);
            }
            let rates = |i: usize| Wide([z[i]]);
            self.add_step(
                step,
                &rates,
                (&mut bends, &mut evaluation),
                budget,
                pulp::Scalar,
            )?;
            step += 1;
            let mut violations = evaluation.violations.iter().zip(allowed);
            if is_whole && violations.any(|(now, allowed)| now.0[0] > allowed) {
                is_whole = false;
                (step, bends, evaluation) = block_begin;
                let first = block * self.width();
                z[first..].fill(0.0);
                self.bounds.project(z);
            }
        }
        if !is_whole && self.is_regularised() {
            evaluation = self.evaluate_below(z, enough, budget)?;
        }
        Some((evaluation, is_whole))
    }

    /// Whether all of W plans are known to cost more than `enough`: no term is negative.
    #[inline(always)]
    fn is_enough<const W: usize>(&self, evaluation: &Evaluation<W>, enough: f64) -> bool {
        !self.is_free() && enough < f64::INFINITY && all(Wide::splat(enough).less(evaluation.cost))
    }

    /// Adds what one step costs to the cost of W plans. None: the budget was spent.
    #[inline(always)]
    fn add_step<const W: usize, const P: usize>(
        &self,
        step: usize,
        z: &impl Fn(usize) -> Wide<W>,
        (bends, evaluation): (&mut Bends<W, P>, &mut Evaluation<W>),
        budget: &mut Budget<'_>,
        instructions: impl pulp::Simd,
    ) -> Option<()> {
        if !budget.spend(self.step_ns()) {
            return None;
        }
        // Nothing is copied where nobody compares with it.
        let before = (!self.is_free()).then_some(bends.bend_rad);
        self.motion.advance(bends, z, step);
        if let Some(target) = self.target(step) {
            let bend_rad = |i: usize| bends.bend_rad[i];
            let weights = self.weights(step);
            let error = pose_error::squared_error(self.robot, bend_rad, target, &weights);
            evaluation.cost = evaluation.cost + error;
        }
        if let Some(before) = before {
            let penalties = Penalties {
                problem: self,
                step,
                before: &before,
                after: &bends.bend_rad,
                evaluation,
                budget,
            };
            apart(instructions, penalties)?;
        }
        Some(())
    }

    /// Whether rates or their change have a weight.
    fn is_regularised(&self) -> bool {
        f64::from(self.settings.rate_weight) > 0.0 || self.settings.rate_change_weight > 0.0
    }

    /// Weights on the rates and on their change from block to block.
    #[inline(always)]
    fn regularisation<const W: usize>(&self, z: &impl Fn(usize) -> Wide<W>) -> Wide<W> {
        let NmpcSettings {
            rate_weight,
            rate_change_weight,
            ..
        } = *self.settings;
        let rate_weight = f64::from(rate_weight);
        let mut cost = Wide::splat(0.0);
        if rate_weight > 0.0 {
            for i in 0..self.dimension() {
                cost = cost + z(i) * z(i) * rate_weight;
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

/// What limits and obstacles add to the cost of W plans at the end of a step. None: the budget was spent.
///
/// A function of its own, because the compiler's time grows faster than a function, and this is most of the code
/// (docs/decisions/0011-build.md).
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
        if problem.limits.matter() {
            problem
                .limits
                .add_penalties(self.before, self.after, self.evaluation);
        }
        if problem.obstacles.matter() {
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
