//! How fast the tip may move to a reference that it is behind.

use super::approach::turn_rad;
use super::{ApproachLimits, Orientation, ReferenceSample};
use crate::robot::Pose;

/// Largest speeds of a tip that is behind its reference, because an obstacle, a pause or its own limits kept it back.
///
/// It applies to the way back to the reference only: it never slows a robot that is where its reference is, or that
/// an obstacle moves away from it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pace {
    /// Largest speed of the tip \[m/s\]; infinite: no limit.
    pub speed_m_s: f64,
    /// Largest turn rate of the tip \[rad/s\]; infinite: no limit.
    pub turn_rad_s: f64,
}

impl Pace {
    /// As fast as all other limits allow.
    pub const UNLIMITED: Self = Self {
        speed_m_s: f64::INFINITY,
        turn_rad_s: f64::INFINITY,
    };

    /// The pace of `reference`, samples with a distance of `period_s`: the largest speeds that occur in it, and those of
    /// an approach. A jump or a corner inside the reference is followed at any speed in the period in which it occurs.
    pub fn of(reference: &[ReferenceSample], limits: &ApproachLimits, period_s: f64) -> Self {
        let pairs = reference.iter().zip(reference.iter().skip(1));
        let (mut step_m, mut turn_rad) = (0.0_f64, 0.0_f64);
        for (from, to) in pairs {
            step_m = step_m.max((to.position_m - from.position_m).norm());
            turn_rad = turn_rad.max(turn_between(&from.orientation, &to.orientation));
        }
        Self {
            speed_m_s: step_m / period_s + limits.speed_m_s,
            turn_rad_s: turn_rad / period_s + limits.turn_rad_s,
        }
    }

    /// The slower of two speeds of the tip.
    #[must_use]
    pub fn at_most(self, speed_m_s: f64) -> Self {
        Self {
            speed_m_s: self.speed_m_s.min(speed_m_s),
            ..self
        }
    }

    /// `sample`, or the point on the straight way from `tip` to it that the tip may reach within `time_s`. Position and
    /// orientation keep their proportion, so that a tip between the two is drawn to neither.
    #[must_use]
    pub fn within(&self, tip: &Pose, sample: &ReferenceSample, time_s: f64) -> ReferenceSample {
        let share = self.share(tip, sample, time_s);
        if share >= 1.0 {
            return *sample;
        }
        let position_m = tip.position_m + (sample.position_m - tip.position_m) * share;
        let orientation = sample
            .orientation
            .turned(turn_rad(tip, &sample.orientation) * (1.0 - share));
        ReferenceSample {
            state: sample.state,
            position_m,
            orientation,
        }
    }

    /// Share of the way from `tip` to `sample` that is permitted within `time_s`, 0 to 1.
    fn share(&self, tip: &Pose, sample: &ReferenceSample, time_s: f64) -> f64 {
        let away_m = (sample.position_m - tip.position_m).norm();
        let share = (self.speed_m_s * time_s / away_m).min(1.0);
        if self.turn_rad_s.is_infinite() {
            return share;
        }
        let turn_rad = turn_rad(tip, &sample.orientation).norm();
        (self.turn_rad_s * time_s / turn_rad).min(share)
    }
}

/// Angle between two specified orientations \[rad\]; 0 where one is free.
fn turn_between(from: &Orientation, to: &Orientation) -> f64 {
    match (from, to) {
        (Orientation::Axis(from), Orientation::Axis(to)) => {
            from.cross(to).norm().atan2(from.dot(to))
        }
        (Orientation::Full(from), Orientation::Full(to)) => from.angle_to(to),
        _ => 0.0,
    }
}
