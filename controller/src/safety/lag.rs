//! Correction of a safe command for motors that lag: they average the commanded path, and so lead the body
//! past its corners.

use core::array::from_fn;

use super::clearance::{DIP_M, fastest, scaled_by};
use super::{Lag, SafeCommand, Situation};
use crate::robot::{BendRates, Body, Configuration, Obstacle, Robot, SECTIONS_MAX};

/// Points that are checked between the ends of a line.
const POINTS: usize = 3;
/// Bisection steps of the scaling.
const SCALES: u32 = 6;

/// The straight lines in the bends from the present body to the ends of a command: the body moves between
/// these lines and the commanded path.
pub(super) struct LagLines<'a> {
    situation: &'a Situation<'a>,
    lag: Lag<'a>,
    /// The body on the line that it follows if the robot is commanded to rest.
    resting: [Body; POINTS],
    /// Clearance that is always sufficient \[m\].
    cutoff_m: f64,
}

impl<'a> LagLines<'a> {
    /// `None` if the robot is where its commands lead, or without obstacles.
    pub(super) fn new(situation: &'a Situation<'a>) -> Option<Self> {
        let lag = situation.lag.filter(|lag| lag.present != situation.at)?;
        if situation.obstacles.is_empty() {
            return None;
        }
        Some(Self {
            situation,
            lag,
            resting: bodies_between(situation.robot, lag.present, situation.at),
            cutoff_m: situation.safe_distance_m - DIP_M,
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

    /// Whether no section comes closer to an obstacle on the lines than D - 1 mm, or, if it does at rest,
    /// closer than at rest.
    pub(super) fn holds(&self, rates: &BendRates) -> bool {
        let Situation { at, period_s, .. } = *self.situation;
        let end_s = self.situation.stopping().path(fastest(rates)).path_s;
        let is_clear = |end_s: f64| self.is_clear(&at.advanced(rates, end_s));
        fastest(rates) == 0.0 || is_clear(end_s) && is_clear(period_s)
    }

    fn is_clear(&self, end: &Configuration) -> bool {
        let bodies = bodies_between(self.situation.robot, self.lag.present, end);
        let reach_m = [self.cutoff_m; SECTIONS_MAX];
        self.situation.obstacles.iter().all(|obstacle| {
            bodies.iter().enumerate().all(|(point, body)| {
                let obstacle = self.obstacle_at(point, obstacle);
                let clearances_m = body.clearances_below(&obstacle, &reach_m, self.cutoff_m);
                let mut sections = clearances_m.iter().enumerate();
                sections.all(|(section, clearance_m)| {
                    *clearance_m >= self.cutoff_m
                        || *clearance_m >= self.resting_m(section, &obstacle)
                })
            })
        })
    }

    /// The obstacle at the time when the body passes this point.
    fn obstacle_at(&self, point: usize, obstacle: &Obstacle) -> Obstacle {
        obstacle.moved((share(point) - 1.0) * self.lag.lead_s)
    }

    /// Least clearance of a section if the robot is commanded to rest \[m\].
    fn resting_m(&self, section: usize, obstacle: &Obstacle) -> f64 {
        let bodies = self.resting.iter();
        let clearances_m = bodies.map(|body| body.clearance_of(section, obstacle));
        clearances_m.fold(f64::INFINITY, f64::min)
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
