//! Sections near the largest bend of the configuration.

use std::fmt;

use cdcr_client::model::robot_of;
use cdcr_controller::robot::{Configuration, Robot};
use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::guard;

/// A bend this near to its limit, as a share of it, is at the limit.
const AT_LIMIT: f64 = 1e-3;
/// From this share on, noise or a load may lead a real robot to the limit, where it does not obey.
const NEAR_LIMIT: f64 = 0.95;

/// What to do where a point is missed by a section at its limit, although other bends reach it.
pub(crate) const WAY_OUT: &str = "in another shape the tip may arrive: cdcrctl home, then this again, or first go to a point between";

/// The section whose bend is the largest share of its limit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BendShare {
    /// 0 next to the base.
    section: usize,
    max_rad: f64,
    share: f64,
}

impl BendShare {
    pub(crate) const NONE: Self = Self {
        section: 0,
        max_rad: 0.0,
        share: 0.0,
    };

    pub(crate) fn largest(robot: &Robot, at: &Configuration) -> Self {
        let sections = robot.sections().iter().enumerate();
        let shares = sections.map(|(section, parameters)| Self {
            section,
            max_rad: parameters.bend_max_rad,
            share: at.bend_rad(section) / parameters.bend_max_rad,
        });
        shares.fold(Self::NONE, Self::larger)
    }

    /// The section that is at its limit in a record, or whose command was kept inside it.
    pub(crate) fn at_limit_of(record: &Telemetry) -> Option<Self> {
        let robot = robot_of(&record.robot).ok()?;
        let here = Configuration::from_slice(record.bend_rad.get(..robot.coordinate_count())?)?;
        let share = Self::largest(&robot, &here);
        let is_kept = record.guard_flags & guard::BEND != 0 && share.share >= NEAR_LIMIT;
        share.at_limit().or(is_kept.then_some(share))
    }

    pub(crate) fn larger(self, other: Self) -> Self {
        if other.share > self.share {
            other
        } else {
            self
        }
    }

    /// The bend as a share of its limit.
    pub(crate) fn share(self) -> f64 {
        self.share
    }

    /// It, where the section is at its limit.
    pub(crate) fn at_limit(self) -> Option<Self> {
        (self.share > 1.0 - AT_LIMIT).then_some(self)
    }

    /// What to say about it before the robot moves there.
    pub(crate) fn warning(self) -> Option<String> {
        let Self {
            section,
            max_rad,
            share,
        } = self;
        (share >= NEAR_LIMIT).then(|| {
            format!(
                "section {} bends to {:.1} % of its limit, robot.sections[{section}].bend_max_rad = {max_rad}: with noise, \
                 a load or another tip offset the robot may not get there",
                section + 1,
                100.0 * share
            )
        })
    }
}

impl fmt::Display for BendShare {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            section, max_rad, ..
        } = self;
        write!(
            f,
            "section {} is at its bend limit, robot.sections[{section}].bend_max_rad = {max_rad}",
            section + 1
        )
    }
}

#[cfg(test)]
mod tests {
    use cdcr_shared_types::codes::{Mode, ReferenceState};

    use super::*;
    use crate::dry_run::tests::robot;
    use crate::tip_error::TipError;

    #[test]
    fn a_bend_limit_at_the_end_of_a_reference_is_named() {
        for (bend_rad, guard_flags, is_named) in [
            (2.4995, 0, true),
            (2.47, 0, false),
            (2.47, guard::BEND, true),
            (2.3, guard::BEND, false),
        ] {
            let mut record = Telemetry {
                mode: Mode::Tracking.code(),
                guard_flags,
                position_error_m: 0.05,
                robot: robot(1),
                ..Telemetry::default()
            };
            record.reference.state = ReferenceState::Inside.code();
            record.bend_rad[1] = bend_rad;
            let mut error = TipError::default();
            error.take(&record);
            let text = error.print(None).unwrap_err().to_string();
            let limit = "section 1 is at its bend limit, robot.sections[0].bend_max_rad = 2.5";
            assert_eq!(text.contains(limit), is_named, "{text}");
        }
    }
}
