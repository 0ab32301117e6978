//! Limits of rates: finite, inside the box, bends inside their limits, cables inside their speed and stroke, section ends
//! inside their speed.

mod stops;

use crate::robot::{BendRates, CABLES_MAX, COORDINATES_MAX, Configuration, Robot};

use super::projection::{Region, Vector};
use super::stopping::Stopping;

/// Distance inside a limit at which the nearest command aims, in rad and m, so that rounding does not exceed
/// the limit: the command would then be scaled down by any amount. The projection is accurate to 10⁻¹³ of a
/// bound, times the path.
const INSIDE: f64 = 1e-11;
/// The same for the speed of a cable, as a share of its limit.
const SPEED_INSIDE: f64 = 1e-12;
/// Tangents that approximate the circular limit of a bend before the rest is cut off.
const TANGENTS: usize = 8;

/// Which limits changed a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LimitsHit {
    /// A rate was beyond its limit.
    pub rate: bool,
    /// A bend would have left its limit.
    pub bend: bool,
    /// A cable would have been too fast.
    pub cable_speed: bool,
    /// The end of a section would have been too fast.
    pub tip_speed: bool,
    /// A cable would have left its stroke.
    pub cable_stroke: bool,
    /// A rate would have grown faster than the largest acceleration.
    pub acceleration: bool,
    /// Two parts of the body would have touched.
    pub self_contact: bool,
    /// Desired rates or state were not finite, or had another number of sections than the robot; the rates
    /// became zero.
    pub non_finite: bool,
}

impl LimitsHit {
    fn any(self) -> bool {
        self != Self::default()
    }

    pub(super) fn or(self, other: Self) -> Self {
        Self {
            rate: self.rate || other.rate,
            bend: self.bend || other.bend,
            cable_speed: self.cable_speed || other.cable_speed,
            tip_speed: self.tip_speed || other.tip_speed,
            cable_stroke: self.cable_stroke || other.cable_stroke,
            acceleration: self.acceleration || other.acceleration,
            self_contact: self.self_contact || other.self_contact,
            non_finite: self.non_finite || other.non_finite,
        }
    }
}

/// A command inside every limit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limited {
    /// Rates nearest to the desired ones within the limits \[rad/s\].
    pub rates: BendRates,
    /// The limits that changed the command.
    pub hit: LimitsHit,
}

/// The limits of one command, which the robot executes for `path_s` \[s\]:
///
/// * Rates are inside the box, and no component leaves the previous one by more than the acceleration
///   permits. Slowing down is always permitted: a component may lie anywhere between zero and its previous
///   value, and the permitted change beyond either.
/// * At the end of the path, each bend is inside its section's limit; a bend beyond the limit may only
///   shrink.
/// * Cables are inside their speed limit. At the end of the path, they are inside their stroke about the
///   lengths of the straight robot; a cable beyond its stroke may only return.
/// * The end of each section is inside the robot's speed limit, if it has one, in the shape in which the command
///   begins.
///
/// Zero rates satisfy all limits. With any permitted rates, all shorter rates in the same direction are
/// permitted.
#[derive(Debug, Clone, Copy)]
pub struct Limits<'a> {
    robot: &'a Robot,
    at: &'a Configuration,
    /// Commanded configuration, from which bends and strokes must satisfy the limits, too.
    commanded: Option<&'a Configuration>,
    /// Largest rates \[rad/s\].
    rate_max_rad_s: Vector,
    /// Range of the rates by the acceleration \[rad/s\].
    least_rad_s: Vector,
    most_rad_s: Vector,
    path_s: f64,
    /// Largest speed of the section ends \[m/s\]; infinite: no limit.
    tip_speed_max_m_s: f64,
    /// Motion after the command, if the robot does not stop at once: slower rates have a shorter path.
    stopping: Option<Stopping>,
}

impl<'a> Limits<'a> {
    /// Limits of a robot `at` a configuration.
    pub fn new(robot: &'a Robot, at: &'a Configuration, path_s: f64) -> Self {
        let mut rate_max_rad_s = Vector::default();
        let pairs = rate_max_rad_s.as_chunks_mut::<2>().0.iter_mut();
        for (pair, section) in pairs.zip(robot.sections()) {
            *pair = [section.rate_max_rad_s; 2];
        }
        Self {
            robot,
            at,
            commanded: None,
            rate_max_rad_s,
            least_rad_s: [f64::NEG_INFINITY; COORDINATES_MAX],
            most_rad_s: [f64::INFINITY; COORDINATES_MAX],
            path_s,
            tip_speed_max_m_s: robot.tip_speed_max_m_s().unwrap_or(f64::INFINITY),
            stopping: None,
        }
    }

