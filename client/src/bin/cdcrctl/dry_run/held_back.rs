//! Limits of the configuration that keep a robot from a reference.

use std::fmt;

use cdcr_controller::closed_loop::ClosedLoop;

use crate::bend_limit::BendShare;

/// A cable this near to its largest stroke, as a share of it, is held back by it.
const AT_LIMIT: f64 = 1e-3;

/// A limit of the configuration that keeps the robot from a reference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum HeldBack {
    /// A cable is at its largest stroke.
    Stroke { max_m: f64 },
    /// A section is at its largest bend.
    Bend(BendShare),
    /// The end of a section would be too fast.
    TipSpeed { max_m_s: f64 },
}

impl HeldBack {
    /// The limit that holds the robot back in the newest period. Its longest stroke is `stroke_m`.
    pub(super) fn newest<R>(closed: &ClosedLoop<R>, stroke_m: f64) -> Option<Self>
    where
        R: Fn(f64) -> cdcr_controller::reference::ReferenceSample,
    {
        let robot = closed.robot();
        let max_m = robot.cable_stroke_max_m();
        if stroke_m > (1.0 - AT_LIMIT) * max_m {
            return Some(Self::Stroke { max_m });
        }
        if let Some(bend) = BendShare::largest(robot, closed.configuration()).at_limit() {
            return Some(Self::Bend(bend));
        }
        let max_m_s = robot.tip_speed_max_m_s();
        let max_m_s = max_m_s.filter(|_| closed.command().limits_hit.tip_speed)?;
        Some(Self::TipSpeed { max_m_s })
    }

    /// What to do about it.
    pub(super) fn remedy(self) -> &'static str {
        match self {
            Self::Stroke { .. } => {
                "use a smaller reference, or correct a limit that is not the robot's"
            }
            Self::Bend(_) => {
                "begin in another shape (cdcrctl home), use a smaller reference, or correct a limit that is not the robot's"
            }
            Self::TipSpeed { .. } => "use a lower one, or raise the limit",
        }
    }
}

impl fmt::Display for HeldBack {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Stroke { max_m } => {
                write!(
                    f,
                    "a cable is at its limit, robot.cable_stroke_max_m = {max_m}"
                )
            }
            Self::Bend(bend) => bend.fmt(f),
            Self::TipSpeed { max_m_s } => {
                write!(
                    f,
                    "at this --speed a section end is at its limit, robot.tip_speed_max_m_s = {max_m_s}"
                )
            }
        }
    }
}
