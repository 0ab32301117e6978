//! Problems whose cost contains only the tip's position and the rates. Two steps at once in two lanes take as
//! long as one.

use super::TrackingProblem;
use crate::nmpc::motion::{Bends, VECTORS};
use crate::nmpc::pose_error::distance_squared;
use crate::optimizer::{Budget, Cost, Evaluation, LinearModel};
use crate::reference::Orientation;
use crate::robot::{COORDINATES_MAX, SectionParameters, TipSeries, tip_position_of, tip_slopes_of};
use crate::wide::{Aligned, Wide};

/// The bends at the end of two steps. After an odd number of steps the second lane is unused.
type Pair = [Wide<2>; COORDINATES_MAX];

/// An expression with the sections of a robot. Up to three are a constant number, of which the compiler makes straight
/// code instead of loops.
macro_rules! with_known_sections {
    ($sections:ident, $each:expr) => {
        match $sections.len() {
            1 => {
                let $sections = &$sections[..1];
                $each
            }
            2 => {
                let $sections = &$sections[..2];
                $each
            }
            3 => {
                let $sections = &$sections[..3];
                $each
            }
            _ => $each,
        }
    };
}

/// A plain problem in bend vectors whose plans all stay near the start: the usual search problem of the
/// swarm.
pub(in crate::nmpc) struct PositionOnly<'a> {
    problem: &'a TrackingProblem<'a>,
    tip_series: TipSeries,
    step_ns: u32,
}

impl<'a> PositionOnly<'a> {
    pub(in crate::nmpc) fn new(problem: &'a TrackingProblem<'a>) -> Option<Self> {
        if !(problem.is_free() && problem.follows_positions) {
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

    /// Whether the cost without obstacles and limits contains only the tip's position and the rates.
    pub(super) fn allows_position_only(&self) -> bool {
        self.settings.rate_change_weight == 0.0 && self.follows_positions
    }

    /// Whether no orientation has a weight.
    pub(super) fn has_no_orientation_weight(&self) -> bool {
        (0..self.steps()).all(|step| {
            let target = self.target(step).map(|target| target.orientation);
            matches!(target, None | Some(Orientation::Free))
                || self.weights(step).orientation == 0.0
        })
    }

    /// Whether the cost contains only the tip's position and the rates.
    pub(in crate::nmpc) fn is_position_only(&self) -> bool {
        self.has_position_only_cost && self.is_free()
    }

    /// The cost of one plan, or the step in which the budget ended. Also writes the position residuals, up to the
    /// length of `residuals`.
    pub(super) fn position_residuals<const P: usize>(
        &self,
        z: &[f64],
        residuals: &mut [f64],
        budget: &mut Budget<'_>,
    ) -> Result<Evaluation<1>, usize> {
        let sections = self.robot.sections();
        with_known_sections!(
            sections,
            self.position_residuals_of::<P>(sections, z, residuals, budget)
        )
    }

    #[inline(always)]
    fn position_residuals_of<const P: usize>(
        &self,
        sections: &[SectionParameters],
        z: &[f64],
        residuals: &mut [f64],
        budget: &mut Budget<'_>,
    ) -> Result<Evaluation<1>, usize> {
        let mut bends: Bends<1, P> = self.motion.start_of(2 * sections.len());
        let (mut cost, mut rows) = (self.regularisation_at(z), residuals.chunks_exact_mut(3));
        let (step_ns, steps) = (self.step_ns(), self.steps());
        let mut first = 0;
        while first < steps {
            for step in first..steps.min(first + 2) {
                if !budget.spend(step_ns) {
                    return Err(step);
                }
            }
            let pair = self.advance_pair(sections.len(), &mut bends, z, first);
            let tips = tip_position_of(sections, |i| pair[i]);
            for lane in 0..2 {
                let Some((error, weight)) = self.error(first, lane, &tips) else {
                    continue;
                };
                let [x, y, z] = error;
                cost += (x * x + y * y + z * z) * weight;
                if let Some(row) = rows.next() {
                    let scale = weight.sqrt();
                    row.copy_from_slice(&error.map(|error| scale * error));
                }
            }
            first += 2;
        }
        Ok(Evaluation::from_cost(Wide([cost])))
    }

    /// Adds the residuals and their derivatives with respect to bend vectors. False: the budget was spent.
    pub(super) fn push_position_rows(
        &self,
        z: &[f64],
        model: &mut LinearModel,
        budget: &mut Budget<'_>,
    ) -> bool {
        let sections = self.robot.sections();
        let is_left = with_known_sections!(
            sections,
            self.push_position_rows_of(sections, z, model, budget)
        );
        self.push_regularisation_rows(z, model);
        is_left
    }

    #[inline(always)]
    fn push_position_rows_of(
        &self,
        sections: &[SectionParameters],
        z: &[f64],
        model: &mut LinearModel,
        budget: &mut Budget<'_>,
    ) -> bool {
        let width = 2 * sections.len();
        let mut bends: Bends<1, VECTORS> = self.motion.start_of(width);
        let mut slopes = [[Wide([0.0; 2]); 3]; COORDINATES_MAX];
        let (mut row_stages, steps) = (self.row_stages(), self.steps());
        let mut first = 0;
        while first < steps {
            for step in first..steps.min(first + 2) {
                if !budget.spend(self.linearise_step_ns(step)) {
                    return false;
                }
            }
            let pair = self.advance_pair(sections.len(), &mut bends, z, first);
            let tips = tip_slopes_of(sections, |i| pair[i], &mut slopes);
            for (lane, stage) in row_stages.by_ref().take(2).enumerate() {
                let Some((error, weight)) = self.error(first, lane, &tips) else {
                    continue;
                };
                let scale = weight.sqrt();
                for axis in 0..3 {
                    let mut derivatives = [0.0; COORDINATES_MAX];
                    let derivatives = &mut derivatives[..width];
                    for (derivative, slope) in derivatives.iter_mut().zip(&slopes) {
                        *derivative = scale * slope[axis].0[lane];
                    }
                    model.push_known(scale * error[axis], derivatives, stage);
                }
            }
            first += 2;
        }
        true
    }

    /// The bends at the end of step `first` and of the next one, to which it advances.
    #[inline(always)]
    fn advance_pair<const P: usize>(
        &self,
        sections: usize,
        bends: &mut Bends<1, P>,
        z: &[f64],
        first: usize,
    ) -> Pair {
        let (width, control) = (2 * sections, |i: usize| Wide([z[i]]));
        self.motion.advance_of(width, bends, &control, first);
        let before = bends.bend_rad;
        if first + 1 < self.steps() {
            self.motion.advance_of(width, bends, &control, first + 1);
        }
        // Both lanes at once: a register is slow to load what was stored in halves.
        let mut pair = [Wide([0.0; 2]); COORDINATES_MAX];
        for i in 0..width {
            pair[i] = Wide([before[i].0[0], bends.bend_rad[i].0[0]]);
        }
        pair
    }

    /// The error at the end of the step in a lane, where lane 0 holds the step `first`, and the weight of its square.
    /// None: no such step, or no reference.
    #[inline(always)]
    fn error(&self, first: usize, lane: usize, tips: &[Wide<2>; 3]) -> Option<([f64; 3], f64)> {
        let step = first + lane;
        if step >= self.steps() {
            return None;
        }
        let target = self.target(step)?;
        let error = [0, 1, 2].map(|axis| tips[axis].0[lane] - target.position_m[axis]);
        Some((error, self.weights(step).position))
    }
}
