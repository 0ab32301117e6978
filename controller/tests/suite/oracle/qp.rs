//! The oracle's command: the rates nearest to the desired ones, with linear limits and clearances.

use super::body::{Arc, arcs};
use super::moment::Moment;
use super::rule::{Stopping, Way, fastest, moved, norm, strokes_m};

/// Number of linearisations, each at the previous solution.
const PASSES: u32 = 4;
/// Sweeps of Hildreth's method.
const SWEEPS: u32 = 300;
/// Step of the numerical differences (rad).
const STEP_RAD: f64 = 1e-4;
/// Margin of a solution inside each linear bound of a clearance, so that it may satisfy the exact one (m).
const BEYOND_M: f64 = 1e-7;
/// Largest error of a clearance for the linearisation (m).
const WITHIN_M: f64 = 1e-9;
/// Number of fastest components tried, each a fixed share of the one before.
const SLOWER: i32 = 24;
const LESS: f64 = 0.9;
/// Margin of a nearest command inside its linear limits, in rad/s and m/s, so that it satisfies them to the
/// bit.
const INSIDE: f64 = 1e-10;
/// Smallest share of the desired rates that counts as motion.
const LEAST: f64 = 0.05;
/// Shares of a solution to try.
const SHARES: [f64; 6] = [1.0, 0.999, 0.95, 0.7, 0.4, 0.2];

/// A motion that satisfies every rule.
pub(super) enum Motion {
    /// Without tolerances: every clearance is kept at the ends, and within 1 mm in between.
    Sure(Vec<f64>),
    /// Only with rounding, or with the tolerance for the motion of obstacles in a period, which a guard does
    /// not check in between.
    Unsure,
}

/// normal · rates ≥ bound.
#[derive(Debug)]
struct RuleRow {
    normal: Vec<f64>,
    bound: f64,
}

impl RuleRow {
    fn axis(i: usize, dimensions: usize, sign: f64, bound: f64) -> Self {
        let mut normal = vec![0.0; dimensions];
        normal[i] = sign;
        Self { normal, bound }
    }

    /// Whether rates with components up to this value can violate the row.
    fn can_bound(&self, fastest_rad_s: f64) -> bool {
        let most: f64 = self.normal.iter().map(|n| fastest_rad_s * n.abs()).sum();
        -most < self.bound
    }
}

/// The point nearest to `desired_rates` inside all rows, by Hildreth's method: each multiplier in turn is set
/// to the value that its row alone requires.
fn nearest(desired_rates: &[f64], rows: &[RuleRow]) -> Vec<f64> {
    let mut at = desired_rates.to_vec();
    let mut multipliers = vec![0.0_f64; rows.len()];
    for _ in 0..SWEEPS {
        let mut changed = 0.0_f64;
        for (row, multiplier) in rows.iter().zip(&mut multipliers) {
            let square = row.normal.iter().map(|n| n * n).sum::<f64>();
            if square < 1e-20 {
                continue;
            }
            let inside: f64 = row.normal.iter().zip(&at).map(|(n, x)| n * x).sum();
            let step = (-*multiplier).max((row.bound - inside) / square);
            *multiplier += step;
            for (x, n) in at.iter_mut().zip(&row.normal) {
                *x += step * n;
            }
            changed = changed.max(step.abs() * square.sqrt());
        }
        if changed < 1e-12 {
            break;
        }
    }
    at
}

impl Moment {
    /// The rates nearest to the desired ones inside the linear limits, without obstacles.
    pub(super) fn limited_rates(&self) -> Vec<f64> {
        self.slower_rates(f64::INFINITY, 0.0)
    }

    /// Candidates for the nearest rates inside the limits: with decreasing fastest components, each with its
    /// own stopping path.
    pub(super) fn limited_candidates(&self) -> Vec<Vec<f64>> {
        let has_ways = self.deceleration_rad_s2.is_finite();
        let scanned = if has_ways { SLOWER } else { 1 };
        let desired_rad_s = fastest(&self.desired_rates);
        let slower = (0..scanned).map(|step| desired_rad_s * LESS.powi(step));
        slower
            .map(|most_rad_s| self.slower_rates(most_rad_s, INSIDE))
            .collect()
    }

    /// The nearest rates with components up to this value and its stopping path, at this margin inside every
    /// limit.
    fn slower_rates(&self, most_rad_s: f64, inside: f64) -> Vec<f64> {
        let way_rad_s = most_rad_s.min(fastest(&self.desired_rates));
        let mut rows = self.limit_rows(&self.desired_rates, most_rad_s, way_rad_s);
        for row in &mut rows {
            row.bound += inside;
        }
        nearest(&self.desired_rates, &rows)
    }

