//! A body that a closed path of the tip leaves in another place.

use std::fmt;

use cdcr_client::Trajectory;
use cdcr_controller::nmpc::NmpcSettings;
use cdcr_controller::robot::{Configuration, Robot};

/// Smallest motion of the body that is reported \[m\].
const MOVED_M: f64 = 0.01;

/// What leads the body back to the shape in which a round began.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Remedy {
    InForce,
    Gain,
    GainAndRateWeight,
}

impl Remedy {
    fn from_settings(settings: &NmpcSettings) -> Self {
        match (
            settings.posture_gain > 0.0,
            f64::from(settings.rate_weight) > 0.0,
        ) {
            (true, true) => Self::InForce,
            (_, true) => Self::Gain,
            (_, false) => Self::GainAndRateWeight,
        }
    }

    fn text(self) -> &'static str {
        match self {
            Self::InForce => {
                "with its posture_gain the body repeats what the tip repeats only after the first rounds"
            }
            Self::Gain => {
                "the body does not repeat what the tip repeats; controller.posture_gain = 2 leads it back"
            }
            Self::GainAndRateWeight => {
                "the body does not repeat what the tip repeats; controller.posture_gain = 2 and rate_weight = 1e-10 lead it back"
            }
        }
    }
}

/// The end of a section that is not where it was when the tip was last here.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Unrepeated {
    /// From 1 at the base.
    section: usize,
    moved_m: f64,
    remedy: Remedy,
}

impl Unrepeated {
    /// From the shapes at the beginning and the end of a trajectory. None: it is not closed, or the body hardly moved.
    pub(super) fn after(
        trajectory: &dyn Trajectory,
        robot: &Robot,
        settings: &NmpcSettings,
        shapes: [&Configuration; 2],
    ) -> Option<Self> {
        if !trajectory.is_closed() {
            return None;
        }
        let frames = shapes.map(|shape| robot.section_frames(shape));
        let moved = |section| Self {
            section,
            moved_m: (frames[0][section].position_m - frames[1][section].position_m).norm(),
            remedy: Remedy::from_settings(settings),
        };
        let sections = (1..robot.section_count()).map(moved);
        let most = sections.max_by(|a, b| a.moved_m.total_cmp(&b.moved_m))?;
        (most.moved_m > MOVED_M).then_some(most)
    }
}

impl fmt::Display for Unrepeated {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "the path ends where it begins, and the end of section {} then is {:.0} mm from where it was: {} (docs/tuning.md)",
            self.section,
            1e3 * self.moved_m,
            self.remedy.text()
        )
    }
}
