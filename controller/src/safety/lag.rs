//! Correction of a safe command for motors that lag: they average the commanded path, and so lead the body
//! past its corners.

use core::array::from_fn;
use core::cell::{Cell, OnceCell};

use super::clearance::{NEAR_MAX, clearance_cost, dip_m, fastest, scaled_by, thinnest_m};
use super::{Lag, SafeCommand, Situation};
use crate::robot::{BendRates, Body, Configuration, Obstacle, Robot, SECTIONS_MAX};

/// Points that are checked between the ends of a line.
const POINTS: usize = 7;
/// Bisection steps of the scaling.
const SCALES: u32 = 5;
/// Work budget of one command, in exact clearances of a section from a sphere. When it is spent, a line counts as
/// violated.
const WORK_BUDGET: u32 = 12_000;
/// Share of the clearance guard's dip that is used at the points: between them the body may be nearer.
const DIP_SHARE: f64 = 0.9;

/// The straight lines in the bends from the body at the end of the motors' delay to the ends of a command: the body moves between
/// these lines and the commanded path.
pub(super) struct LagLines<'a> {
    situation: &'a Situation<'a>,
    lag: Lag<'a>,
    /// The body where the commands so far lead.
    arrived: Body,
    /// The body on the line that it follows if the robot is commanded to rest; few commands need it.
    resting: OnceCell<[Body; POINTS]>,
    thinnest_m: f64,
    /// Sections that come near to each of the first obstacles, a bit each; all of them to any other.
    near: [u8; NEAR_MAX],
    work_left: Cell<u32>,
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
        let ends = [*lag.delayed, at.advanced(rates, path.path_s)];
        let change_rad = from_fn(|j| {
            let far = ends
                .iter()
                .filter(|_| j < robot.section_count())
                .map(|end| {
                    let ([u, v], [end_u, end_v]) = (at.section(j), end.section(j));
                    (end_u - u).hypot(end_v - v)
                });
            far.fold(0.0, f64::max)
        });
        let travel_m = robot.travel_m(&change_rad);
        let arrived = robot.body(at);
        let mut near = [0; NEAR_MAX];
        for (near, obstacle) in near.iter_mut().zip(situation.obstacles) {
            let own_m =
                situation.safe_distance_m + lag.time_constant_s * obstacle.velocity_m_s().norm();
            *near = arrived.sections_in_reach(obstacle, &travel_m.map(|travel_m| travel_m + own_m));
        }
        let is_any_near = near != [0; NEAR_MAX] || situation.obstacles.len() > NEAR_MAX;
        is_any_near.then(|| Self {
            situation,
            lag,
            arrived,
            resting: OnceCell::new(),
            thinnest_m: thinnest_m(robot),
            near,
            work_left: Cell::new(WORK_BUDGET),
        })
    }

    /// `safe` if it satisfies the rule; otherwise scaled down until it does.
    pub(super) fn kept(&self, safe: SafeCommand) -> SafeCommand {
        if self.holds(&safe.rates) {
            return safe;
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
        let scaled = scaled_by(&safe.rates, low);
        self.situation
            .repaired(&safe, &scaled, |rates| self.holds(rates))
    }

    /// Whether each section keeps the floor of [`Self::keeps_floor`] at the points of the lines.
    pub(super) fn holds(&self, rates: &BendRates) -> bool {
        if fastest(rates) == 0.0 {
            return true;
        }
        let path = self.situation.stopping().path(fastest(rates));
        let period_s = self.situation.period_s;
        self.is_clear(rates, path.path_s)
            && (period_s >= path.path_s || self.is_clear(rates, period_s))
    }

    /// The same for the line to the place of the command at s = `path_s`. Obstacles are where they are when the
    /// body passes the same share of the line to rest.
    fn is_clear(&self, rates: &BendRates, path_s: f64) -> bool {
        let end = self.situation.at.advanced(rates, path_s);
        let bodies = bodies_between(self.situation.robot, self.lag.delayed, &end);
        let mut points = bodies.iter().enumerate();
        points.all(|(point, body)| {
            let after_s = (share(point) - 1.0) * self.lag.time_constant_s;
            let near = self.near.iter().copied().chain(core::iter::repeat(u8::MAX));
            let mut obstacles = self.situation.obstacles.iter().zip(near);
            obstacles.all(|(obstacle, near)| {
                near == 0 || self.keeps(body, &obstacle.moved(after_s), near)
            })
        })
    }

    /// Whether the `near` sections of the body at a point keep their floors from an obstacle at that time.
    fn keeps(&self, body: &Body, obstacle: &Obstacle, near: u8) -> bool {
        let enough_m = self.situation.safe_distance_m - self.dip_m(obstacle);
        let reach_m: [f64; SECTIONS_MAX] = from_fn(|j| match near >> j & 1 {
            1 => enough_m,
            _ => f64::NEG_INFINITY,
        });
        if !self.spend(near.count_ones()) {
            return false;
        }
        let clearances_m = body.clearances_below(obstacle, &reach_m, enough_m);
        let mut sections = clearances_m.iter().enumerate();
        sections.all(|(section, clearance_m)| {
            *clearance_m >= enough_m || self.keeps_floor(section, obstacle, *clearance_m)
        })
    }

    /// Whether a clearance (m) is no less than the one that a section keeps on the lines: D, or that of the robot at its
    /// commands, less a dip; or, if it is less, that on the line to rest.
    fn keeps_floor(&self, section: usize, obstacle: &Obstacle, clearance_m: f64) -> bool {
        let cost = clearance_cost(obstacle);
        // Its own clearance and that of the robot at its commands.
        if !self.spend(2 * cost) {
            return false;
        }
        let Situation { robot, at, .. } = *self.situation;
        let arrived_m = self.arrived.clearance_of(section, obstacle);
        if clearance_m >= arrived_m - self.dip_m(obstacle) {
            return true;
        }
        let line = || bodies_between(robot, self.lag.delayed, at);
        let mut bodies = self.resting.get_or_init(line).iter();
        bodies.any(|body| self.spend(cost) && body.clearance_of(section, obstacle) <= clearance_m)
    }

    /// False when the work budget is spent.
    fn spend(&self, work: u32) -> bool {
        let work_left = self.work_left.get().checked_sub(work);
        self.work_left.set(work_left.unwrap_or(0));
        work_left.is_some()
    }

    fn dip_m(&self, obstacle: &Obstacle) -> f64 {
        DIP_SHARE * dip_m(self.situation.safe_distance_m, self.thinnest_m, obstacle)
    }
}

/// Place of a point on its line, between 0 and 1.
fn share(point: usize) -> f64 {
    (point + 1) as f64 / (POINTS + 1) as f64
}

/// The body at the points of the straight line in the bends between two configurations.
fn bodies_between(robot: &Robot, from: &Configuration, to: &Configuration) -> [Body; POINTS] {
    from_fn(|point| {
        let mut between = *from;
        for (bend, end) in between.as_mut_slice().iter_mut().zip(to.as_slice()) {
            *bend += share(point) * (end - *bend);
        }
        robot.body(&between)
    })
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
