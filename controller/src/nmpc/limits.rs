//! Penalties over the horizon for the limits on bend, cable stroke and cable speed.
//!
//! They guide the plan; the module `safety` enforces the limits on every command. A limit that no plan in the
//! box can reach within the horizon costs nothing.

use super::motion::Motion;
use crate::optimizer::Evaluation;
use crate::robot::{COORDINATES_MAX, Robot, SECTIONS_MAX};
use crate::wide::Wide;

/// Weight of the squared excess of a bend, per rad² and position weight: an excess of 0.1 mrad costs as much
/// as a tip error of 0.1 m.
const BEND_WEIGHT: f64 = 1e6;
/// Weight of the squared excess of a cable's stroke, per m² and position weight.
const STROKE_WEIGHT: f64 = 1e10;
/// Weight of the squared excess of a cable's speed, per (m/s)² and position weight.
const SPEED_WEIGHT: f64 = 1e6;
/// Margin of the plan inside its limits, in rad, m and m/s. A soft penalty leaves a far smaller excess, so
/// that the safety check need not change the command.
const LIMIT_MARGIN: f64 = 1e-6;
/// Index of the limits among the violations.
pub(super) const LIMITS: usize = 1;

/// The limits within reach in one solve.
#[derive(Debug, Clone)]
pub(super) struct PlanLimits<'a> {
    robot: &'a Robot,
    period_s: f64,
    weight: f64,
    bend: bool,
    stroke: bool,
    speed: bool,
}

/// A linearised limit h + A Δb ≥ 0 on bend vectors, scaled to outweigh the tip error.
pub(super) struct LimitRow {
    pub h: f64,
    pub derivatives: [f64; COORDINATES_MAX],
    /// True: Δb is the change over this step; false: the change since the start of the horizon.
    pub is_step_change: bool,
}

impl<'a> PlanLimits<'a> {
    /// `fastest_rad_s` bounds the norm of each section's bend rate; `weight` is the position weight.
    pub(super) fn new(
        robot: &'a Robot,
        motion: &Motion,
        weight: f64,
        fastest_rad_s: &[f64; SECTIONS_MAX],
    ) -> Self {
        let period_s = motion.period_s();
        let horizon_s = period_s * motion.horizon().steps() as f64;
        let start = motion.start_shape();
        let bends = start.pairs();
        let sections = robot.sections().iter().zip(bends).zip(fastest_rad_s);
        let bend = sections.clone().any(|((section, [u, v]), rate)| {
            u.hypot(*v) + rate * horizon_s > section.bend_max_rad - LIMIT_MARGIN
        });
        // The last section's cables pass all sections, so their speed bounds every cable speed.
        let fastest_m_s: f64 = sections.map(|((s, _), rate)| s.cable_radius_m * rate).sum();
        let strokes_m = robot.cable_strokes(&start);
        let longest_m = strokes_m.iter().fold(0.0_f64, |most, s| most.max(s.abs()));
        let stroke =
            longest_m + fastest_m_s * horizon_s > robot.cable_stroke_max_m() - LIMIT_MARGIN;
        let speed = fastest_m_s > robot.cable_speed_max_m_s() - LIMIT_MARGIN;
        Self {
            robot,
            period_s,
            weight,
            bend,
            stroke,
            speed,
        }
    }

    pub(super) fn any_reachable(&self) -> bool {
        self.bend || self.stroke || self.speed
    }

    /// Adds the penalties of a step from `before` to `after`.
    #[inline(always)]
    pub(super) fn add_penalties<const W: usize>(
        &self,
        before: &[Wide<W>; COORDINATES_MAX],
        after: &[Wide<W>; COORDINATES_MAX],
        evaluation: &mut Evaluation<W>,
    ) {
        if self.bend {
            for (j, section) in self.robot.sections().iter().enumerate() {
                let (u, v) = (after[2 * j], after[2 * j + 1]);
                let bend = (u * u + v * v).sqrt();
                self.add_penalty(bend, section.bend_max_rad, BEND_WEIGHT, evaluation);
            }
        }
        if self.stroke {
            let strokes = self.robot.cable_shortening_wide(|i| after[i]);
            let most = self.robot.cable_stroke_max_m();
            for stroke in &strokes[..self.robot.cable_count()] {
                self.add_penalty(stroke.abs(), most, STROKE_WEIGHT, evaluation);
            }
        }
        if self.speed {
            let rate = |i: usize| (after[i] - before[i]) * (1.0 / self.period_s);
            let speeds = self.robot.cable_shortening_wide(rate);
            let most = self.robot.cable_speed_max_m_s();
            for speed in &speeds[..self.robot.cable_count()] {
                self.add_penalty(speed.abs(), most, SPEED_WEIGHT, evaluation);
            }
        }
    }

