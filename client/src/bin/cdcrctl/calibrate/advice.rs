//! Which recording determines the parameters that the present one does not.

use std::fmt::Write;

use cdcr_controller::calibration::{Held, HeldReason, Parameter};
use cdcr_controller::robot::{Robot, RobotParameters};

use super::recording::CalibrationRows;

/// From here on the residuals are model errors rather than noise.
pub(super) const CORRELATED: f64 = 2.0;

/// True if another recording of the same sensors would determine this parameter.
pub(super) fn needs_motion(held: &Held) -> bool {
    let is_never_determined = matches!(
        held.parameter,
        Parameter::BaseRotation(2) | Parameter::SensorPosition(2)
    );
    held.why != HeldReason::Requested && !is_never_determined
}

/// The bends of the recording, and what to do.
pub(super) fn text(
    robot: &RobotParameters,
    recording: &CalibrationRows,
    correlation: f64,
) -> String {
    let mut out = String::from(
        "To determine them, record a motion in which every section bends far in every direction.",
    );
    if let Ok(robot) = Robot::new(robot) {
        let mut most_rad = vec![0.0_f64; robot.section_count()];
        for row in &recording.rows {
            let bends = robot.bend_from_cable_lengths(&row.cable_length_m);
            for (j, most_rad) in most_rad.iter_mut().enumerate() {
                *most_rad = most_rad.max(bends.bend_rad(j));
            }
        }
        let list = |all: Vec<f64>| {
            let all: Vec<_> = all.iter().map(|rad| format!("{rad:.2}")).collect();
            all.join(", ")
        };
        let limits_rad = robot.sections().iter().map(|section| section.bend_max_rad);
        let _ = write!(
            out,
            " In these {:.0} s the sections bend by up to {} rad, of {}.",
            recording.duration_s,
            list(most_rad),
            list(limits_rad.collect())
        );
    }
    out.push_str(
        " Repeat cdcrctl calibrate excite to its end, with a longer --duration (a minute is usual), or a larger --bend-max, or \
         send the rotation of the tip, too.",
    );
    if correlation > CORRELATED {
        let _ = write!(
            out,
            "\nFirst correct the model: residuals of consecutive rows are correlated, which makes the bounds {correlation:.1} times as wide. \
             It lacks an effect: actuator.play_m is {:.3} mm (docs/calibration.md), or a load, friction, or values of --hold that are wrong. \
             Or the rows are not what they are taken for: coordinates of the tip exchanged or mirrored (a left-handed frame), cables exchanged or of \
             the other sign, tips later than the cables of their row.",
            1e3 * recording.play_m
        );
    } else {
        out.push_str(
            " Or measure base and sensor by other means and hold them (--hold base,sensor).",
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_correlated_residuals_the_causes_are_named() {
        let rows = CalibrationRows {
            rows: Vec::new(),
            duration_s: 1.0,
            play_m: 0.0,
        };
        let text = |correlation| text(&RobotParameters::paper(1), &rows, correlation);
        for cause in ["play_m", "mirrored", "exchanged", "sign", "later"] {
            assert!(text(3.0).contains(cause), "{cause}");
            assert!(!text(1.0).contains(cause), "{cause}");
        }
    }
}
