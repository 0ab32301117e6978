//! Problems whose cost contains only the tip's position and the rates. Two steps at once in two lanes take as
//! long as one.

use core::ops::Range;

use super::TrackingProblem;
use crate::nmpc::motion::{Bends, VECTORS};
use crate::nmpc::pose_error::distance_squared;
use crate::optimizer::{Budget, Cost, Evaluation, LinearModel, Problem, RowStage};
use crate::reference::Orientation;
use crate::robot::{COORDINATES_MAX, TipSeries};
use crate::wide::{Aligned, Wide};

/// The bends at the end of two steps. After an odd number of steps the second lane is unused.
type Pair = [Wide<2>; COORDINATES_MAX];

/// A plain problem in bend vectors whose plans all stay near the start: the usual search problem of the
/// swarm.
pub(in crate::nmpc) struct PositionOnly<'a> {
    problem: &'a TrackingProblem<'a>,
    tip_series: TipSeries,
    step_ns: u32,
}

impl<'a> PositionOnly<'a> {
    pub(in crate::nmpc) fn new(problem: &'a TrackingProblem<'a>) -> Option<Self> {
        if !(problem.is_free() && problem.follows_positions()) {
            return None;
        }
        Some(Self {
            problem,
            tip_series: problem.tip_series()?,
            step_ns: problem.step_ns(),
        })
    }
}

impl Cost for PositionOnly<'_> {
    #[inline(always)]
    fn evaluate<const W: usize>(
        &self,
        z: impl Fn(usize) -> Wide<W>,
        bends: &mut [Aligned<W>],
        budget: &mut Budget<'_>,
        _instructions: impl pulp::Simd,
    ) -> Option<Evaluation<W>> {
        let Self {
            problem,
            tip_series,
            ..
        } = self;
        problem.motion.start_in(bends);
        let mut cost = problem.regularisation(&z);
        for step in 0..problem.steps() {
            if !budget.spend(self.step_ns) {
                return None;
            }
            let advance_component = problem.motion.advance_component(bends, &z, step);
            let tip = problem
                .robot
                .tip_position_by_series(tip_series, advance_component);
            if let Some(target) = problem.target(step) {
                let error = distance_squared(&tip, &target.position_m);
                cost = cost + error * problem.weights(step).position;
            }
        }
        Some(Evaluation::from_cost(cost))
    }
}

impl TrackingProblem<'_> {
    /// The approximation for bends near the start, if all plans stay near it.
    pub(super) fn tip_series(&self) -> Option<TipSeries> {
        let bend_change_max_rad = self.motion.bend_change_max_rad(self.robot);
        self.robot
            .tip_series(&self.motion.start_shape(), &bend_change_max_rad)
    }

    /// Whether the cost without obstacles and limits contains only the tip's position and the rates, and the
    /// rows are not staged.
    pub(super) fn allows_position_only(&self) -> bool {
        !self.is_staged() && self.settings.rate_change_weight == 0.0 && self.follows_positions()
    }

    /// Whether no orientation has a weight.
    pub(super) fn follows_positions(&self) -> bool {
        (0..self.steps()).all(|step| {
            let target = self.target(step).map(|target| target.orientation);
            matches!(target, None | Some(Orientation::Free))
                || self.weights(step).orientation == 0.0
        })
    }

    /// Whether the cost contains only the tip's position and the rates, and the rows are not staged.
    pub(in crate::nmpc) fn is_position_only(&self) -> bool {
        self.has_position_only_cost && self.is_free()
    }

    /// The cost of one plan. Also writes the position residuals, up to the length of `residuals`.
    pub(super) fn position_residuals<const P: usize>(
        &self,
        z: &[f64],
        residuals: &mut [f64],
        budget: &mut Budget<'_>,
    ) -> Option<Evaluation<1>> {
        let mut bends: Bends<1, P> = self.motion.start();
        let mut pair = [Wide([0.0; 2]); COORDINATES_MAX];
        let (control, step_ns) = (|i: usize| Wide([z[i]]), self.step_ns());
        let (mut cost, mut rows) = (self.regularisation_at(z), residuals.chunks_exact_mut(3));
        let (mut first, steps) = (0, self.steps());
        while first < steps {
            let end = steps.min(first + 2);
            for step in first..end {
                if !budget.spend(step_ns) {
                    return None;
                }
                self.motion.advance(&mut bends, &control, step);
                put(&mut pair[..self.width()], step - first, &bends.bend_rad);
            }
            let tips = self.robot.tip_position_wide(|i| pair[i]);
            for step in first..end {
                let Some((error, weight)) = self.error(step, first, &tips) else {
                    continue;
                };
                let [x, y, z] = error;
                cost += (x * x + y * y + z * z) * weight;
                let scale = weight.sqrt();
                if let Some(row) = rows.next() {
                    row.copy_from_slice(&error.map(|error| scale * error));
                }
            }
            first = end;
        }
        Some(Evaluation::from_cost(Wide([cost])))
    }

    /// Adds the residuals and their derivatives with respect to bend vectors. False: the budget was spent.
    pub(super) fn push_position_rows(
        &self,
        z: &[f64],
        model: &mut LinearModel,
        budget: &mut Budget<'_>,
    ) -> bool {
        let mut pair = [Wide([0.0; 2]); COORDINATES_MAX];
        let mut row_stages = [RowStage::FIRST_BLOCK; 2];
        let mut bends: Bends<1, VECTORS> = self.motion.start();
        let control = |i: usize| Wide([z[i]]);
        let is_left = self.row_stages().enumerate().all(|(step, stage)| {
            if !budget.spend(self.linearise_step_ns(step)) {
                return false;
            }
            let (lane, end) = (step % 2, step + 1);
            self.motion.advance(&mut bends, &control, step);
            put(&mut pair[..self.width()], lane, &bends.bend_rad);
            row_stages[lane] = stage;
            if lane == 1 || end == self.steps() {
                self.push_pair(step - lane..end, &pair, row_stages, model);
            }
            true
        });
        self.push_regularisation_rows(z, model);
        is_left
    }

    fn push_pair(
        &self,
        steps: Range<usize>,
        pair: &Pair,
        row_stages: [RowStage; 2],
        model: &mut LinearModel,
    ) {
        let (tips, slopes) = self.robot.tip_slopes_wide(|i| pair[i]);
        let first = steps.start;
        for step in steps {
            let Some((error, weight)) = self.error(step, first, &tips) else {
                continue;
            };
            let scale = weight.sqrt();
            let stage = row_stages[step - first];
            for axis in 0..3 {
                let mut derivatives = [0.0; COORDINATES_MAX];
                let derivatives = &mut derivatives[..self.width()];
                for (derivative, slope) in derivatives.iter_mut().zip(&slopes) {
                    *derivative = scale * slope[axis].0[step - first];
                }
                model.push(scale * error[axis], derivatives, stage);
            }
        }
    }

    /// The error after `step`, where lane 0 holds the step `first`, and the weight of its square. None: no
    /// reference.
    fn error(&self, step: usize, first: usize, tips: &[Wide<2>; 3]) -> Option<([f64; 3], f64)> {
        let target = self.target(step)?;
        let error = [0, 1, 2].map(|axis| tips[axis].0[step - first] - target.position_m[axis]);
        Some((error, self.weights(step).position))
    }
}

fn put(pair: &mut [Wide<2>], lane: usize, bends: &[Wide<1>; COORDINATES_MAX]) {
    for (both, bend) in pair.iter_mut().zip(bends) {
        both.0[lane] = bend.0[0];
    }
}
