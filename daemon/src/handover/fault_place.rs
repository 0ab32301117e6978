use std::fmt;

use cdcr_controller::estimator::Measurement;
use cdcr_controller::robot::Robot;
use cdcr_controller::safety::{FarthestBend, FollowingCause, MarginShare, Reason};

use super::CycleRecord;

/// Where the cycle of a fault saw its cause, for the person who has to correct it. Sections count from 0 at the base.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FaultPlace {
    /// The bend farthest beyond its limit.
    Bend(FarthestBend),
    /// The component of a bend vector whose measurement is farthest from where the commands lead.
    Component {
        section: usize,
        axis: char,
        measured_rad: f64,
        commanded_rad: f64,
    },
    /// The bend component or the cable, from 0 within its section, that did not change.
    Frozen { section: usize, part: FrozenPart },
    /// Distance of the measured tip from where the commands lead \[m\].
    Tip { distance_m: f64 },
    /// The clearance of a body that counts as thicker by the tip margin \[m\].
    Margin(MarginShare),
    /// The section farthest from its command, and what shows the cause.
    Section {
        section: usize,
        error_rad: f64,
        cause: Option<FollowingCause>,
    },
}

impl FaultPlace {
    /// Of a record whose cycle began the fault. `None` where the reason has no place.
    pub fn find(robot: &Robot, record: &CycleRecord) -> Option<Self> {
        let measured = record.measurement.as_ref().map(|timed| &timed.measurement);
        match record.mode.reason() {
            Reason::LimitBroken => {
                let bends = measured.and_then(|measured| measured.configuration(robot));
                FarthestBend::find(robot, bends, &record.configuration).map(Self::Bend)
            }
            Reason::MeasurementFrozen => Self::frozen(measured?, record.frozen_channel?),
            Reason::MeasurementJump => Self::of_jump(robot, measured?, record),
            Reason::FollowingError => {
                let errors_rad = record.following.bend_rad.iter().enumerate();
                let farthest = errors_rad.max_by(|one, other| one.1.total_cmp(other.1));
                farthest.map(|(section, &error_rad)| Self::Section {
                    section,
                    error_rad,
                    cause: FollowingCause::find(robot, &record.following),
                })
            }
            Reason::ClearanceBroken if record.tip_margin_m > 0.0 => {
                let clearance_m = record.clearance_m.min(record.measured_clearance_m);
                Some(Self::Margin(MarginShare {
                    clearance_m,
                    margin_m: record.tip_margin_m,
                    limit_m: record.policy.clearance_fault_m,
                }))
            }
            _ => None,
        }
    }

    fn frozen(measured: &Measurement, channel: usize) -> Option<Self> {
        let (section, part) = match measured {
            Measurement::Configuration(_) => (channel / 2, FrozenPart::Bend(axis(channel))),
            Measurement::CableLengths(_) => (channel / 3, FrozenPart::Cable(channel % 3)),
            Measurement::TipPosition(_) => return None,
        };
        Some(Self::Frozen { section, part })
    }

    fn of_jump(robot: &Robot, measured: &Measurement, record: &CycleRecord) -> Option<Self> {
        if let Measurement::TipPosition(tip_m) = measured {
            let distance_m = (tip_m - record.tip.position_m).norm();
            return Some(Self::Tip { distance_m });
        }
        let measured = measured.configuration(robot)?;
        let pairs = measured
            .as_slice()
            .iter()
            .zip(record.configuration.as_slice());
        let components = pairs
            .enumerate()
            .map(|(k, (&measured_rad, &commanded_rad))| {
                let place = Self::Component {
                    section: k / 2,
                    axis: axis(k),
                    measured_rad,
                    commanded_rad,
                };
                ((measured_rad - commanded_rad).abs(), place)
            });
        let farthest = components.max_by(|one, other| one.0.total_cmp(&other.0));
        farthest.map(|(_, place)| place)
    }
}

/// What of a section is frozen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FrozenPart {
    Bend(char),
    Cable(usize),
}

/// Axis of this component of the bends.
fn axis(component: usize) -> char {
    if component.is_multiple_of(2) {
        'x'
    } else {
        'y'
    }
}

impl fmt::Display for FaultPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bend(bend) => bend.fmt(f),
            Self::Margin(share) => share.fmt(f),
            Self::Component {
                section,
                axis,
                measured_rad,
                commanded_rad,
            } => write!(
                f,
                "bend component {axis} of section {} is measured as {measured_rad:.4} rad, the commands lead to {commanded_rad:.4} rad",
                section + 1
            ),
            Self::Frozen { section, part } => {
                match part {
                    FrozenPart::Bend(axis) => write!(f, "bend component {axis}")?,
                    FrozenPart::Cable(cable) => write!(f, "cable {}", cable + 1)?,
                }
                write!(
                    f,
                    " of section {} is measured with the same bits while it should move",
                    section + 1
                )
            }
            Self::Tip { distance_m } => {
                write!(
                    f,
                    "the tip is measured {distance_m:.4} m from where the commands lead"
                )
            }
            Self::Section {
                section,
                error_rad,
                cause,
            } => {
                write!(
                    f,
                    "section {} is {error_rad:.4} rad from its command",
                    section + 1
                )?;
                cause.map_or(Ok(()), |cause| write!(f, "; {cause}"))
            }
        }
    }
}
