//! Correction of a safe command for motors that lag: they average the commanded path, and so lead the body
//! past its corners.

use core::array::from_fn;
use core::cell::{Cell, OnceCell};

use super::clearance::{
    NEAR_MAX, POINT_COST, REGION_COST, ROW_COST, SOLVE_COST, clearance_cost, dip_m, thinnest_m,
};
use super::projection::Region;
use super::situation::{Lag, SafeCommand, Situation};
use super::stopping::{fastest, scaled_by, shortened_to};
use crate::robot::{
    BendRates, Body, COORDINATES_MAX, Configuration, Nearest, Obstacle, Robot, SECTIONS_MAX,
};

/// Points that are checked between the ends of a line.
const POINTS: usize = 7;
/// Corrections of one command before it is scaled down instead.
const CORRECTIONS: u32 = 8;
/// Extra clearance that a correction asks for \[m\], so that rounding does not undo it.
const EXTRA_M: f64 = 1e-8;
/// Bisection steps of the scaling.
const SCALES: u32 = 5;
/// Work budget of one command, in exact clearances of a section from a sphere. When it is spent, a line counts as
/// violated.
const WORK_BUDGET: u32 = 5_000;
/// Part of it that is left to scale a command down after corrections.
const SCALING_BUDGET: u32 = WORK_BUDGET / 3;
/// Share of the clearance guard's dip that is used at the points: between them the body may be nearer.
const DIP_SHARE: f64 = 0.75;

/// The straight lines in the bends from the body at the end of the motors' delay to the ends of a command, each point at
/// the time at which the body is there. Seen from an obstacle that moves at its velocity, the body moves between these
/// lines and the commanded path.
pub(super) struct LagLines<'a> {
    situation: &'a Situation<'a>,
    lag: Lag<'a>,
    /// The line on which the commands so far lead the body to rest; few commands need it.
    resting: OnceCell<[Point; POINTS + 1]>,
    thinnest_m: f64,
    /// Sections that come near to each of the first obstacles, a bit each; all of them to any other.
    near: [u8; NEAR_MAX],
    /// Clearance that each section keeps from each of them \[m\]; NaN if unknown.
    floor_m: [[Cell<f64>; SECTIONS_MAX]; NEAR_MAX],
    work_left: Cell<u32>,
}

/// A point of a line.
struct Point {
    at: Configuration,
    body: Body,
    /// Place on the line, from 0 to 1.
    share: f64,
    /// Time, from that of [`Situation::obstacles`], at which the body is there \[s\].
    after_s: f64,
}

/// A section that is nearer to an obstacle than its floor.
struct SectionTooNear<'a> {
    point: &'a Point,
    section: usize,
    obstacle: Obstacle,
    floor_m: f64,
    /// The length of the line as a duration of the rates \[s\].
    path_s: f64,
}

impl<'a> LagLines<'a> {
    /// For commands that are not faster than `rates`. `None` without a lag, or with nothing near.
    pub(super) fn new(situation: &'a Situation<'a>, rates: &BendRates) -> Option<Self> {
        let is_behind = |lag: &Lag<'_>| lag.time_constant_s > 0.0 && lag.delayed != situation.at;
        let lag = situation.lag.filter(is_behind)?;
        if situation.obstacles.is_empty() {
            return None;
        }
        let (robot, at) = (situation.robot, situation.at);
        let path = situation.stopping().path(fastest(rates));
        let mut behind_rad = [0.0; SECTIONS_MAX];
        for (j, behind_rad) in behind_rad
            .iter_mut()
            .enumerate()
            .take(robot.section_count())
        {
            let ([u, v], [at_u, at_v]) = (lag.delayed.section(j), at.section(j));
            *behind_rad = (at_u - u).hypot(at_v - v);
        }
        let (behind_m, ahead_m) = (
            robot.travel_m(&behind_rad),
            situation.guard().farthest_m(rates),
        );
        let moving_s = lag.time_constant_s + path.time_s(path.path_s);
        let arrived = robot.body(at);
        let mut near = [0; NEAR_MAX];
        for (near, obstacle) in near.iter_mut().zip(situation.obstacles) {
            let own_m = situation.safe_distance_m + moving_s * obstacle.velocity_m_s().norm();
            let reach_m = from_fn(|j| behind_m[j] + ahead_m[j] + own_m);
            *near = arrived.sections_in_reach(obstacle, &reach_m);
        }
        let is_any_near = near != [0; NEAR_MAX] || situation.obstacles.len() > NEAR_MAX;
        is_any_near.then(|| Self {
            situation,
            lag,
            resting: OnceCell::new(),
            thinnest_m: thinnest_m(robot),
            near,
            floor_m: [const { [const { Cell::new(f64::NAN) }; SECTIONS_MAX] }; NEAR_MAX],
            work_left: Cell::new(WORK_BUDGET),
        })
    }

