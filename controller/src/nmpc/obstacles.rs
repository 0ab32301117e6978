//! Obstacles over the horizon. They are culled once per solve with the box of the controls, and again at each
//! step with the bends of the rollouts. Then each section below the safe distance adds a penalty at each
//! step.

use super::motion::{Bent, Motion};
use super::{HORIZON_STEPS_MAX, NmpcSettings, OBSTACLES_MAX};
use crate::optimizer::{Budget, Evaluation};
use crate::robot::{
    BodyMotion, COORDINATES_MAX, Configuration, Obstacle, Robot, SECTIONS_MAX, Shape,
};
use crate::wide::Wide;

/// Index of the clearance among the violations: depth inside the safe distance \[m\].
pub(super) const CLEARANCE: usize = 0;
/// Nominal time of one section against a sphere \[ns\]: for W rollouts at once, or for one.
const SPHERE_NS: u32 = 40;
/// Nominal time of one section against a capsule \[ns\], in the same cases.
const CAPSULE_NS: u32 = 300;
/// Nominal time of culling one obstacle at a step \[ns\].
const CULLING_NS: u32 = 4;
/// Nominal time of excluding a section by bounding spheres and chord \[ns\].
const BEYOND_NS: u32 = 8;
/// Nominal time of bounding one distance by a chord \[ns\].
const CHORD_NS: u32 = 50;
/// Nominal time of preparing one section for exact distances of one rollout \[ns\].
const BODY_NS: u32 = 80;
/// Nominal time of preparing one section for derivatives \[ns\].
const MOTION_NS: u32 = 60;
/// Nominal time of the derivatives of one distance \[ns\].
const ROW_NS: u32 = 160;
/// Margin of a Gauss-Newton step beyond the safe distance \[m\]. It absorbs rounding and the linearisation
/// error.
const MARGIN_M: f64 = 1e-6;
/// Bound of the rounding error in the distances for culling \[m\].
const ROUNDING_M: f64 = 1e-9;
/// Scale of a constraint residual relative to the tip's position residual: 1 mm counts as much as 1 m of the
/// tip.
const CONSTRAINT_SCALE: f64 = 1e3;

/// The obstacles within reach of the body over the horizon.
#[derive(Debug)]
pub(super) struct Obstacles {
    reachable: Vec<ReachableObstacle>,
    /// The configuration to which the clearances at the start refer.
    start: Configuration,
}

/// An obstacle, and for each step the sections (one bit each) that can come within the safe distance by its
/// end.
#[derive(Debug, Clone, Copy)]
struct ReachableObstacle {
    obstacle: Obstacle,
    sections: [u8; HORIZON_STEPS_MAX],
    /// Clearance of each section at the start less the safe distance; for a capsule a lower bound. Infinite
    /// for sections that no plan brings within the safe distance.
    start_margin_m: [f64; SECTIONS_MAX],
    /// Motion of the obstacle in one period \[m\].
    per_step_m: f64,
}

impl ReachableObstacle {
    /// The sections that can be within the safe distance at the end of `step`, if none has moved by more than
    /// `travel_m` since the start.
    #[inline(always)]
    fn sections_at(&self, step: usize, travel_m: &[f64; SECTIONS_MAX]) -> u8 {
        let own_m = self.per_step_m * (step + 1) as f64 + ROUNDING_M;
        // Without branches: which sections remain is hard to predict.
        let mut beyond = 0;
        for j in 0..SECTIONS_MAX {
            beyond |= u8::from(self.start_margin_m[j] > own_m + travel_m[j]) << j;
        }
        self.sections[step] & !beyond
    }
}

/// Indices of the bits that are set, lowest first.
#[inline(always)]
fn indices(mut bits: u8) -> impl Iterator<Item = usize> {
    core::iter::from_fn(move || {
        let lowest = (bits != 0).then(|| bits.trailing_zeros() as usize);
        bits &= bits.wrapping_sub(1);
        lowest
    })
}

