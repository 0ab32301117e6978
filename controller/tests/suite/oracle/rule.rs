//! The oracle's version of the rule for a command and its stopping path.

use core::f64::consts::TAU;

use cdcr_controller::robot::RobotParameters;
use nalgebra::Vector3;

use super::body::{Arc, Ball, arcs, travel_m};
use super::moment::Moment;

/// Allowed difference between crate and oracle, in m, rad, m/s and rad/s: the accuracy that the crate states
/// for distances.
pub(super) const ROUNDING: f64 = 1e-9;
/// Violation that is not checked between the places where the rule applies exactly (m).
pub(super) const DIP_M: f64 = 1e-3;
/// Largest error of a clearance (m): where the rule applies exactly, and on the path between.
const EXACT_M: f64 = 1e-10;
const COARSE_M: f64 = 1e-6;
/// Largest number of halvings of a time span before its middle represents it.
const HALVINGS: u32 = 14;

/// Margins of a command: a rule is violated below -[`ROUNDING`].
#[derive(Debug, Clone, Copy)]
pub(super) struct Margins {
    /// Margins to the limits of rates and acceleration (rad/s), cable speeds (m/s), bends (rad) and strokes
    /// (m).
    pub(super) rate: f64,
    pub(super) cable_speed: f64,
    pub(super) bend: f64,
    pub(super) stroke: f64,
    /// Margins of the clearances over the required ones (m): after the period,
    pub(super) period: f64,
    /// on the whole path to rest, with a tolerance of 1 mm and the motion of an obstacle in a period,
    pub(super) way: f64,
    /// and at rest.
    pub(super) rest: f64,
}

impl Margins {
    pub(super) const ALL: Self = Self {
        rate: f64::INFINITY,
        cable_speed: f64::INFINITY,
        bend: f64::INFINITY,
        stroke: f64::INFINITY,
        period: f64::INFINITY,
        way: f64::INFINITY,
        rest: f64::INFINITY,
    };

    /// The smaller of each margin.
    pub(super) fn least(self, other: Self) -> Self {
        Self {
            rate: self.rate.min(other.rate),
            cable_speed: self.cable_speed.min(other.cable_speed),
            bend: self.bend.min(other.bend),
            stroke: self.stroke.min(other.stroke),
            period: self.period.min(other.period),
            way: self.way.min(other.way),
            rest: self.rest.min(other.rest),
        }
    }

    /// The margins that rules bound.
    pub(super) fn rules(&self) -> [f64; 7] {
        [
            self.rate,
            self.cable_speed,
            self.bend,
            self.stroke,
            self.period,
            self.way,
            self.rest,
        ]
    }

    /// Whether every rule is satisfied.
    pub(super) fn hold(&self) -> bool {
        self.rules().iter().all(|margin| *margin >= -ROUNDING)
    }
}

/// How the robot comes to rest without a further command: it executes this one for a time, and then all rates
/// decrease together, linearly in time.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stopping {
    moving_s: f64,
    ramp_s: f64,
}

impl Stopping {
    pub(super) fn new(moment: &Moment, rates: &[f64]) -> Self {
        Self {
            moving_s: moment.moving_s,
            ramp_s: fastest(rates) / moment.deceleration_rad_s2,
        }
    }

    /// Time of rest (s).
    pub(super) fn end_s(self) -> f64 {
        self.moving_s + self.ramp_s
    }

    /// Factor of the rates in the change of the bends up to a time (s).
    pub(super) fn way_s(self, time_s: f64) -> f64 {
        let ramp_s = (time_s - self.moving_s).clamp(0.0, self.ramp_s);
        let lost_s = if ramp_s > 0.0 {
            0.5 * ramp_s * ramp_s / self.ramp_s
        } else {
            0.0
        };
        time_s.min(self.moving_s) + ramp_s - lost_s
    }

    /// The remaining share of the rates at a time (s).
    pub(super) fn share(self, time_s: f64) -> f64 {
        let ramp_s = (time_s - self.moving_s).max(0.0);
        if ramp_s > 0.0 {
            (1.0 - ramp_s / self.ramp_s).max(0.0)
        } else {
            1.0
        }
    }
}