    /// Adds the limits of bends and strokes at the commanded configuration.
    #[must_use]
    pub fn with_commanded(self, commanded: Option<&'a Configuration>) -> Self {
        Self { commanded, ..self }
    }

    /// Makes the path that of the rates.
    #[must_use]
    pub(super) fn with_stopping(mut self, stopping: Stopping) -> Self {
        self.stopping = stopping.deceleration_rad_s2.is_finite().then_some(stopping);
        self
    }

    /// Adds the limit of acceleration: no component leaves the previous one by more than `change_rad_s` =
    /// acceleration · period.
    #[must_use]
    pub fn with_acceleration(mut self, previous: &BendRates, change_rad_s: f64) -> Self {
        for (i, previous) in previous.as_slice().iter().enumerate() {
            self.least_rad_s[i] = previous.min(0.0) - change_rad_s;
            self.most_rad_s[i] = previous.max(0.0) + change_rad_s;
        }
        self
    }

    /// The permitted command nearest to `desired`, and not faster. Unchanged if `desired` is permitted; zero
    /// if `desired` or the state is not finite. The speed limit of the section ends then scales the nearest command
    /// inside all other limits down, in the same direction.
    pub fn nearest(&self, desired: &BendRates) -> Limited {
        let hit = self.broken(desired);
        let others_hit = LimitsHit {
            tip_speed: false,
            ..hit
        };
        let rates = if hit.non_finite {
            BendRates::zero(self.robot.section_count())
        } else if others_hit.any() {
            let others = Self {
                tip_speed_max_m_s: f64::INFINITY,
                ..*self
            };
            let nearest = others.nearest_that_stops(desired);
            self.within_tip_speed(nearest.unwrap_or_else(|| others.shortened(desired)))
        } else if hit.tip_speed {
            self.within_tip_speed(*desired)
        } else {
            *desired
        };
        Limited { rates, hit }
    }

    /// For a robot that comes to rest: each section's rates are those of `ramp`, or shorter in the same
    /// direction. So no component exceeds that of the ramp, and zero rates stay zero for every state: a
    /// measurement beyond a limit never moves a resting robot. Zero rates if ramp or state are not finite.
    pub fn shorten(&self, ramp: &BendRates) -> Limited {
        let hit = self.broken(ramp);
        let rates = if hit.non_finite {
            BendRates::zero(self.robot.section_count())
        } else if hit.any() {
            self.shortened(ramp)
        } else {
            *ramp
        };
        Limited { rates, hit }
    }

    /// `rates`, scaled down together to the largest rates, acceleration and speeds of cables and section ends, in
    /// the same direction.
    pub(super) fn straight(&self, rates: &BendRates) -> BendRates {
        let mut share = self.speed_share(rates).min(self.tip_speed_share(rates));
        for (i, rate) in rates.as_slice().iter().enumerate() {
            let most = if *rate < 0.0 {
                -self.lower_rad_s(i)
            } else {
                self.upper_rad_s(i)
            };
            if rate.abs() > most {
                share = share.min(most / rate.abs());
            }
        }
        let mut rates = *rates;
        scale(rates.as_mut_slice(), share);
        rates
    }

    /// The limits that these rates violate.
    fn broken(&self, rates: &BendRates) -> LimitsHit {
        let sections = self.robot.section_count();
        let is_known = |at: &Configuration| at.is_finite() && at.section_count() == sections;
        let are_known = rates.is_finite() && rates.section_count() == sections;
        if !(are_known && self.configurations().all(is_known)) {
            return LimitsHit {
                non_finite: true,
                ..LimitsHit::default()
            };
        }
        let mut hit = LimitsHit::default();
        for (i, rate) in rates.as_slice().iter().enumerate() {
            hit.rate |= rate.abs() > self.rate_max_rad_s[i];
            hit.acceleration |= *rate < self.least_rad_s[i] || *rate > self.most_rad_s[i];
        }
        hit.cable_speed = self.speed_share(rates) < 1.0;
        hit.tip_speed = self.tip_speed_share(rates) < 1.0;
        for at in self.configurations() {
            let sections = 0..self.robot.section_count();
            hit.bend |= sections
                .into_iter()
                .any(|j| self.bend_share(at, rates, j) < 1.0);
            hit.cable_stroke |= self.stroke_share(at, rates) < 1.0;
        }
        hit
    }