/// The end of a step.
#[derive(Debug, Clone, Copy)]
pub(super) struct StepTime {
    /// Step, 0-based.
    pub step: usize,
    /// Time since the release \[s\].
    pub time_s: f64,
}

/// A linearised distance h + A Δb ≥ 0 on bend vectors.
pub(super) struct ClearanceRow {
    pub h: f64,
    pub derivatives: [f64; COORDINATES_MAX],
}

/// The first step (0-based) by whose end a distance can shrink by `distance_m`, at `per_step_m` a step; 0
/// when either is NaN.
fn first_step(distance_m: f64, per_step_m: f64) -> usize {
    let steps = (distance_m - ROUNDING_M) / per_step_m;
    // A cast saturates: an infinite number becomes the last step, NaN becomes 0.
    (steps.ceil() - 1.0) as usize
}

/// Nominal time of one section against this obstacle \[ns\].
#[inline(always)]
fn section_ns(obstacle: &Obstacle) -> u32 {
    match obstacle.shape() {
        Shape::Sphere { .. } => SPHERE_NS,
        Shape::Capsule { .. } => CAPSULE_NS,
    }
}

impl Obstacles {
    pub(super) fn with_capacity() -> Self {
        Self {
            reachable: Vec::with_capacity(OBSTACLES_MAX),
            ..Self::none()
        }
    }

    /// No obstacles, without memory for any.
    pub(super) fn none() -> Self {
        Self {
            reachable: Vec::new(),
            start: Configuration::straight(1),
        }
    }

    /// Keeps the obstacles that a plan in the box can bring within the safe distance. `fastest_rad_s` bounds
    /// the norm of each section's bend rate. If the budget ends the culling, no plan is evaluated later
    /// either.
    pub(super) fn cull(
        &mut self,
        robot: &Robot,
        motion: &Motion,
        obstacles: &[Obstacle],
        safe_distance_m: f64,
        fastest_rad_s: &[f64; SECTIONS_MAX],
        budget: &mut Budget<'_>,
    ) {
        self.reachable.clear();
        if obstacles.is_empty() {
            return;
        }
        let steps = motion.horizon().steps();
        self.start = motion.start_shape();
        let body = robot.body(&self.start);
        // Largest approach of body and obstacle in one period; k periods give at most k times as much.
        let per_step_m = robot.travel_m(&fastest_rad_s.map(|rate| rate * motion.period_s()));
        for obstacle in obstacles.iter().take(OBSTACLES_MAX) {
            let bound_ns = match obstacle.shape() {
                Shape::Sphere { .. } => SPHERE_NS,
                Shape::Capsule { .. } => CHORD_NS,
            };
            if !budget.spend(bound_ns * robot.section_count() as u32) {
                return;
            }
            let own_m = obstacle.velocity_m_s().norm() * motion.period_s();
            let per_step_m = per_step_m.map(|travel_m| travel_m + own_m);
            let reach_m = per_step_m.map(|travel_m| travel_m * steps as f64 + safe_distance_m);
            // For a capsule a lower bound suffices: each rollout is culled again, section by section.
            let clearances_m = body.clearances_below(obstacle, &reach_m, f64::NEG_INFINITY);
            let mut sections = [0; HORIZON_STEPS_MAX];
            for (j, clearance_m) in clearances_m.into_iter().enumerate() {
                let first = first_step(clearance_m - safe_distance_m, per_step_m[j]);
                for later in sections[..steps].iter_mut().skip(first) {
                    *later |= 1 << j;
                }
            }
            if sections[steps - 1] != 0 {
                self.reachable.push(ReachableObstacle {
                    obstacle: *obstacle,
                    sections,
                    start_margin_m: clearances_m.map(|clearance_m| clearance_m - safe_distance_m),
                    per_step_m: own_m,
                });
            }
        }
    }

