//! Measured bends (§2 of docs/model.md), without the controller: a driver needs no `model`.

use core::f64::consts::TAU;

use cdcr_shared_types::codes::MeasurementKind;
use cdcr_shared_types::limits::COORDINATES_MAX;
use cdcr_shared_types::{Measurement, RobotDescription};

use super::bounds;

pub(super) fn is_of_cables(measured: &Measurement) -> bool {
    measured.kind == MeasurementKind::CableLengths.code()
}

/// The bend vectors of a measurement of bends or cables \[rad\].
pub(super) fn bends_rad(
    robot: &RobotDescription,
    measured: &Measurement,
) -> [f64; COORDINATES_MAX] {
    if !is_of_cables(measured) {
        return measured.bend_rad;
    }
    let mut bends_rad = [0.0; COORDINATES_MAX];
    let (mut backbone_m, mut proximal_m) = (0.0, [0.0; 2]);
    for (j, section) in bounds::sections(robot).iter().enumerate() {
        backbone_m += section.length_m;
        let mut pull_m = [0.0; 2];
        for i in 0..3 {
            let (sin, cos) = (section.cable_offset_rad + TAU * i as f64 / 3.0).sin_cos();
            let shortening_m = backbone_m - measured.cable_length_m[3 * j + i];
            pull_m[0] += shortening_m * cos / 1.5;
            pull_m[1] += shortening_m * sin / 1.5;
        }
        for axis in 0..2 {
            bends_rad[2 * j + axis] = (pull_m[axis] - proximal_m[axis]) / section.cable_radius_m;
        }
        proximal_m = pull_m;
    }
    bends_rad
}

#[cfg(all(test, feature = "model"))]
mod tests {
    use cdcr_controller::robot::Configuration;

    use super::*;
    use crate::model::robot_of;

    /// The bends of the controller's model, for a robot whose sections all differ.
    #[test]
    fn measured_cables_are_the_bends_of_the_model() {
        let mut robot = RobotDescription {
            sections: 3,
            cable_speed_max_m_s: 1.0,
            cable_stroke_max_m: 1.0,
            ..RobotDescription::default()
        };
        for (j, section) in robot.section.iter_mut().take(3).enumerate() {
            section.length_m = 0.1 + 0.05 * j as f64;
            section.cable_radius_m = 0.01 + 0.002 * j as f64;
            section.cable_offset_rad = 0.7 * j as f64;
            (section.bend_max_rad, section.rate_max_rad_s) = (2.8, 2.0);
        }
        let bends = [0.5, -0.3, 1.1, 0.2, -0.7, 0.9];
        let at = Configuration::from_slice(&bends).unwrap();
        let measured = Measurement {
            kind: MeasurementKind::CableLengths.code(),
            cable_length_m: robot_of(&robot).unwrap().cable_lengths(&at),
            ..Measurement::default()
        };
        for (found, bend) in bends_rad(&robot, &measured).iter().zip(bends) {
            assert!((found - bend).abs() < 1e-12, "{found}, {bend}");
        }
    }
}
