//! The clearance guard: no command, and no ramp to rest after it, brings the body closer to an obstacle than
//! allowed.

mod body_pose;
mod near;
mod path_check;
mod play;
mod relinearised;
mod rows;
mod watched;

use crate::estimator::Slack;
use crate::robot::{BendRates, Configuration, Obstacle, Robot, SECTIONS_MAX};

use super::Limits;
use super::projection::Region;
use super::stopping::{Stopping, fastest, scaled_by, shortened_to};
use body_pose::BodyPose;
pub(super) use near::{NEAR_MAX, POINT_COST, REGION_COST, ROW_COST, SOLVE_COST, dip_m, thinnest_m};
use near::{NearObstacles, Violation};
use relinearised::{LINEARISATIONS, Linearisation, SLOW_LINEARISATION};
pub(super) use watched::clearance_cost;

/// Corrections of one command before it is scaled down instead.
const CORRECTIONS: usize = 12;
/// A correction counts as rest below this share of the fastest desired component.
const REST_SHARE: f64 = 1e-6;
/// Bisection steps of the scaling.
const SCALES: u32 = 12;
/// Width of the interval of scales at which the bisection ends, as a share of the rates.
const SCALE_WITHIN: f64 = 1.0 / 256.0;

/// Output of the guard.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Guarded {
    /// Rates that keep the safe distance \[rad/s\]: the desired ones, corrected, scaled down or zero.
    pub(super) rates: BendRates,
    /// Whether the guard changed the rates.
    pub(super) hit: bool,
    /// Smallest present clearance of the body to any obstacle \[m\]: negative inside an obstacle, infinite
    /// without obstacles, NaN when the state is not finite.
    pub(super) clearance_m: f64,
}

/// The inputs of the guard.
#[derive(Debug, Clone, Copy)]
pub(super) struct ClearanceGuard<'a> {
    /// Model of the robot.
    pub(super) robot: &'a Robot,
    /// Present configuration of the body.
    pub(super) at: &'a Configuration,
    /// Commanded configuration of a robot that obeys positions: its motors are still moving towards it.
    pub(super) commanded: Option<&'a Configuration>,
    /// Present play of the cables, where the commands move the motors.
    pub(super) slack: Option<&'a Slack>,
    /// Obstacles at their present positions.
    pub(super) obstacles: &'a [Obstacle],
    /// Safe distance D \[m\].
    pub(super) safe_distance_m: f64,
    /// Control period \[s\].
    pub(super) period_s: f64,
    /// The motion after the command.
    pub(super) stopping: Stopping,
}

