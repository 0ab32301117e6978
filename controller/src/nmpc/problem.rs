mod evaluation;
mod position_only;

pub(super) use evaluation::SwarmCost;
pub(super) use position_only::PositionOnly;

use super::limits::{LIMITS, LimitRow, PlanLimits};
use super::motion::{ANGLES, Bent, Motion, VECTORS};
use super::obstacles::{CLEARANCE, ClearanceRow, Obstacles, StepTime};
use super::pose_error::{self, PoseWeights, ResidualRow};
use super::posture::posture_controls;
use super::{Coordinates, NmpcSettings};
use crate::optimizer::{
    Bounds, Budget, Evaluation, Incumbent, LinearModel, Problem, Reach, RowStage, Stages, WIDTH_MAX,
};
use crate::reference::{Orientation, ReferenceSample, ReferenceState};
use crate::robot::{BendRates, COORDINATES_MAX, Configuration, Jacobian, Robot, SECTIONS_MAX};
use crate::wide::Wide;

/// The optimal control problem of one cycle: Eq. 4-5 over the horizon, in the controls of every block.
pub(super) struct TrackingProblem<'a> {
    pub robot: &'a Robot,
    pub motion: &'a Motion<'a>,
    /// Controls equivalent to the last command.
    pub previous: [f64; COORDINATES_MAX],
    /// Controls of each block from which the rates are weighted.
    posture: [f64; COORDINATES_MAX],
    settings: &'a NmpcSettings,
    limits: &'a PlanLimits<'a>,
    obstacles: &'a Obstacles,
    bounds: &'a Bounds,
    reference: &'a [ReferenceSample],
    stages: Stages,
    /// Whether no orientation has a weight.
    follows_positions: bool,
    /// Whether reference and settings allow [`Self::is_position_only`].
    has_position_only_cost: bool,
}

const _: () = assert!(COORDINATES_MAX <= WIDTH_MAX);
/// Smallest number of blocks for staged rows; with fewer, one dense matrix is faster (`cdcr-bench solver`).
const STAGED_BLOCKS_MIN: usize = 4;
/// Nominal time of one section for W plans at once \[ns\].
const SECTION_NS: u32 = 15;
/// Nominal time of the limits of one section for W plans at once \[ns\].
const LIMITS_NS: u32 = 20;
/// Nominal time of one row of a linear model, per unknown \[ns\].
const ROW_NS: u32 = 1;
/// Additional nominal time of one constraint \[ns\].
const CONSTRAINT_NS: u32 = 30;