pub(super) fn norm(values: &[f64]) -> f64 {
    values.iter().map(|value| value * value).sum::<f64>().sqrt()
}

pub(super) fn fastest(rates: &[f64]) -> f64 {
    rates.iter().fold(0.0, |most, rate| rate.abs().max(most))
}

pub(super) fn moved(at: &[f64], rates: &[f64], way_s: f64) -> Vec<f64> {
    at.iter()
        .zip(rates)
        .map(|(at, rate)| at + way_s * rate)
        .collect()
}

/// Stroke of each cable for these bends (m), or its speed for their rates (m/s). A cable at the angle β
/// around the backbone, at the radius r, is shorter by r θ cos(β - φ) in each section that it passes.
pub(super) fn strokes_m(parameters: &RobotParameters, bends: &[f64]) -> Vec<f64> {
    let mut strokes_m = Vec::new();
    for (j, ends) in parameters.sections.iter().enumerate() {
        for cable in 0..3 {
            let angle = TAU * f64::from(cable) / 3.0 + ends.cable_offset_rad;
            let passed = parameters.sections[..=j].iter().zip(bends.chunks(2));
            let shorter = passed.map(|(section, bend)| {
                let (size, direction) = (bend[0].hypot(bend[1]), bend[1].atan2(bend[0]));
                section.cable_radius_m * size * (angle - direction).cos()
            });
            strokes_m.push(-shorter.sum::<f64>());
        }
    }
    strokes_m
}

impl Moment {
    /// Margins of these rates.
    pub(super) fn margins(&self, rates: &[f64]) -> Margins {
        let places = self.places();
        let clearances = places.map(|place| self.clearances(place, rates));
        clearances.fold(self.limits(rates), Margins::least)
    }

    /// Whether these rates satisfy every rule.
    pub(super) fn hold(&self, rates: &[f64]) -> bool {
        let mut places = self.places();
        self.limits(rates).hold() && places.all(|place| self.clearances(place, rates).hold())
    }

    /// Whether these rates satisfy every limit, and every clearance without tolerances for rounding and
    /// moving obstacles.
    pub(super) fn hold_surely(&self, rates: &[f64]) -> bool {
        let mut places = self.places();
        self.limits(rates).hold()
            && places.all(|place| {
                let way = Way::new(self, place, rates).keeps_between_looks();
                let margins = self.clearances_along(&way);
                let clearances_m = [margins.period, margins.way, margins.rest];
                clearances_m.iter().all(|margin_m| *margin_m >= 0.0)
            })
    }

    /// Whether these rates satisfy every limit to the bit and are not faster than desired.
    pub(super) fn is_inside(&self, rates: &[f64]) -> bool {
        let slower = fastest(rates) <= fastest(&self.desired_rates);
        slower
            && self
                .limits(rates)
                .rules()
                .iter()
                .all(|margin| *margin >= 0.0)
    }

    /// Present distance from the body to the nearest obstacle (m).
    pub(super) fn clearance_m(&self) -> f64 {
        let mut least_m = f64::INFINITY;
        for arc in arcs(&self.parameters, &self.at) {
            for ball in &self.balls {
                least_m = least_m.min(arc.nearest_m(ball, least_m, EXACT_M).0);
            }
        }
        least_m
    }