    /// Number of obstacles within reach.
    pub(super) fn count(&self) -> u32 {
        self.reachable.len() as u32
    }

    pub(super) fn any_reachable(&self) -> bool {
        self.count() > 0
    }

    /// Whether all obstacles within reach are at rest.
    pub(super) fn all_at_rest(&self) -> bool {
        self.reachable
            .iter()
            .all(|candidate| candidate.per_step_m == 0.0)
    }

    /// Whether the body can come within the safe distance of any obstacle by the end of `step`.
    #[inline(always)]
    fn any_reachable_at(&self, step: usize) -> bool {
        self.reachable
            .iter()
            .any(|candidate| candidate.sections[step] != 0)
    }

    /// Largest motion of each section since the start in any of W rollouts \[m\]. Also returns zero, or NaN
    /// for the lanes that are not finite.
    #[inline(always)]
    fn travel_m<const W: usize>(
        &self,
        robot: &Robot,
        bend_rad: &[Wide<W>; COORDINATES_MAX],
    ) -> ([f64; SECTIONS_MAX], Wide<W>) {
        let mut sum = Wide::splat(0.0);
        let mut bend_change_max_rad = [0.0; SECTIONS_MAX];
        let starts = self.start.pairs().iter().take(robot.section_count());
        for (j, [start_u, start_v]) in starts.enumerate() {
            let (u, v) = (bend_rad[2 * j] - *start_u, bend_rad[2 * j + 1] - *start_v);
            let square = u * u + v * v;
            sum = sum + square;
            // A plain loop ignores NaN; the sum carries the NaN of each lane.
            let mut most = 0.0;
            for lane in 0..W {
                most = f64::max(most, square.0[lane]);
            }
            bend_change_max_rad[j] = most.sqrt();
        }
        (robot.travel_m(&bend_change_max_rad), sum * 0.0)
    }

    /// Adds the penalties at the end of a step. None: the budget was spent.
    #[inline(always)]
    pub(super) fn add_penalties<const W: usize>(
        &self,
        robot: &Robot,
        settings: &NmpcSettings,
        at: StepTime,
        bend_rad: &[Wide<W>; COORDINATES_MAX],
        evaluation: &mut Evaluation<W>,
        budget: &mut Budget<'_>,
    ) -> Option<()> {
        if !self.any_reachable_at(at.step) {
            return Some(());
        }
        if !budget.spend(CULLING_NS * self.reachable.len() as u32) {
            return None;
        }
        let (travel_m, poison) = self.travel_m(robot, bend_rad);
        evaluation.cost = evaluation.cost + poison;
        let is_in_reach =
            |candidate: &ReachableObstacle| candidate.sections_at(at.step, &travel_m) != 0;
        if !self.reachable.iter().any(is_in_reach) {
            return Some(());
        }
        let body = robot.body_wide(|i| bend_rad[i]);
        let (zero, cutoff_m) = (Wide::splat(0.0), settings.safe_distance_m);
        for candidate in &self.reachable {
            let sections = candidate.sections_at(at.step, &travel_m);
            if sections == 0 {
                continue;
            }
            if !budget.spend(BEYOND_NS * sections.count_ones()) {
                return None;
            }
            let moved;
            // Most obstacles rest, and a copy costs as much as the cheap test of a section.
            let obstacle = if candidate.per_step_m == 0.0 {
                &candidate.obstacle
            } else {
                moved = candidate.obstacle.moved(at.time_s);
                &moved
            };
            // One penalty for each section: a section that is already inside must not let another enter at no
            // cost.
            for j in indices(sections) {
                let Some(beyond) = body.section_is_beyond(j, obstacle, cutoff_m) else {
                    continue;
                };
                if !budget.spend(section_ns(&candidate.obstacle)) {
                    return None;
                }
                let clearance_m = body.section_clearance_below(j, obstacle, cutoff_m, beyond);
                let depth_m = Wide::splat(cutoff_m) - clearance_m;
                let inside = zero.less(depth_m);
                let step = Wide::splat(settings.obstacle_step_penalty).select(zero, inside);
                let beyond = depth_m * settings.obstacle_slope_penalty
                    + depth_m * depth_m * settings.obstacle_square_penalty;
                evaluation.cost = evaluation.cost + (step + beyond);
                let worst = evaluation.violations[CLEARANCE];
                evaluation.violations[CLEARANCE] = depth_m.select(worst, worst.less(depth_m));
            }
        }
        Some(())
    }