impl ClearanceGuard<'_> {
    /// Returns rates that satisfy the clearance rule and are close to `rates`, which are inside the limits.
    ///
    /// Let cⱼ(s) be the clearance between section j at bend + s q̇ and an obstacle, which has moved at its
    /// velocity until the robot is at s. Let c⁰ⱼ(s) be the same clearance for the robot at rest. For every
    /// obstacle and section, the returned rates satisfy
    ///
    /// ```text
    /// cⱼ(s) ≥ min(D, c⁰ⱼ(s))            at the end of the period and of the stopping path: exactly
    /// cⱼ(s) ≥ min(D, c⁰ⱼ(s)) - 1 mm     between; less by the obstacle's own motion in one period
    /// ```
    ///
    /// So no command leads from outside into D, no command inside D leads closer, and none passes through a
    /// stationary obstacle, even when no other command follows. A robot between these ends, because commands
    /// were lost, keeps the clearance that it has there; it may lose the millimetre again with each loss. The
    /// rates stay inside the limits, and no component is faster than the fastest component of `rates`.
    ///
    /// Rates that violate the rule are corrected: violated clearances are linearised, the nearest rates in
    /// the resulting half-spaces are found, and this repeats, so the robot slides along the obstacle. If no
    /// correction satisfies the rule exactly, the last one is scaled down, then `rates` themselves. If
    /// nothing but rest is left and few obstacles are near, all clearances are relinearised at one point, for
    /// slow rates first. Among many obstacles, that is done first, for slow rates only, within the work
    /// budget. Slower rates stop sooner: each candidate has its own stopping path and time. Rest always
    /// satisfies the rule. A robot that obeys positions satisfies it from its commanded configuration, too.
    ///
    /// Limits: the guard plans no way around an obstacle, and the robot does not flee from an obstacle that
    /// moves into it.
    ///
    /// Nothing allocates, the work is bounded, and a few comparisons suffice where no obstacle is near. The
    /// same inputs give the same bits.
    pub(super) fn apply(&self, limits: &Limits<'_>, rates: &BendRates) -> Guarded {
        self.guarded(rates, false, |near| {
            if !near.are_few() {
                let violations = near.violations();
                let slow = self.relinearised(near, limits, rates, SLOW_LINEARISATION);
                near.restore(violations);
                let found = self.corrected(near, limits, rates);
                return faster(found, slow);
            }
            let found = self.corrected(near, limits, rates);
            if found == self.rest() {
                near.allow_relinearisation();
                return self.relinearised(near, limits, rates, LINEARISATIONS);
            }
            found
        })
    }

    /// For a robot that comes to rest: `ramp` is only scaled down, so no component becomes larger.
    ///
    /// The ramp continues along the stopping path of the previous command and may end anywhere on it. Next to
    /// a stationary obstacle it therefore keeps D - 1 mm at its ends, and another millimetre less between:
    /// what the previous command was allowed, the ramp is allowed.
    pub(super) fn scale_down(&self, ramp: &BendRates) -> Guarded {
        self.guarded(ramp, true, |near| self.scaled(near, ramp))
    }

    /// `rates`, scaled down until the rule of [`Self::apply`] is satisfied.
    pub(super) fn shorten(&self, rates: &BendRates) -> Guarded {
        self.guarded(rates, false, |near| self.scaled(near, rates))
    }

    /// The rates if they satisfy the rule, otherwise the output of `repair`.
    fn guarded(
        &self,
        rates: &BendRates,
        is_ramp: bool,
        repair: impl FnOnce(&Origins<'_>) -> BendRates,
    ) -> Guarded {
        let guarded = |allowed: BendRates, clearance_m| Guarded {
            rates: allowed,
            hit: allowed != *rates,
            clearance_m,
        };
        if self.obstacles.is_empty() {
            return guarded(*rates, f64::INFINITY);
        }
        let pose = BodyPose::new(self.robot, self.at);
        let Some(measured) = NearObstacles::find(self, &pose, rates, is_ramp) else {
            return guarded(self.rest(), self.clearance_m(&pose));
        };
        let clearance_m = match measured.least_clearance_m() {
            Some(clearance_m) => clearance_m,
            None => self.clearance_m(&pose),
        };
        let commanded = self.commanded.filter(|commanded| *commanded != self.at);
        let pose = commanded.map(|commanded| BodyPose::new(self.robot, commanded));
        let commanded = pose
            .as_ref()
            .map(|it| NearObstacles::find(&self.without_play(), it, rates, is_ramp));
        let origins = match &commanded {
            None => [Some(&measured), None],
            Some(Some(commanded)) => [Some(&measured), Some(commanded)],
            Some(None) => return guarded(self.rest(), clearance_m),
        };
        let origins = Origins(origins);
        if origins.check(self, rates).is_ok() {
            return guarded(*rates, clearance_m);
        }
        guarded(repair(&origins), clearance_m)
    }

    /// The nearest rates that satisfy limits and rule, as far as repeated linearisation finds them.
    fn corrected(
        &self,
        near: &Origins<'_>,
        limits: &Limits<'_>,
        desired_rates: &BendRates,
    ) -> BendRates {
        // The last step shortens the rates, which may then be closer than the nearest point of the region.
        let mut region = Region::EMPTY;
        limits.fill(&mut region, fastest(desired_rates));
        let mut rates = *desired_rates;
        for _ in 0..CORRECTIONS {
            let rows = near.row_count();
            if !near.has_budget_to_correct()
                || !near.bound(self, &rates, &mut region)
                || region.is_full()
            {
                break;
            }
            let Some(nearest) = limits.nearest_in(&mut region, desired_rates) else {
                break;
            };
            let before = rates;
            rates = shortened_to(nearest, fastest(desired_rates));
            if rates == before {
                if near.row_count() == rows {
                    // Every violation already has its row around these rates.
                    break;
                }
                // The first rows are linearised at rest and do not exclude these rates; the next are
                // linearised at them.
                continue;
            }
            if fastest(&rates) <= REST_SHARE * fastest(desired_rates) {
                return self.rest();
            }
            if near.check(self, &rates).is_ok() {
                return rates;
            }
        }
        let scaled = self.scaled(near, &rates);
        if scaled == self.rest() {
            return self.scaled(near, desired_rates);
        }
        scaled
    }

    /// `rates`, scaled down until the rule is satisfied. Bisection, with the next scale where the violated
    /// clearance would suffice if it were linear.
    fn scaled(&self, near: &Origins, rates: &BendRates) -> BendRates {
        let mut held = self.rest();
        let (mut low, mut high, mut between) = (0.0, 1.0, 0.5_f64);
        for _ in 0..SCALES {
            if near.is_budget_spent() || high - low <= SCALE_WITHIN {
                break;
            }
            let middle = low + (high - low) * between.clamp(0.125, 0.875);
            let scaled = scaled_by(rates, middle);
            match near.check(self, &scaled) {
                Ok(()) => (low, held, between) = (middle, scaled, 0.5),
                Err(share) => {
                    high = middle;
                    between = (share * high - low) / (high - low);
                }
            }
        }
        held
    }

    /// Upper bound of the distance that any point of each section moves along the stopping path \[m\], for
    /// all rates inside the limits that are not faster than `rates`.
    pub(super) fn farthest_m(&self, rates: &BendRates) -> [f64; SECTIONS_MAX] {
        let path_s = self.stopping.path(fastest(rates)).path_s;
        let mut change_rad = [0.0; SECTIONS_MAX];
        for (change_rad, section) in change_rad.iter_mut().zip(self.robot.sections()) {
            let largest_rad_s = fastest(rates).min(section.rate_max_rad_s);
            *change_rad = path_s * core::f64::consts::SQRT_2 * largest_rad_s;
        }
        self.robot.travel_m(&self.bend_bound(change_rad))
    }

    fn without_play(&self) -> Self {
        Self {
            slack: None,
            ..*self
        }
    }

    fn clearance_m(&self, pose: &BodyPose) -> f64 {
        let obstacles = self.obstacles.iter();
        pose.body.least_clearance_m(obstacles.copied())
    }

    fn rest(&self) -> BendRates {
        BendRates::zero(self.robot.section_count())
    }
}