    fn lower_rad_s(&self, i: usize) -> f64 {
        self.least_rad_s[i].max(-self.rate_max_rad_s[i])
    }

    fn upper_rad_s(&self, i: usize) -> f64 {
        self.most_rad_s[i].min(self.rate_max_rad_s[i])
    }

    fn configurations(&self) -> impl Iterator<Item = &'a Configuration> {
        core::iter::once(self.at).chain(self.commanded)
    }

    /// Clamps to the box, then shortens section by section, then all together: each step preserves the limits
    /// of the steps before.
    pub(super) fn shortened(&self, rates: &BendRates) -> BendRates {
        let mut rates = *rates;
        for (i, rate) in rates.as_mut_slice().iter_mut().enumerate() {
            *rate = rate.clamp(self.lower_rad_s(i), self.upper_rad_s(i));
        }
        for at in self.configurations() {
            for j in 0..self.robot.section_count() {
                let share = self.bend_share(at, &rates, j);
                scale(&mut rates.as_mut_slice()[2 * j..2 * j + 2], share);
            }
        }
        let share = self.speed_share(&rates);
        scale(rates.as_mut_slice(), share);
        for at in self.configurations() {
            let share = self.stroke_share(at, &rates);
            scale(rates.as_mut_slice(), share);
        }
        self.within_tip_speed(rates)
    }

    /// `rates`, scaled down to the speed limit of the section ends.
    fn within_tip_speed(&self, mut rates: BendRates) -> BendRates {
        let share = self.tip_speed_share(&rates);
        scale(rates.as_mut_slice(), share);
        rates
    }

    /// Permitted share of the rates of section j.
    fn bend_share(&self, at: &Configuration, rates: &BendRates, j: usize) -> f64 {
        let (bend, rate) = (at.section(j), rates.section(j));
        let motion = rate.map(|rate| self.path_s * rate);
        let radius = self.robot.sections()[j].bend_max_rad.max(at.bend_rad(j));
        if (bend[0] + motion[0]).hypot(bend[1] + motion[1]) <= radius {
            return 1.0;
        }
        // The path leaves the disc where |bend + share · path| = radius.
        let motion_2 = motion[0] * motion[0] + motion[1] * motion[1];
        let outwards = bend[0] * motion[0] + bend[1] * motion[1];
        let room = (radius * radius - bend[0] * bend[0] - bend[1] * bend[1]).max(0.0);
        let share = ((outwards * outwards + motion_2 * room).sqrt() - outwards) / motion_2;
        share.clamp(0.0, 1.0)
    }

    /// Share of the rates that all cable speeds permit.
    fn speed_share(&self, rates: &BendRates) -> f64 {
        let speeds_m_s = self.robot.cable_speeds(rates);
        let fastest_m_s = speeds_m_s
            .iter()
            .fold(0.0_f64, |most, speed| most.max(speed.abs()));
        (self.robot.cable_speed_max_m_s() / fastest_m_s).min(1.0)
    }

    /// Share of the rates that the speed limit of the section ends permits: their velocities are linear in the rates.
    fn tip_speed_share(&self, rates: &BendRates) -> f64 {
        let limit_m_s = self.tip_speed_max_m_s;
        if limit_m_s == f64::INFINITY {
            return 1.0;
        }
        let fastest_m_s = self.robot.fastest_section_end_m_s(self.at, rates);
        if fastest_m_s <= limit_m_s {
            1.0
        } else if fastest_m_s.is_nan() {
            0.0
        } else {
            limit_m_s / fastest_m_s
        }
    }

    /// Share of the rates that all cable strokes permit; strokes are linear in the bends.
    fn stroke_share(&self, at: &Configuration, rates: &BendRates) -> f64 {
        let max_m = self.robot.cable_stroke_max_m();
        let strokes_m = self.robot.cable_strokes(at);
        let speeds_m_s = self.robot.cable_speeds(rates);
        let mut share = 1.0_f64;
        for (stroke_m, speed_m_s) in strokes_m.iter().zip(speeds_m_s) {
            let change_m = self.path_s * speed_m_s;
            let (least_m, most_m) = (stroke_m.min(-max_m), stroke_m.max(max_m));
            let next_m = stroke_m + change_m;
            if next_m > most_m {
                share = share.min((most_m - stroke_m) / change_m);
            } else if next_m < least_m {
                share = share.min((least_m - stroke_m) / change_m);
            }
        }
        share
    }

    /// Fills `region` with the limits for rates whose components do not exceed `fastest_rad_s`, except the
    /// circular limits of the bends: [`Self::nearest_in`] adds those.
    pub(super) fn fill(&self, region: &mut Region, fastest_rad_s: f64) {
        let lower = core::array::from_fn(|i| self.lower_rad_s(i));
        let upper = core::array::from_fn(|i| self.upper_rad_s(i));
        let dimensions = self.robot.coordinate_count();
        region.reset(dimensions, [lower, upper], fastest_rad_s, self.path_s);
        let mut columns = [[0.0; CABLES_MAX]; COORDINATES_MAX];
        let mut unit = BendRates::zero(self.robot.section_count());
        for (i, column) in columns[..self.robot.coordinate_count()]
            .iter_mut()
            .enumerate()
        {
            unit.as_mut_slice()[i] = 1.0;
            *column = self.robot.cable_speeds(&unit);
            unit.as_mut_slice()[i] = 0.0;
        }
        // Remaining stroke of each cable in both directions.
        let mut rooms_m = [[f64::INFINITY; 2]; CABLES_MAX];
        let max_m = self.robot.cable_stroke_max_m();
        for at in self.configurations() {
            for (rooms_m, stroke_m) in rooms_m.iter_mut().zip(self.robot.cable_strokes(at)) {
                let here_m = [max_m + stroke_m, max_m - stroke_m];
                *rooms_m = [0, 1].map(|i| rooms_m[i].min(here_m[i].max(0.0) - INSIDE));
            }
        }
        let speed_max_m_s = self.robot.cable_speed_max_m_s() * (1.0 - SPEED_INSIDE);
        for (cable, [in_m, out_m]) in rooms_m[..self.robot.cable_count()].iter().enumerate() {
            let pays_out = columns.map(|column| column[cable]);
            region.bound_along(&pays_out, -speed_max_m_s, *in_m);
            region.bound_along(&pays_out.map(|share| -share), -speed_max_m_s, *out_m);
        }
    }

    /// The rates nearest to `desired` in `region` and inside the limits of the bends; `None` if none were
    /// found. Tangents to violated circular limits are added to `region`.
    pub(super) fn nearest_in(&self, region: &mut Region, desired: &BendRates) -> Option<BendRates> {
        let mut to = Vector::default();
        to[..desired.as_slice().len()].copy_from_slice(desired.as_slice());
        let mut rates = *desired;
        for _ in 0..TANGENTS {
            let nearest = region.nearest(&to)?;
            let width = rates.as_slice().len();
            rates.as_mut_slice().copy_from_slice(&nearest[..width]);
            if !self.add_tangents(&rates, region) || region.is_full() {
                break;
            }
        }
        Some(self.shortened(&rates))
    }

    /// Adds a tangent for every bend beyond its limit. Returns whether there was one.
    fn add_tangents(&self, rates: &BendRates, region: &mut Region) -> bool {
        let mut added = false;
        for at in self.configurations() {
            for j in 0..self.robot.section_count() {
                let (bend, rate) = (at.section(j), rates.section(j));
                let target = [0, 1].map(|i| bend[i] + self.path_s * rate[i]);
                let size = target[0].hypot(target[1]);
                let radius = self.robot.sections()[j].bend_max_rad.max(at.bend_rad(j)) - INSIDE;
                if size <= radius + 0.5 * INSIDE {
                    continue;
                }
                let outwards = target.map(|component| component / size);
                let bent = outwards[0] * bend[0] + outwards[1] * bend[1];
                let mut normal = Vector::default();
                normal[2 * j..2 * j + 2].copy_from_slice(&outwards.map(|component| -component));
                region.bound_along(&normal, f64::NEG_INFINITY, radius - bent);
                added = true;
            }
        }
        added
    }
}

/// [`Limits::nearest`] for a robot that receives its next command after `period_s`.
pub fn limit(robot: &Robot, at: &Configuration, desired: &BendRates, period_s: f64) -> Limited {
    Limits::new(robot, at, period_s).nearest(desired)
}

/// [`Limits::shorten`] for such a robot.
pub fn shorten(robot: &Robot, at: &Configuration, ramp: &BendRates, period_s: f64) -> Limited {
    Limits::new(robot, at, period_s).shorten(ramp)
}

fn scale(rates: &mut [f64], share: f64) {
    if share < 1.0 {
        for rate in rates {
            *rate *= share;
        }
    }
}

#[cfg(test)]
mod tests;