impl<'a> TrackingProblem<'a> {
    pub(super) fn new(
        robot: &'a Robot,
        settings: &'a NmpcSettings,
        motion: &'a Motion<'a>,
        limits: &'a PlanLimits<'a>,
        obstacles: &'a Obstacles,
        bounds: &'a Bounds,
        (previous_rates, reference): (&BendRates, &'a [ReferenceSample]),
    ) -> Self {
        let mut previous = [0.0; COORDINATES_MAX];
        let held = previous_rates.as_slice();
        motion.controls_of(held, &mut previous[..held.len()]);
        let mut problem = Self {
            robot,
            motion,
            previous,
            posture: posture_controls(robot, settings, motion, reference),
            settings,
            limits,
            obstacles,
            bounds,
            reference,
            stages: Stages::new(
                motion.width(),
                motion.period_s(),
                motion.horizon().lengths(),
            ),
            follows_positions: false,
            has_position_only_cost: false,
        };
        problem.follows_positions = problem.has_no_orientation_weight();
        problem.has_position_only_cost = problem.allows_position_only();
        problem
    }

    /// Whether there is a reference to follow.
    pub(super) fn has_reference(&self) -> bool {
        self.reference
            .iter()
            .any(|sample| sample.state != ReferenceState::None)
    }

    /// The same problem with other obstacles.
    pub(super) fn with_obstacles(&self, obstacles: &'a Obstacles) -> Self {
        Self { obstacles, ..*self }
    }

    /// Whether an obstacle is within reach.
    pub(super) fn has_reachable_obstacles(&self) -> bool {
        self.obstacles.any_reachable()
    }

    pub(super) fn reachable_obstacles(&self) -> u32 {
        self.obstacles.count()
    }

    /// Whether no obstacle and no limit is within reach.
    pub(super) fn is_free(&self) -> bool {
        !self.limits.any_reachable() && !self.obstacles.any_reachable()
    }

    fn width(&self) -> usize {
        self.motion.width()
    }

    /// Whether each step has separate rates.
    pub(super) fn has_step_rates(&self) -> bool {
        self.stages.blocks() == self.steps()
    }

    pub(super) fn steps(&self) -> usize {
        self.motion.horizon().steps()
    }

    /// Reference after step `step` (0-based); past the end of the reference its last sample.
    #[inline(always)]
    pub(super) fn target(&self, step: usize) -> Option<&ReferenceSample> {
        let sample = self.reference.get(step).or(self.reference.last())?;
        (sample.state != ReferenceState::None).then_some(sample)
    }

    /// Weights of the error after step `step`; the factor ω applies to the last step.
    #[inline(always)]
    pub(super) fn weights(&self, step: usize) -> PoseWeights {
        let last = step + 1 == self.steps();
        let factor = if last {
            self.settings.terminal_weight
        } else {
            1.0
        };
        PoseWeights {
            position: factor * self.settings.position_weight,
            orientation: factor * self.settings.orientation_weight,
            tolerance_rad: self.settings.orientation_tolerance_rad,
        }
    }

    /// The end of `step`.
    #[inline(always)]
    fn step_time(&self, step: usize) -> StepTime {
        StepTime {
            step,
            time_s: self.motion.period_s() * (step + 1) as f64,
        }
    }

    /// Cost of a position error at every step by the rounding of the tip's position.
    fn rounding_cost(&self) -> f64 {
        let lengths_m = self.robot.sections().iter().map(|section| section.length_m);
        let rounding_m = f64::EPSILON * lengths_m.sum::<f64>();
        let weights = (0..self.steps()).map(|step| self.weights(step).position);
        weights.sum::<f64>() * rounding_m * rounding_m
    }

    fn push_regularisation_rows(&self, z: &[f64], model: &mut LinearModel) {
        let NmpcSettings {
            rate_weight,
            rate_change_weight,
            ..
        } = *self.settings;
        let rate_weight = f64::from(rate_weight);
        if rate_weight > 0.0 {
            model.weight_unknowns(rate_weight, &self.posture[..self.width()], z);
        }
        if rate_change_weight > 0.0 {
            let scale = rate_change_weight.sqrt();
            for i in 0..z.len() {
                let earlier = i.checked_sub(self.width());
                let before = earlier.map_or_else(|| self.previous[i], |k| z[k]);
                let row = model.push_dense(scale * (z[i] - before));
                row[i] = scale;
                if let Some(k) = earlier {
                    row[k] = -scale;
                }
            }
        }
    }

    fn push_pose_rows(&self, at: &Step, shape: &Configuration, model: &mut LinearModel) {
        if let Some(target) = self.target(at.index) {
            let mut jacobian = Jacobian::default();
            let tip = self.robot.tip_jacobian(shape, &mut jacobian);
            let weights = self.weights(at.index);
            pose_error::residuals(
                self.robot,
                &tip,
                &jacobian,
                target,
                &weights,
                &mut |mut row: ResidualRow| {
                    self.motion
                        .to_control_derivatives(at.bends, &mut row.derivatives);
                    model.push(row.residual, &row.derivatives[..self.width()], at.stage);
                },
            );
        }
    }

    /// Adds a constraint on the bends at the end of a step, unless no step in the box can violate it. Its
    /// slack is h as a share of the largest decrease by a step in the box, within ±1.
    fn push_constraint(
        &self,
        (kind, h): (usize, f64),
        mut derivatives: [f64; COORDINATES_MAX],
        at: &Step,
        stage: RowStage,
        model: &mut LinearModel,
    ) {
        self.motion
            .to_control_derivatives(at.bends, &mut derivatives);
        // The last block has the widest box.
        let last = self.dimension() - self.width();
        let (lower, upper) = (&self.bounds.lower()[last..], &self.bounds.upper()[last..]);
        let widths = upper.iter().zip(lower).map(|(upper, lower)| upper - lower);
        let per_s: f64 = derivatives
            .iter()
            .zip(widths)
            .map(|(d, width)| d.abs() * width)
            .sum();
        let periods = if stage.since_start {
            (at.index + 1) as f64
        } else {
            stage.periods
        };
        let most = per_s * self.motion.period_s() * periods;
        if h <= most {
            let slack = (h / most).clamp(-1.0, 1.0);
            model.push_constraint(kind, h, slack, &derivatives[..self.width()], stage);
        }
    }

    /// Adds the linearised limits. False: the budget was spent.
    fn push_limit_rows(
        &self,
        before: &Bent,
        at: &Step,
        model: &mut LinearModel,
        budget: &mut Budget<'_>,
    ) -> bool {
        if !self.limits.any_reachable() {
            return true;
        }
        let row_ns = self.constraint_ns();
        let mut is_left = budget.spend(self.sections_ns(LIMITS_NS));
        self.limits
            .rows(&before.scalar(), &at.bends.scalar(), |row: LimitRow| {
                is_left = is_left && budget.spend(row_ns);
                let stage = if row.is_step_change {
                    RowStage {
                        since_start: false,
                        periods: 1.0,
                        ..at.stage
                    }
                } else {
                    at.stage
                };
                if is_left {
                    let kind_and_h = (LIMITS, row.h);
                    self.push_constraint(kind_and_h, row.derivatives, at, stage, model);
                }
            });
        is_left
    }

    /// Adds the clearances that a step can violate if it moves the sections by at most `reach_m`. False: the
    /// budget was spent.
    fn push_clearance_rows(
        &self,
        at: &Step,
        reach_m: &[f64; SECTIONS_MAX],
        model: &mut LinearModel,
        budget: &mut Budget<'_>,
    ) -> bool {
        let instant = self.step_time(at.index);
        let push = |row: ClearanceRow| {
            let kind_and_h = (CLEARANCE, row.h);
            self.push_constraint(kind_and_h, row.derivatives, at, at.stage, model);
        };
        let moved = (at.bends, reach_m);
        self.obstacles
            .rows(self.robot, self.settings, instant, moved, budget, push)
    }

    /// Calls `visit` for the end of each step of a plan, with the bends before the step, until it returns
    /// false. Returns whether all calls returned true.
    fn for_each_step(&self, z: &[f64], mut visit: impl FnMut(&Bent, &Step) -> bool) -> bool {
        let mut bends: Bent = self.motion.start();
        self.row_stages().enumerate().all(|(index, stage)| {
            let before = bends;
            self.motion.advance_one(&mut bends, z, index);
            let bends = &bends;
            visit(
                &before,
                &Step {
                    index,
                    bends,
                    stage,
                },
            )
        })
    }

    /// The stage of the rows at the end of each step.
    fn row_stages(&self) -> impl Iterator<Item = RowStage> {
        let mut stage = RowStage {
            block: 0,
            since_start: true,
            periods: 0.0,
        };
        (0..self.steps()).map(move |step| {
            let block = self.motion.horizon().block_of(step);
            if block > stage.block {
                (stage.block, stage.periods) = (block, 0.0);
            }
            stage.periods += 1.0;
            stage
        })
    }

    /// Nominal time of one step of [`Problem::evaluate_below`] without obstacles.
    #[inline(always)]
    fn step_ns(&self) -> u32 {
        let limits_ns = if self.limits.any_reachable() {
            LIMITS_NS
        } else {
            0
        };
        self.sections_ns(SECTION_NS + limits_ns)
    }

    /// Nominal time of all sections.
    #[inline(always)]
    fn sections_ns(&self, each_ns: u32) -> u32 {
        each_ns * self.robot.section_count() as u32
    }

    /// Nominal time of one constraint of [`Problem::constrain`].
    fn constraint_ns(&self) -> u32 {
        let own = [self.dimension(), self.width()][usize::from(self.is_staged())];
        CONSTRAINT_NS + ROW_NS * own as u32
    }

    /// Nominal time of one step of [`Problem::linearise`]: the Jacobian, and up to twelve rows.
    fn linearise_step_ns(&self, step: usize) -> u32 {
        let rows = match self.target(step).map(|target| target.orientation) {
            None | Some(Orientation::Free) => 3,
            Some(Orientation::Axis(_) | Orientation::Preferred(_)) => 6,
            Some(Orientation::Full(_)) => 12,
        };
        3 * self.sections_ns(SECTION_NS) + rows * ROW_NS * self.dimension() as u32 / 3
    }
}

/// The end of one step of a plan.
struct Step<'a> {
    index: usize,
    bends: &'a Bent,
    stage: RowStage,
}

