use thiserror::Error;

use super::ROWS_MIN;
use crate::robot::RobotError;

/// Reason why calibration failed.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum CalibrationError {
    /// Too few rows.
    #[error(
        "{rows} rows are too few: at least {ROWS_MIN} are needed; a minute of motion is recommended"
    )]
    TooFewRows {
        /// Number of rows.
        rows: usize,
    },
    /// A row holds a number that is not finite.
    #[error("row {row} contains a number that is not finite")]
    NotFinite {
        /// Number of the row, from 1.
        row: usize,
    },
    /// The rotation of the tip is measured in some rows only.
    #[error("row {row} differs from row 1: either all rows include the tip rotation, or none")]
    MixedRotations {
        /// Number of the row, from 1.
        row: usize,
    },
    /// The robot did not move.
    #[error(
        "no section bends by more than {bend_rad:.4} rad in these rows: move every section in every direction"
    )]
    NoMotion {
        /// Largest bend of a section (rad).
        bend_rad: f64,
    },
    /// The configured robot is not valid.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// No robot explains the rows.
    #[error(
        "no robot near the configured one fits these rows: check that lengths are in m, cables in the order of the \
         configuration, and tip poses in the base frame"
    )]
    NoRobot,
    /// All parameters are held, by request or because the rows do not determine them.
    #[error(
        "nothing is left to estimate: {held} parameters are held, as requested or because these rows do not determine them"
    )]
    NothingLeft {
        /// Number of held parameters.
        held: usize,
        /// As [`Calibration::correlation`](super::Calibration::correlation), of the last fit.
        correlation: f64,
    },
}
