//! Limits of the configuration for which a motion takes longer than its reference.

use std::fmt;

use cdcr_controller::closed_loop::ClosedLoop;
use cdcr_controller::reference::ReferenceSample;
use cdcr_controller::robot::BendRates;

/// A value this near to its limit, as a share of it, is at the limit: a plan stays a little inside.
const AT_LIMIT: f64 = 1e-2;

/// A limit that the newest command has reached: a lower speed stays below it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Slowed {
    /// A cable is at its largest speed.
    CableSpeed { max_m_s: f64 },
    /// A rate grows as fast as it may.
    Acceleration { max_rad_s2: f64 },
}

impl Slowed {
    /// The limit that slows the robot in the newest period, after the rates `before`.
    pub(super) fn newest<R>(
        closed: &ClosedLoop<R>,
        before: &BendRates,
        period_s: f64,
    ) -> Option<Self>
    where
        R: Fn(f64) -> ReferenceSample,
    {
        let robot = closed.robot();
        let rates = &closed.command().rates;
        let is_reached = |value: f64, max: f64| value > (1.0 - AT_LIMIT) * max;
        let max_m_s = robot.cable_speed_max_m_s();
        let speeds_m_s = robot.cable_speeds(rates);
        if speeds_m_s.iter().any(|m_s| is_reached(m_s.abs(), max_m_s)) {
            return Some(Self::CableSpeed { max_m_s });
        }
        let max_rad_s2 = closed.acceleration_rad_s2();
        let mut pairs = rates.as_slice().iter().zip(before.as_slice());
        let grows = pairs
            .any(|(now, before)| is_reached((now.abs() - before.abs()) / period_s, max_rad_s2));
        grows.then_some(Self::Acceleration { max_rad_s2 })
    }
}

impl fmt::Display for Slowed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::CableSpeed { max_m_s } => write!(
                f,
                "at this --speed a cable is at its limit, robot.cable_speed_max_m_s = {max_m_s}"
            ),
            Self::Acceleration { max_rad_s2 } => write!(
                f,
                "at this --speed a bend would have to accelerate by more than its limit, motion.acceleration_rad_s2 = {max_rad_s2}"
            ),
        }
    }
}