/// Near obstacles seen from the measured and from the commanded configuration.
struct Origins<'a>([Option<&'a NearObstacles<'a>>; 2]);

impl Origins<'_> {
    fn iter(&self) -> impl Iterator<Item = &NearObstacles<'_>> {
        self.0.iter().copied().flatten()
    }

    fn is_budget_spent(&self) -> bool {
        self.iter().any(NearObstacles::is_budget_spent)
    }

    fn has_budget_to_correct(&self) -> bool {
        self.iter().all(NearObstacles::has_budget_to_correct)
    }

    /// [`path_check::check`] from each origin.
    fn check(&self, guard: &ClearanceGuard<'_>, rates: &BendRates) -> Result<(), f64> {
        self.iter().for_each(NearObstacles::clear_violation);
        // The commanded configuration is that of the motors, which have no play.
        let guards = [guard, &guard.without_play()];
        self.iter()
            .zip(guards)
            .try_for_each(|(near, guard)| path_check::check(near, guard, rates))
    }

    fn row_count(&self) -> u32 {
        self.iter().map(NearObstacles::row_count).sum()
    }

    fn spend(&self, cost: u32) {
        self.iter().for_each(|near| near.spend(cost));
    }

    fn are_few(&self) -> bool {
        self.iter().all(NearObstacles::are_few)
    }

    /// Violations found by the last check.
    fn violations(&self) -> [Option<Violation>; 2] {
        [0, 1].map(|k| self.0[k].and_then(NearObstacles::violation))
    }

    /// Restores the state after that check, except for the spent budget.
    fn restore(&self, violations: [Option<Violation>; 2]) {
        for (near, violation) in self.0.into_iter().zip(violations) {
            if let Some(near) = near {
                near.restore(violation);
            }
        }
    }

    fn allow_relinearisation(&self) {
        self.iter().for_each(NearObstacles::allow_relinearisation);
    }

    /// [`rows::bound_relinearised`] from each origin.
    fn bound_relinearised(
        &self,
        guard: &ClearanceGuard<'_>,
        desired_rates: &BendRates,
        around: Option<&BendRates>,
        linearisation: &Linearisation,
        region: &mut Region,
    ) {
        for near in self.iter() {
            rows::bound_relinearised(near, guard, desired_rates, around, linearisation, region);
        }
    }

    fn clear_between(&self) {
        self.iter().for_each(|near| near.note_between(None));
    }

    /// Notes the violations that the last check found between the ends of the path.
    fn note_between(&self, guard: &ClearanceGuard<'_>, rates: &BendRates) {
        let ends_s = near::ends_s(guard, rates);
        for near in self.iter() {
            near.note_between(
                near.violation()
                    .filter(|violation| !ends_s.contains(&violation.path_s)),
            );
        }
    }

    /// [`rows::bound`] from each origin. Returns whether any row was found.
    fn bound(&self, guard: &ClearanceGuard<'_>, rates: &BendRates, region: &mut Region) -> bool {
        let is_bounded = |near: &NearObstacles<'_>| rows::bound(near, guard, rates, &mut *region);
        self.iter()
            .map(is_bounded)
            .fold(false, |any, one| any | one)
    }
}

/// The rates with the faster component; `one` if both are equally fast.
fn faster(one: BendRates, other: BendRates) -> BendRates {
    if fastest(&one) < fastest(&other) {
        other
    } else {
        one
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]
mod tests;