    fn limits(&self, rates: &[f64]) -> Margins {
        let mut margins = Margins::ALL;
        let grows_rad_s = self.acceleration_rad_s2 * self.period_s;
        for (i, (rate, previous)) in rates.iter().zip(&self.previous).enumerate() {
            let most_rad_s = self.parameters.sections[i / 2].rate_max_rad_s;
            margins.rate = margins.rate.min(most_rad_s - rate.abs());
            let left_rad_s = if self.comes_to_rest {
                let towards = self.desired_rates[i].signum();
                (rate * towards).min(self.desired_rates[i].abs() - rate * towards)
            } else {
                let above = previous.max(0.0) + grows_rad_s - rate;
                above.min(rate - previous.min(0.0) + grows_rad_s)
            };
            margins.rate = margins.rate.min(left_rad_s);
        }
        for speed_m_s in strokes_m(&self.parameters, rates) {
            let left_m_s = self.parameters.cable_speed_max_m_s - speed_m_s.abs();
            margins.cable_speed = margins.cable_speed.min(left_m_s);
        }
        let stopping = Stopping::new(self, rates);
        for place in self.places() {
            let next = moved(place, rates, stopping.way_s(stopping.end_s()));
            for ((bend, next), section) in place
                .chunks(2)
                .zip(next.chunks(2))
                .zip(&self.parameters.sections)
            {
                let most_rad = section.bend_max_rad.max(norm(bend));
                margins.bend = margins.bend.min(most_rad - norm(next));
            }
            let [strokes_m, next_m] = [place, &next].map(|at| strokes_m(&self.parameters, at));
            let max_m = self.parameters.cable_stroke_max_m;
            for (stroke_m, next_m) in strokes_m.iter().zip(next_m) {
                let left_m = (stroke_m.max(max_m) - next_m).min(next_m - stroke_m.min(-max_m));
                margins.stroke = margins.stroke.min(left_m);
            }
        }
        margins
    }

    /// Margins of the clearances from one configuration on.
    fn clearances(&self, place: &[f64], rates: &[f64]) -> Margins {
        self.clearances_along(&Way::new(self, place, rates))
    }

    fn clearances_along(&self, way: &Way<'_>) -> Margins {
        let end_s = way.stopping.end_s();
        let least_m = |time_s, within_m| {
            let spares_m = way.spares_m(&way.pairs, time_s, 0.0, within_m);
            spares_m.into_iter().fold(f64::INFINITY, f64::min)
        };
        let mut margins = Margins {
            period: least_m(self.period_s, EXACT_M),
            ..Margins::ALL
        };
        if margins.hold() {
            margins.rest = least_m(end_s, EXACT_M);
            way.descend([0.0, end_s], way.pairs.clone(), HALVINGS, &mut margins.way);
        }
        margins
    }

    fn thinnest_m(&self) -> f64 {
        let sections = self.parameters.sections.iter();
        sections.fold(f64::INFINITY, |least, s| least.min(s.body_radius_m))
    }
}

/// A section and an obstacle that can approach each other.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pair {
    pub(super) section: usize,
    pub(super) ball: Ball,
    /// The section of the resting robot.
    still: Arc,
    /// Required clearance, also while the obstacle rests (m).
    floor_m: f64,
    /// Tolerance between the places where the rule applies exactly (m), without and with the motion of the
    /// obstacle in a period.
    dip_m: f64,
    may_lack_m: f64,
    /// Largest rate of change of the margin (m/s).
    fastest_m_s: f64,
}

/// The motion from one place to rest at these rates.
pub(super) struct Way<'a> {
    moment: &'a Moment,
    place: &'a [f64],
    rates: &'a [f64],
    pub(super) stopping: Stopping,
    pub(super) pairs: Vec<Pair>,
}

impl<'a> Way<'a> {
    pub(super) fn new(moment: &'a Moment, place: &'a [f64], rates: &'a [f64]) -> Self {
        let stopping = Stopping::new(moment, rates);
        let end_s = stopping.end_s();
        let speeds_m_s = travel_m(&moment.parameters, rates);
        let still = arcs(&moment.parameters, place);
        let mut pairs = Vec::new();
        for ball in &moment.balls {
            let ball_m_s = ball.velocity_m_s.norm();
            let dip_m = DIP_M.min(0.5 * (moment.safe_m + moment.thinnest_m() + ball.radius_m));
            // A ramp may continue along the path of the previous command, where the tolerance applies.
            let goes_on = moment.comes_to_rest && ball_m_s == 0.0;
            let lacks_m = if goes_on { dip_m + COARSE_M } else { 0.0 };
            let keeps_m = moment.safe_m - lacks_m;
            for (section, (still, speed_m_s)) in still.iter().zip(&speeds_m_s).enumerate() {
                // If the obstacle moves, the clearance of the resting robot changes, too.
                let fastest_m_s = speed_m_s + 2.0 * ball_m_s;
                // `DIP_M` covers the coarse tolerance of the distance.
                let near_m = moment.safe_m + fastest_m_s * end_s + DIP_M;
                if still.nearest_m(ball, near_m, DIP_M).0 < near_m {
                    let (clearance_m, _) = still.nearest_m(ball, keeps_m, EXACT_M);
                    pairs.push(Pair {
                        section,
                        ball: *ball,
                        still: *still,
                        floor_m: clearance_m.min(keeps_m),
                        dip_m,
                        may_lack_m: dip_m + moment.period_s * ball_m_s,
                        fastest_m_s,
                    });
                }
            }
        }
        Self {
            moment,
            place,
            rates,
            stopping,
            pairs,
        }
    }