    /// `safe` if it satisfies the rule; otherwise rates near to it that do, no faster than `fastest_rad_s`; otherwise
    /// `safe`, scaled down until it does.
    pub(super) fn kept(&self, safe: SafeCommand, fastest_rad_s: f64) -> SafeCommand {
        if self.holds(&safe.rates) {
            return safe;
        }
        if let Some(corrected) = self.corrected(&safe, fastest_rad_s) {
            return corrected;
        }
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..SCALES {
            let middle = 0.5 * (low + high);
            if self.holds(&scaled_by(&safe.rates, middle)) {
                low = middle;
            } else {
                high = middle;
            }
        }
        self.repaired(&safe, &scaled_by(&safe.rates, low))
    }

    /// The rates nearest to those of `safe` in the half-spaces of all violations found on the way, if they are not rest.
    fn corrected(&self, safe: &SafeCommand, fastest_rad_s: f64) -> Option<SafeCommand> {
        let limits = self.situation.limits_moving(fastest_rad_s);
        let mut region = Region::EMPTY;
        limits.fill(&mut region, fastest_rad_s);
        let mut rates = safe.rates;
        for _ in 0..CORRECTIONS {
            if !self.bound(&rates, &mut region) {
                let repaired = self.repaired(safe, &rates);
                return (fastest(&repaired.rates) > 0.0).then_some(repaired);
            }
            if region.is_full() || self.work_left.get() < SCALING_BUDGET {
                break;
            }
            let nearest = limits.nearest_in(&mut region, &safe.rates);
            self.spend(REGION_COST + region.take_products());
            rates = shortened_to(nearest?, fastest_rad_s);
        }
        None
    }

    /// `rates` in place of `safe`, inside limits and guard.
    fn repaired(&self, safe: &SafeCommand, rates: &BendRates) -> SafeCommand {
        self.situation
            .repaired(safe, rates, |rates| self.holds(rates))
    }

    /// Bounds `region` by the linearised clearances that these rates violate. Returns whether there are any; true when
    /// the work budget is spent.
    fn bound(&self, rates: &BendRates, region: &mut Region) -> bool {
        let mut is_bound = false;
        let is_checked = self.each_violation(rates, |violation| {
            is_bound = true;
            !region.is_full() && self.spend(POINT_COST + ROW_COST + SOLVE_COST) && {
                violation.bound(self.situation.robot, rates, region);
                true
            }
        });
        is_bound || !is_checked
    }

    /// Whether each section keeps its floor at the points of the lines.
    pub(super) fn holds(&self, rates: &BendRates) -> bool {
        fastest(rates) == 0.0 || self.each_violation(rates, |_| false)
    }