    #[inline(always)]
    fn add_penalty<const W: usize>(
        &self,
        value: Wide<W>,
        most: f64,
        weight: f64,
        evaluation: &mut Evaluation<W>,
    ) {
        let zero = Wide::splat(0.0);
        let excess = value + -(most - LIMIT_MARGIN);
        // A comparison with NaN is false, so a NaN stays and makes the cost NaN, as intended.
        let excess = zero.select(excess, excess.less(zero));
        evaluation.cost = evaluation.cost + excess * excess * (weight * self.weight);
        // Negative where the limit is kept: no violation.
        let share = (excess + -LIMIT_MARGIN) * (1.0 / most);
        let worst = evaluation.violations[LIMITS];
        evaluation.violations[LIMITS] = share.select(worst, worst.less(share));
    }

    /// Linearises the limits for a Gauss-Newton step.
    pub(super) fn rows(
        &self,
        before: &[f64; COORDINATES_MAX],
        after: &[f64; COORDINATES_MAX],
        mut push: impl FnMut(LimitRow),
    ) {
        if self.bend {
            let scale = (BEND_WEIGHT * self.weight).sqrt();
            for (j, section) in self.robot.sections().iter().enumerate() {
                let (u, v) = (after[2 * j], after[2 * j + 1]);
                let bend = u.hypot(v);
                if bend > 0.0 {
                    let mut derivatives = [0.0; COORDINATES_MAX];
                    derivatives[2 * j] = -scale * u / bend;
                    derivatives[2 * j + 1] = -scale * v / bend;
                    push(LimitRow {
                        h: scale * (section.bend_max_rad - LIMIT_MARGIN - bend),
                        derivatives,
                        is_step_change: false,
                    });
                }
            }
        }
        if self.stroke {
            let scale = (STROKE_WEIGHT * self.weight).sqrt();
            let most = self.robot.cable_stroke_max_m();
            self.cable_rows(after, most, scale, 1.0, false, &mut push);
        }
        if self.speed {
            let mut rates = [0.0; COORDINATES_MAX];
            for i in 0..rates.len() {
                rates[i] = (after[i] - before[i]) / self.period_s;
            }
            let scale = (SPEED_WEIGHT * self.weight).sqrt();
            let most = self.robot.cable_speed_max_m_s();
            self.cable_rows(&rates, most, scale, 1.0 / self.period_s, true, &mut push);
        }
    }

    /// Rows of |shortening| ≤ most for every cable. The shortening is linear in the bends.
    fn cable_rows(
        &self,
        bends: &[f64; COORDINATES_MAX],
        most: f64,
        scale: f64,
        per_bend: f64,
        is_step_change: bool,
        push: &mut impl FnMut(LimitRow),
    ) {
        let values = self.robot.cable_shortening_wide(|i| Wide([bends[i]]));
        let directions = self.robot.cable_directions().as_flattened();
        for (cable, (value, direction)) in values.iter().zip(directions).enumerate() {
            let value = value.0[0];
            let towards = -scale * per_bend * value.signum();
            let mut derivatives = [0.0; COORDINATES_MAX];
            // A cable passes the sections up to its own.
            let passed = self.robot.sections().iter().take(cable / 3 + 1);
            for (pair, section) in derivatives.as_chunks_mut::<2>().0.iter_mut().zip(passed) {
                *pair = direction.map(|part| towards * (section.cable_radius_m * part));
            }
            push(LimitRow {
                h: scale * (most - LIMIT_MARGIN - value.abs()),
                derivatives,
                is_step_change,
            });
        }
    }
}