    /// Linearises the clearances for a Gauss-Newton step: one row for each section and obstacle that a step
    /// can bring too near, if it moves each section by at most `reach_m`. False: the budget was spent.
    pub(super) fn rows(
        &self,
        robot: &Robot,
        settings: &NmpcSettings,
        at: StepTime,
        (bends, reach_m): (&Bent, &[f64; SECTIONS_MAX]),
        budget: &mut Budget<'_>,
        mut push: impl FnMut(ClearanceRow),
    ) -> bool {
        if !self.any_reachable_at(at.step) {
            return true;
        }
        if !budget.spend(CULLING_NS * self.reachable.len() as u32) {
            return false;
        }
        let kept_m = settings.safe_distance_m + MARGIN_M;
        let (mut moved_m, _) = self.travel_m(robot, &bends.bend_rad);
        for (moved_m, reach_m) in moved_m.iter_mut().zip(reach_m) {
            *moved_m += reach_m + MARGIN_M;
        }
        let is_in_reach =
            |candidate: &ReachableObstacle| candidate.sections_at(at.step, &moved_m) != 0;
        if !self.reachable.iter().any(is_in_reach) {
            return true;
        }
        let section_count = robot.section_count() as u32;
        if !budget.spend(BODY_NS * section_count) {
            return false;
        }
        let shape = self.shape(bends);
        let body = robot.body(&shape);
        let scale = CONSTRAINT_SCALE * settings.position_weight.sqrt();
        let mut motion: Option<BodyMotion> = None;
        let mut jacobian = [[0.0; 3]; COORDINATES_MAX];
        for candidate in &self.reachable {
            let sections = candidate.sections_at(at.step, &moved_m);
            let obstacle = candidate.obstacle.moved(at.time_s);
            for j in indices(sections) {
                if matches!(obstacle.shape(), Shape::Capsule { .. }) && reach_m[j].is_finite() {
                    if !budget.spend(CHORD_NS) {
                        return false;
                    }
                    if body.clearance_min_of(j, &obstacle) - kept_m > reach_m[j] {
                        continue;
                    }
                }
                if !budget.spend(section_ns(&candidate.obstacle)) {
                    return false;
                }
                let closest = body.closest_of(j, &obstacle);
                if closest.clearance_m - kept_m > reach_m[j] {
                    continue;
                }
                let motion_ns = if motion.is_none() {
                    MOTION_NS * section_count
                } else {
                    0
                };
                if !budget.spend(ROW_NS + motion_ns) {
                    return false;
                }
                let motion = motion.get_or_insert_with(|| robot.body_motion(&shape));
                let nearest = body.nearest_from(&closest, &obstacle);
                motion.point_jacobian(nearest.section, nearest.s, &mut jacobian);
                let mut derivatives = [0.0; COORDINATES_MAX];
                for (derivative, velocity) in derivatives.iter_mut().zip(&jacobian) {
                    let along = nearest.direction.iter().zip(velocity);
                    *derivative = scale * along.map(|(d, v)| d * v).sum::<f64>();
                }
                push(ClearanceRow {
                    h: scale * (nearest.clearance_m - kept_m),
                    derivatives,
                });
            }
        }
        true
    }

    /// The configuration of a rollout, with the section count of the start.
    fn shape(&self, bends: &Bent) -> Configuration {
        Configuration::padded(bends.scalar(), self.start.section_count())
    }
}