    /// Calls `and_go_on` for each section below its floor, on the lines to the end of the stopping path and to that of the
    /// period, while it returns true. Returns false if it was ended, by `and_go_on` or by the work budget.
    fn each_violation(
        &self,
        rates: &BendRates,
        mut and_go_on: impl FnMut(SectionTooNear<'_>) -> bool,
    ) -> bool {
        let path_s = self.situation.stopping().path(fastest(rates)).path_s;
        let period_s = self.situation.period_s;
        let lines_s = [path_s, period_s];
        let mut lines_s = lines_s.iter().take(if period_s < path_s { 2 } else { 1 });
        lines_s.all(|&path_s| {
            if !self.spend(POINTS as u32 * POINT_COST) {
                return false;
            }
            let points: [_; POINTS] = self.line(rates, path_s);
            points.iter().all(|point| {
                let mut obstacles = self.situation.obstacles.iter().enumerate();
                obstacles.all(|(index, _)| self.keeps(point, index, path_s, &mut and_go_on))
            })
        })
    }

    /// [`Self::each_violation`] for one obstacle at one point.
    fn keeps(
        &self,
        point: &Point,
        index: usize,
        path_s: f64,
        mut and_go_on: impl FnMut(SectionTooNear<'_>) -> bool,
    ) -> bool {
        let near = self.near.get(index).copied().unwrap_or(u8::MAX);
        if near == 0 {
            return true;
        }
        if !self.spend(near.count_ones()) {
            return false;
        }
        let obstacle = self.situation.obstacles[index].moved(point.after_s);
        let enough_m = self.enough_m(&obstacle);
        let reach_m: [f64; SECTIONS_MAX] = from_fn(|j| match near >> j & 1 {
            1 => enough_m,
            _ => f64::NEG_INFINITY,
        });
        let clearances_m = point.body.clearances_below(&obstacle, &reach_m, enough_m);
        let mut sections = clearances_m.iter().enumerate();
        sections.all(|(section, clearance_m)| {
            if *clearance_m >= enough_m {
                return true;
            }
            // It is exact.
            if !self.spend(clearance_cost(&obstacle)) {
                return false;
            }
            let Some(floor_m) = self.floor_m(section, index) else {
                return false;
            };
            *clearance_m >= floor_m
                || and_go_on(SectionTooNear {
                    point,
                    section,
                    obstacle,
                    floor_m,
                    path_s,
                })
        })
    }

    /// Clearance that a section keeps from an obstacle on the lines \[m\]: D, or that of the robot at its commands, less a
    /// dip; or, if it is less, that on the line to rest. `None` when the work budget is spent.
    fn floor_m(&self, section: usize, index: usize) -> Option<f64> {
        let known = self.floor_m.get(index).map(|sections| &sections[section]);
        if let Some(floor_m) = known.map(Cell::get).filter(|floor_m| !floor_m.is_nan()) {
            return Some(floor_m);
        }
        let obstacle = &self.situation.obstacles[index];
        let count = POINTS as u32 + 1;
        let line_cost = match self.resting.get() {
            Some(_) => 0,
            None => count * POINT_COST,
        };
        if !self.spend(line_cost + count * clearance_cost(obstacle)) {
            return None;
        }
        let at_rest = BendRates::zero(self.situation.robot.section_count());
        let resting = self.resting.get_or_init(|| self.line(&at_rest, 0.0));
        let dip_m = |point: &Point| {
            if point.share < 1.0 {
                0.0
            } else {
                self.dip_m(obstacle)
            }
        };
        let kept_m = resting.iter().map(|point| {
            let obstacle = obstacle.moved(point.after_s);
            point.body.clearance_of(section, &obstacle) - dip_m(point)
        });
        let floor_m = kept_m.fold(self.enough_m(obstacle), f64::min);
        if let Some(known) = known {
            known.set(floor_m);
        }
        Some(floor_m)
    }

    /// Points of the line to the place of the command at s = `path_s`. Its end is where the commands lead; the body is
    /// there when obstacles have moved on by the time of the command, and at its beginning a time constant earlier.
    fn line<const COUNT: usize>(&self, rates: &BendRates, path_s: f64) -> [Point; COUNT] {
        let Situation { robot, at, .. } = *self.situation;
        let (begin, end) = (self.lag.delayed, at.advanced(rates, path_s));
        let path = self.situation.stopping().path(fastest(rates));
        let (lag_s, time_s) = (self.lag.time_constant_s, path.time_s(path_s));
        from_fn(|point| {
            let share = (point + 1) as f64 / (POINTS + 1) as f64;
            let mut at = *begin;
            for (bend, end) in at.as_mut_slice().iter_mut().zip(end.as_slice()) {
                *bend += share * (end - *bend);
            }
            Point {
                body: robot.body(&at),
                at,
                share,
                after_s: share * (lag_s + time_s) - lag_s,
            }
        })
    }

    /// False when the work budget is spent.
    fn spend(&self, work: u32) -> bool {
        let work_left = self.work_left.get().checked_sub(work);
        self.work_left.set(work_left.unwrap_or(0));
        work_left.is_some()
    }

    fn enough_m(&self, obstacle: &Obstacle) -> f64 {
        self.situation.safe_distance_m - self.dip_m(obstacle)
    }

    fn dip_m(&self, obstacle: &Obstacle) -> f64 {
        DIP_SHARE * dip_m(self.situation.safe_distance_m, self.thinnest_m, obstacle)
    }
}

impl SectionTooNear<'_> {
    /// Adds the half-space of rates at which the section keeps its floor, linearised at `rates`.
    fn bound(&self, robot: &Robot, rates: &BendRates, region: &mut Region) {
        let Nearest {
            s,
            direction: d,
            clearance_m,
            ..
        } = self.point.body.nearest_of(self.section, &self.obstacle);
        let mut columns = [[0.0; 3]; COORDINATES_MAX];
        let motion = robot.body_motion(&self.point.at);
        motion.point_jacobian(self.section, s, &mut columns);
        let path_s = self.point.share * self.path_s;
        let slope = columns.map(|[x, y, z]| path_s * (d.x * x + d.y * y + d.z * z));
        let gained_m: f64 = (rates.as_slice().iter().zip(slope))
            .map(|(rate, slope)| rate * slope)
            .sum();
        region.bound(&slope, gained_m + self.floor_m + EXTRA_M - clearance_m);
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::robot::{EXACT, RobotParameters, Shape};

    /// Sixty capsules beside all sections of a robot that was led away from them: each section would be compared
    /// with several others at each point.
    #[test]
    fn exact_clearances_from_capsules_stay_within_the_budget() {
        const CAPSULE_COST: u32 = 7;
        const CALLS: u32 = 5;
        let robot = Robot::new(&RobotParameters::paper(6)).unwrap();
        let at = Configuration::straight(6);
        let beside_m = robot.sections()[0].body_radius_m + 0.01;
        let capsules: Vec<_> = (0..60)
            .map(|turn| {
                let x_m = beside_m + 1e-5 * f64::from(turn);
                let [start_m, end_m] =
                    [0.0, robot.reach_m()].map(|z_m| Vector3::new(x_m, 0.0, z_m));
                let shape = Shape::Capsule { start_m, end_m };
                Obstacle::new(shape, 0.005, Vector3::zeros()).unwrap()
            })
            .collect();
        let spent = [-1.0, 1.0].map(|turn| {
            let bends: Vec<_> = (0..12)
                .map(|i| 0.02 * turn * f64::from(1 - i % 2))
                .collect();
            let delayed = Configuration::from_slice(&bends).unwrap();
            let rates: Vec<_> = bends.iter().map(|bend| -10.0 * bend).collect();
            let rates = BendRates::from_slice(&rates).unwrap();
            let situation = Situation {
                robot: &robot,
                at: &at,
                lag: Some(Lag {
                    delayed: &delayed,
                    time_constant_s: 0.1,
                }),
                commanded: None,
                slack: None,
                previous: &rates,
                obstacles: &capsules,
                safe_distance_m: 0.01,
                tip_offset_m: 0.0,
                acceleration_rad_s2: 40.0,
                period_s: 0.005,
                moving_s: 0.015,
                deceleration_rad_s2: 40.0,
                comes_to_rest: false,
            };
            let lines = LagLines::new(&situation, &rates).expect("capsules near");
            EXACT.set(0);
            for _ in 0..CALLS {
                lines.holds(&rates);
            }
            let (exact, is_spent) = (EXACT.get(), lines.work_left.get() == 0);
            println!("{turn}: {exact} exact clearances, all work spent: {is_spent}");
            // Those of one body are computed before they are charged.
            assert!(exact < WORK_BUDGET / CAPSULE_COST + CALLS * SECTIONS_MAX as u32);
            is_spent
        });
        assert!(spent.contains(&true));
    }
}