    /// Rates of at least [`LEAST`] of the first of `desired` that satisfy every rule and are nearer to each of
    /// `desired` than rest is, if the quadratic program finds some.
    pub(super) fn way_out(&self, desired: &[&[f64]; 2]) -> Option<Motion> {
        let desired_rates = desired[0];
        let mut found = None;
        let mut rates = vec![0.0; desired_rates.len()];
        for _ in 0..PASSES {
            let way_rad_s = fastest(&self.desired_rates);
            let mut rows = self.limit_rows(&rates, fastest(desired_rates), way_rad_s);
            rows.extend(self.clearance_rows(&rates));
            rows.retain(|row| row.can_bound(fastest(desired_rates)));
            let nearest = nearest(desired_rates, &rows);
            let change = moved(&nearest, &rates, -1.0);
            rates = nearest;
            if norm(&rates) < LEAST * norm(desired_rates)
                || norm(&change) < 1e-6 * norm(desired_rates)
            {
                break;
            }
            for share in SHARES {
                let candidate = rates.iter().map(|rate| share * rate).collect::<Vec<_>>();
                // Sweeps that end early can give rates that are farther from the desired ones than rest is.
                let is_nearer = desired
                    .iter()
                    .all(|desired| norm(&moved(&candidate, desired, -1.0)) < norm(desired));
                if is_nearer
                    && norm(&candidate) >= LEAST * norm(desired_rates)
                    && self.hold(&candidate)
                {
                    if self.hold_surely(&candidate) {
                        return Some(Motion::Sure(candidate));
                    }
                    found = Some(Motion::Unsure);
                }
            }
        }
        found
    }

    /// Limits of rates up to `fastest_rad_s`, with the stopping path for a fastest component of `way_rad_s`.
    fn limit_rows(&self, near: &[f64], fastest_rad_s: f64, way_rad_s: f64) -> Vec<RuleRow> {
        let dimensions = self.desired_rates.len();
        let grows_rad_s = self.acceleration_rad_s2 * self.period_s;
        let mut rows = Vec::new();
        for (i, previous) in self.previous.iter().enumerate() {
            let most = self.parameters.sections[i / 2]
                .rate_max_rad_s
                .min(fastest_rad_s);
            let lower = (previous.min(0.0) - grows_rad_s).max(-most);
            let upper = (previous.max(0.0) + grows_rad_s).min(most);
            rows.push(RuleRow::axis(i, dimensions, 1.0, lower));
            rows.push(RuleRow::axis(i, dimensions, -1.0, -upper));
        }
        let unit = |i| RuleRow::axis(i, dimensions, 1.0, 0.0).normal;
        let columns: Vec<Vec<f64>> = (0..dimensions)
            .map(|i| strokes_m(&self.parameters, &unit(i)))
            .collect();
        let stopping = Stopping::new(self, &[way_rad_s]);
        let way_s = stopping.way_s(stopping.end_s());
        let max_m = self.parameters.cable_stroke_max_m;
        for place in self.places() {
            for (cable, stroke_m) in strokes_m(&self.parameters, place).iter().enumerate() {
                let fastest_m_s = self.parameters.cable_speed_max_m_s;
                for sign in [1.0, -1.0] {
                    let room_m = (max_m - sign * stroke_m).max(0.0);
                    rows.push(RuleRow {
                        normal: columns.iter().map(|column| -sign * column[cable]).collect(),
                        bound: -(room_m / way_s).min(fastest_m_s),
                    });
                }
            }
            let target = moved(place, near, way_s);
            for (j, section) in self.parameters.sections.iter().enumerate() {
                let (bend, target) = (&place[2 * j..2 * j + 2], &target[2 * j..2 * j + 2]);
                let most_rad = section.bend_max_rad.max(norm(bend));
                let size_rad = norm(target);
                if size_rad > 0.5 * most_rad {
                    let outwards = [target[0] / size_rad, target[1] / size_rad];
                    let bent_rad = outwards[0] * bend[0] + outwards[1] * bend[1];
                    let mut normal = vec![0.0; dimensions];
                    normal[2 * j] = -outwards[0];
                    normal[2 * j + 1] = -outwards[1];
                    rows.push(RuleRow {
                        normal,
                        bound: -(most_rad - bent_rad) / way_s,
                    });
                }
            }
        }
        rows
    }

    /// The clearances after the period and at rest, linearised by finite differences at these rates.
    fn clearance_rows(&self, near: &[f64]) -> Vec<RuleRow> {
        let mut rows = Vec::new();
        for place in self.places() {
            // All obstacles that the desired rates could approach.
            let way = Way::new(self, place, &self.desired_rates);
            for time_s in [self.period_s, way.stopping.end_s()] {
                let way_s = way.stopping.way_s(time_s);
                let there = moved(place, near, way_s);
                let body = arcs(&self.parameters, &there);
                let beside = |step_rad: f64| -> Vec<Vec<Arc>> {
                    let bent = (0..near.len()).map(|i| {
                        let mut bent = there.clone();
                        bent[i] += step_rad;
                        arcs(&self.parameters, &bent)
                    });
                    bent.collect()
                };
                let (less, more) = (beside(-STEP_RAD), beside(STEP_RAD));
                for pair in &way.pairs {
                    let (j, ball) = (pair.section, pair.ball.after(time_s));
                    let (clearance_m, s_m) = body[j].nearest_m(&ball, f64::INFINITY, WITHIN_M);
                    let left_m = clearance_m - way.floor_m(pair, &ball);
                    let slope = |(less, more): (&Vec<Arc>, &Vec<Arc>)| {
                        let [less_m, more_m] =
                            [less, more].map(|body| body[j].clearance_at_m(&ball, s_m));
                        way_s * (more_m - less_m) / (2.0 * STEP_RAD)
                    };
                    let normal: Vec<f64> = less.iter().zip(&more).map(slope).collect();
                    let along: f64 = normal.iter().zip(near).map(|(n, rate)| n * rate).sum();
                    rows.push(RuleRow {
                        bound: along - left_m + BEYOND_M,
                        normal,
                    });
                }
            }
        }
        rows
    }
}
