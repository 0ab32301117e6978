//! The part of the problem within reach over a horizon: the box of the controls, and the obstacles and
//! limits.

use super::limits::PlanLimits;
use super::motion::Motion;
use super::obstacles::Obstacles;
use super::problem::TrackingProblem;
use super::{Coordinates, Horizon, NmpcSettings, SolveInput};
use crate::optimizer::{Bounds, Budget};
use crate::reference::ReferenceSample;
use crate::robot::Robot;

/// Inputs of one solve that do not depend on the horizon.
#[derive(Debug, Clone, Copy)]
pub(super) struct SolveContext<'a> {
    pub robot: &'a Robot,
    pub period_s: f64,
    pub acceleration_rad_s2: f64,
    pub settings: &'a NmpcSettings,
    pub input: &'a SolveInput<'a>,
}

impl<'a> SolveContext<'a> {
    /// The dynamics over this horizon.
    pub(super) fn motion(&self, horizon: &'a Horizon) -> Motion<'a> {
        Motion::new(
            self.robot,
            self.period_s,
            self.settings.coordinates,
            horizon,
            self.input.configuration,
            self.input.previous_rates,
            self.input.reference.first().map(|sample| sample.position_m),
        )
    }

    /// The optimal control problem over the horizon of this motion.
    pub(super) fn problem(
        &self,
        motion: &'a Motion<'a>,
        limits: &'a PlanLimits<'a>,
        reachable: &'a Reachable,
        reference: &'a [ReferenceSample],
    ) -> TrackingProblem<'a> {
        let Reachable { bounds, obstacles } = reachable;
        let (robot, settings, previous_rates) =
            (self.robot, self.settings, self.input.previous_rates);
        TrackingProblem::new(
            robot,
            settings,
            motion,
            limits,
            obstacles,
            bounds,
            (previous_rates, reference),
        )
    }
}

#[derive(Debug)]
pub(super) struct Reachable {
    /// The box of the controls.
    pub bounds: Bounds,
    pub obstacles: Obstacles,
}

impl Reachable {
    pub(super) fn with_capacity(unknowns: usize) -> Self {
        Self {
            bounds: Bounds::with_capacity(unknowns),
            obstacles: Obstacles::with_capacity(),
        }
    }

    /// Recomputes box and obstacles for a motion; returns the limits within reach.
    pub(super) fn update<'a>(
        &mut self,
        context: &SolveContext<'a>,
        motion: &Motion,
        budget: &mut Budget<'_>,
    ) -> PlanLimits<'a> {
        let SolveContext {
            robot,
            settings,
            input,
            ..
        } = *context;
        motion.set_bounds(robot, &mut self.bounds);
        let fastest_rad_s = motion.fastest_rad_s(&self.bounds);
        let is_limited = context.acceleration_rad_s2 < f64::INFINITY;
        if is_limited && settings.coordinates == Coordinates::BendVector {
            let change_rad_s = context.acceleration_rad_s2 * context.period_s;
            let change = |block| change_rad_s * motion.horizon().steps_into(block) as f64;
            self.bounds
                .limit_growth(input.previous_rates.as_slice(), change);
        }
        self.obstacles.cull(
            robot,
            motion,
            input.obstacles,
            settings.safe_distance_m,
            &fastest_rad_s,
            budget,
        );
        PlanLimits::new(robot, motion, settings.position_weight, &fastest_rad_s)
    }
}