    /// The same without the tolerance for the motion of an obstacle in a period.
    fn keeps_between_looks(mut self) -> Self {
        for pair in &mut self.pairs {
            pair.may_lack_m = pair.dip_m;
        }
        self
    }

    /// Margins of the clearances at a time (m), one for each pair, at most `within_m` too large. Margins that
    /// no pair can lose within `ahead_s` (s) need not be accurate.
    fn spares_m(&self, pairs: &[Pair], time_s: f64, ahead_s: f64, within_m: f64) -> Vec<f64> {
        let there = moved(self.place, self.rates, self.stopping.way_s(time_s));
        let body = arcs(&self.moment.parameters, &there);
        let spare_m = |pair: &Pair| {
            let ball = pair.ball.after(time_s);
            let cutoff_m = self.moment.safe_m + pair.fastest_m_s * ahead_s;
            let (clearance_m, _) = body[pair.section].nearest_m(&ball, cutoff_m, within_m);
            clearance_m - self.floor_m(pair, &ball)
        };
        pairs.iter().map(spare_m).collect()
    }

    /// Smallest margin at a time (s), with the tolerance between (m).
    pub(super) fn left_m(&self, time_s: f64) -> f64 {
        let spares_m = self.spares_m(&self.pairs, time_s, 0.0, EXACT_M);
        let left_m = spares_m.iter().zip(&self.pairs);
        left_m.fold(f64::INFINITY, |least, (spare_m, pair)| {
            least.min(spare_m + pair.may_lack_m)
        })
    }

    /// Required clearance of a section to an obstacle at the position `ball` (m).
    pub(super) fn floor_m(&self, pair: &Pair, ball: &Ball) -> f64 {
        if pair.ball.velocity_m_s == Vector3::zeros() {
            return pair.floor_m;
        }
        let safe_m = self.moment.safe_m;
        let (clearance_m, _) = pair.still.nearest_m(ball, safe_m, EXACT_M);
        clearance_m.min(safe_m)
    }

    /// Lowers `least_m` to the smallest margin between two times, with the tolerance. Pairs that cannot fall
    /// below half of the tolerance, or below `least_m`, are skipped.
    fn descend(&self, span_s: [f64; 2], open: Vec<Pair>, halvings: u32, least_m: &mut f64) {
        if open.is_empty() || *least_m < -ROUNDING {
            return;
        }
        let middle_s = 0.5 * (span_s[0] + span_s[1]);
        let ahead_s = 0.5 * (span_s[1] - span_s[0]);
        let spares_m = self.spares_m(&open, middle_s, ahead_s, COARSE_M);
        let mut unsettled = Vec::new();
        for (pair, spare_m) in open.into_iter().zip(spares_m) {
            *least_m = least_m.min(spare_m + pair.may_lack_m);
            let lowest_m = spare_m - pair.fastest_m_s * ahead_s;
            if lowest_m < -0.5 * pair.may_lack_m && lowest_m + pair.may_lack_m < *least_m {
                unsettled.push(pair);
            }
        }
        if halvings > 0 {
            let halves_s = [[span_s[0], middle_s], [middle_s, span_s[1]]];
            self.descend(halves_s[0], unsettled.clone(), halvings - 1, least_m);
            self.descend(halves_s[1], unsettled, halvings - 1, least_m);
        }
    }
}