impl Problem for TrackingProblem<'_> {
    fn stages(&self) -> &Stages {
        &self.stages
    }

    fn is_staged(&self) -> bool {
        // A weight on the change of rates couples neighbouring blocks, which staged rows cannot represent.
        self.stages.blocks() >= STAGED_BLOCKS_MIN && self.settings.rate_change_weight == 0.0
    }

    fn evaluate_below(
        &self,
        z: &[f64],
        cost_cutoff: f64,
        budget: &mut Budget<'_>,
    ) -> Option<Evaluation<1>> {
        let (z, scalar) = (|i: usize| Wide([z[i]]), pulp::Scalar);
        match self.motion.coordinates() {
            Coordinates::BendVector => {
                self.evaluate_in::<1, VECTORS>(&z, None, cost_cutoff, budget, scalar)
            }
            Coordinates::BendAngles => {
                self.evaluate_in::<1, ANGLES>(&z, None, cost_cutoff, budget, scalar)
            }
        }
    }

    fn rounding(&self) -> Option<f64> {
        self.is_position_only().then(|| self.rounding_cost())
    }

    fn least_cost(&self) -> Option<f64> {
        self.is_staged().then(|| self.rounding_cost())
    }

    fn evaluate_residuals(
        &self,
        z: &[f64],
        residuals: &mut [f64],
        budget: &mut Budget<'_>,
    ) -> Option<Evaluation<1>> {
        match self.motion.coordinates() {
            Coordinates::BendVector => self.position_residuals::<VECTORS>(z, residuals, budget),
            Coordinates::BendAngles => self.position_residuals::<ANGLES>(z, residuals, budget),
        }
        .ok()
    }

    fn evaluate_until_violation(
        &self,
        z: &mut [f64],
        incumbent: &Incumbent,
        residuals: &mut [f64],
        budget: &mut Budget<'_>,
    ) -> Option<(Evaluation<1>, bool)> {
        match self.motion.coordinates() {
            Coordinates::BendVector => {
                self.evaluate_until_violation_in::<VECTORS>(z, incumbent, residuals, budget)
            }
            Coordinates::BendAngles => {
                self.evaluate_until_violation_in::<ANGLES>(z, incumbent, residuals, budget)
            }
        }
    }

    fn linearise(&self, z: &[f64], model: &mut LinearModel, budget: &mut Budget<'_>) -> bool {
        if self.follows_positions
            && self.is_free()
            && self.motion.coordinates() == Coordinates::BendVector
        {
            return self.push_position_rows(z, model, budget);
        }
        let is_left = self.for_each_step(z, |_, at| {
            let is_left = budget.spend(self.linearise_step_ns(at.index));
            if is_left {
                self.push_pose_rows(at, &self.motion.shape(at.bends), model);
            }
            is_left
        });
        self.push_regularisation_rows(z, model);
        is_left
    }

    fn constrain(
        &self,
        z: &[f64],
        reach: Option<Reach>,
        model: &mut LinearModel,
        budget: &mut Budget<'_>,
    ) -> bool {
        if self.is_free() {
            return true;
        }
        let mut change = [0.0; COORDINATES_MAX];
        let change = &mut change[..self.width()];
        self.for_each_step(z, |before, at| {
            if !budget.spend(self.sections_ns(SECTION_NS)) {
                return false;
            }
            let mut reach_m = [f64::INFINITY; SECTIONS_MAX];
            if let Some(Reach {
                step,
                times,
                violations,
            }) = reach
            {
                let of_block = &step[at.stage.block * self.width()..];
                for (change, rate) in change.iter_mut().zip(of_block) {
                    *change += self.motion.period_s() * rate;
                }
                let changes_rad = self.motion.bend_changes_rad(at.bends, change);
                let travel_m = self.robot.travel_m(&changes_rad);
                // A step that repairs the largest clearance violation may move any section by that much.
                reach_m = travel_m.map(|own_m| f64::max(times * own_m, violations[CLEARANCE]));
            }
            self.push_limit_rows(before, at, model, budget)
                && self.push_clearance_rows(at, &reach_m, model, budget)
        })
    }
}

#[cfg(test)]
mod tests;
