use core::fmt;

use super::FollowingError;
use crate::robot::Robot;
use crate::safety::BEND_TOLERANCE_RAD;

/// Cause of a following error, as far as measured lengths and the other sections show it. Sections and cables count from 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FollowingCause {
    /// The three cables of a section are off together, by this mean \[m\], which no bend explains.
    CommonMode {
        /// The section.
        section: usize,
        /// Measured minus commanded mean length \[m\].
        error_m: f64,
    },
    /// One cable of a section is off by this \[m\], and the two beside it are not.
    OneCable {
        /// The section.
        section: usize,
        /// The cable of that section.
        cable: usize,
        /// Measured minus commanded length \[m\].
        error_m: f64,
    },
    /// Every section of several is off.
    EverySection,
}

impl FollowingCause {
    /// The cause of an error of `robot`. `None` where nothing shows one, and where all is within [`BEND_TOLERANCE_RAD`].
    pub fn find(robot: &Robot, error: &FollowingError) -> Option<Self> {
        let (cables_m, _) = error.cable_m.as_chunks::<3>();
        let mut tolerance_m = 0.0;
        for (section, (geometry, cables_m)) in robot.sections().iter().zip(cables_m).enumerate() {
            tolerance_m += BEND_TOLERANCE_RAD * geometry.cable_radius_m;
            let cause = Self::of_cables(section, cables_m, tolerance_m);
            if cause.is_some() {
                return cause;
            }
        }
        let mut sections_rad = error.bend_rad.iter().take(robot.section_count());
        let is_every = sections_rad.all(|error_rad| *error_rad > BEND_TOLERANCE_RAD);
        (robot.section_count() > 1 && is_every).then_some(Self::EverySection)
    }

    fn of_cables(section: usize, cables_m: &[f64; 3], tolerance_m: f64) -> Option<Self> {
        let mean_m = cables_m.iter().sum::<f64>() / 3.0;
        for (cable, &error_m) in cables_m.iter().enumerate() {
            let others_m = [cables_m[(cable + 1) % 3], cables_m[(cable + 2) % 3]];
            let stands_out = others_m.iter().all(|m| 3.0 * m.abs() < error_m.abs());
            if stands_out && error_m.abs() > tolerance_m {
                return Some(Self::OneCable {
                    section,
                    cable,
                    error_m,
                });
            }
        }
        (mean_m.abs() > tolerance_m).then_some(Self::CommonMode {
            section,
            error_m: mean_m,
        })
    }
}

impl fmt::Display for FollowingCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let than_commanded = |error_m: f64| {
            let side = if error_m > 0.0 { "longer" } else { "shorter" };
            format!(
                "measured {:.1} mm {side} than commanded",
                1e3 * error_m.abs()
            )
        };
        match self {
            Self::CommonMode { section, error_m } => write!(
                f,
                "the three cables of section {} are in the mean {}, which no bend explains: set their zero (docs/drivers.md, Zero), unless \
                 motors jam or a load pulls at all of them. The driver library refuses such a first command",
                section + 1,
                than_commanded(*error_m)
            ),
            Self::OneCable {
                section,
                cable,
                error_m,
            } => write!(
                f,
                "of section {}, cable {} alone is {}: its motor jams, slips or carries a load, or its zero is wrong",
                section + 1,
                cable + 1,
                than_commanded(*error_m)
            ),
            Self::EverySection => f.write_str(
                "every section is off: the motors lag, stand, carry a load or do not reach robot.cable_speed_max_m_s, their driver refuses the commands, or the robot was moved",
            ),
        }
    }
}

#[cfg(test)]
mod tests;
