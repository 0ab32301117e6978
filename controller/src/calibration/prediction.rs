use nalgebra::{Isometry3, Matrix6, Rotation3, UnitQuaternion, Vector3};

use super::geometry::{Geometry, PARAMETERS_MAX, Parameter, ZERO_PATTERNS};
use crate::robot::{Arc, CABLES_MAX, Configuration, Jacobian, Robot, SECTIONS_MAX};

/// Measurements of one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CalibrationRow {
    /// Length of each cable (m), three for each section, base first; 3n are used.
    pub cable_length_m: [f64; CABLES_MAX],
    /// Position of the tip (m).
    pub tip_position_m: Vector3<f64>,
    /// Rotation of the tip; in all rows or in none.
    pub tip_rotation: Option<UnitQuaternion<f64>>,
}

/// A change of position (m) and rotation (rad) in the frame of the measured poses.
pub(super) type Twist = nalgebra::Vector6<f64>;

/// Pose predicted by a geometry from the cables of a row, and its derivatives.
pub(super) struct Prediction {
    pose: Isometry3<f64>,
    /// Derivative by each parameter.
    pub(super) by_parameter: [Twist; PARAMETERS_MAX],
    /// Derivative by the pull of each section's cables (2/3 Σ of stroke times direction) along x and y (1/m): the
    /// effect of cable noise.
    by_pull: [[Twist; 2]; SECTIONS_MAX],
}

impl Prediction {
    pub(super) fn new(robot: &Robot, geometry: &Geometry, row: &CalibrationRow) -> Self {
        let bends = bends(robot, geometry, row);
        let mut jacobian = Jacobian::new();
        let tip = robot.tip_jacobian(&bends, &mut jacobian);
        let turn = geometry.base.rotation;
        let sensor_m = tip.rotation * geometry.sensor.translation.vector;
        let twist = |velocity: Vector3<f64>, spin: Vector3<f64>| {
            stacked(turn * (velocity + spin.cross(&sensor_m)), turn * spin)
        };
        let by_bend = |j: usize, axis: usize| {
            let c = jacobian.column(2 * j + axis);
            twist(
                Vector3::new(c[0], c[1], c[2]),
                Vector3::new(c[3], c[4], c[5]),
            )
        };
        let mut by_parameter = [Twist::zeros(); PARAMETERS_MAX];
        let mut by_pull = [[Twist::zeros(); 2]; SECTIONS_MAX];
        let mut at = |parameter: Parameter, change: Twist| by_parameter[parameter.index()] = change;
        let sections = robot.sections();
        let frames = robot.section_frames(&bends);
        let mut pull_m = [0.0; 2];
        for (j, section) in sections.iter().enumerate() {
            let radius_m = section.cable_radius_m;
            let bend = bends.section(j);
            pull_m = [
                pull_m[0] + radius_m * bend[0],
                pull_m[1] + radius_m * bend[1],
            ];
            by_pull[j] = core::array::from_fn(|axis| {
                let own = by_bend(j, axis) / radius_m;
                // The bend of the next section is reduced by the same pull.
                match sections.get(j + 1) {
                    Some(next) => own - by_bend(j + 1, axis) / next.cable_radius_m,
                    None => own,
                }
            });
            let pulled = |x: f64, y: f64| by_pull[j][0] * x + by_pull[j][1] * y;
            let grown = frames[j].rotation * Arc::new(1.0, bend).position_m();
            at(
                Parameter::Length(j),
                stacked(turn * grown, Vector3::zeros()),
            );
            let shrunk = by_bend(j, 0) * bend[0] + by_bend(j, 1) * bend[1];
            at(Parameter::CableRadius(j), -shrunk / radius_m);
            at(Parameter::CableAngle(j), pulled(-pull_m[1], pull_m[0]));
            for (pattern, zeros) in ZERO_PATTERNS.iter().enumerate() {
                let mut sum = [0.0; 2];
                for (zero, [cos, sin]) in zeros.iter().zip(robot.cable_directions()[j]) {
                    sum = [sum[0] + zero * cos / 1.5, sum[1] + zero * sin / 1.5];
                }
                at(Parameter::CableZero(j, pattern), pulled(sum[0], sum[1]));
            }
        }
        let tip_turn =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(tip.rotation));
        let placed = Isometry3::from_parts(tip.position_m.into(), tip_turn);
        let pose = geometry.base * placed * geometry.sensor;
        let from_base_m = pose.translation.vector - geometry.base.translation.vector;
        for axis in 0..3 {
            let unit = Vector3::ith(axis, 1.0);
            let carried = turn * (tip.rotation * unit);
            at(
                Parameter::BasePosition(axis),
                stacked(unit, Vector3::zeros()),
            );
            at(
                Parameter::BaseRotation(axis),
                stacked(unit.cross(&from_base_m), unit),
            );
            at(
                Parameter::SensorPosition(axis),
                stacked(carried, Vector3::zeros()),
            );
            at(
                Parameter::SensorRotation(axis),
                stacked(Vector3::zeros(), carried),
            );
        }
        Self {
            pose,
            by_parameter,
            by_pull,
        }
    }

    /// Measurement minus prediction (m and rad); the rotation is zero if none was measured.
    pub(super) fn residual(&self, row: &CalibrationRow) -> Twist {
        residual(&self.pose, row)
    }

    /// Covariance of the pose from cable noise of this standard deviation (m). For three cables at 120°, the pull along
    /// each axis has two thirds of the variance.
    pub(super) fn covariance(&self, cable_m: f64) -> Matrix6<f64> {
        let columns = self.by_pull.iter().flatten();
        let sum = columns.fold(Matrix6::zeros(), |sum, column| {
            sum + column * column.transpose()
        });
        sum * (cable_m * cable_m / 1.5)
    }
}

/// Measurement minus the prediction of a geometry.
pub(super) fn residual_of(robot: &Robot, geometry: &Geometry, row: &CalibrationRow) -> Twist {
    let tip = robot.tip_pose(&bends(robot, geometry, row));
    let turn =
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(tip.rotation));
    let placed = Isometry3::from_parts(tip.position_m.into(), turn);
    residual(&(geometry.base * placed * geometry.sensor), row)
}

fn residual(pose: &Isometry3<f64>, row: &CalibrationRow) -> Twist {
    let turned = row.tip_rotation.map_or_else(Vector3::zeros, |measured| {
        (measured * pose.rotation.inverse()).scaled_axis()
    });
    stacked(row.tip_position_m - pose.translation.vector, turned)
}

fn bends(robot: &Robot, geometry: &Geometry, row: &CalibrationRow) -> Configuration {
    let mut lengths_m = row.cable_length_m;
    let (sections, _) = lengths_m.as_chunks_mut::<3>();
    for (j, cables) in sections.iter_mut().take(robot.section_count()).enumerate() {
        for (length_m, zero_m) in cables.iter_mut().zip(geometry.section_zeros_m(j)) {
            *length_m -= zero_m;
        }
    }
    robot.bend_from_cable_lengths(&lengths_m)
}

fn stacked(position: Vector3<f64>, rotation: Vector3<f64>) -> Twist {
    Twist::new(
        position.x, position.y, position.z, rotation.x, rotation.y, rotation.z,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::RobotParameters;

    /// Compares every derivative with central differences of the whole chain, with non-zero base, sensor and zeros.
    #[test]
    fn the_derivatives_are_differences() {
        let parameters = RobotParameters::paper(3);
        let mut away = [0.0; PARAMETERS_MAX];
        for (index, value) in away.iter_mut().enumerate() {
            *value = 1e-3 * (index as f64 * 1.7).sin();
        }
        for index in 30..PARAMETERS_MAX {
            away[index] *= 100.0;
        }
        let geometry = Geometry::configured(&parameters).moved(&away);
        let robot = geometry.checked().unwrap();
        let shape = Configuration::from_slice(&[0.7, -0.4, 0.2, 1.1, -0.9, 0.3]).unwrap();
        let row = CalibrationRow {
            cable_length_m: robot.cable_lengths(&shape),
            tip_position_m: Vector3::new(0.1, 0.2, 0.3),
            tip_rotation: Some(UnitQuaternion::identity()),
        };
        let prediction = Prediction::new(&robot, &geometry, &row);
        for index in (0..15).chain(30..PARAMETERS_MAX) {
            let pose = |sign: f64| {
                let mut step = [0.0; PARAMETERS_MAX];
                step[index] = sign * 1e-6;
                let moved = geometry.moved(&step);
                Prediction::new(&moved.checked().unwrap(), &moved, &row).pose
            };
            let (before, after) = (pose(-1.0), pose(1.0));
            let moved_m = (after.translation.vector - before.translation.vector) / 2e-6;
            let turned = (after.rotation * before.rotation.inverse()).scaled_axis() / 2e-6;
            let difference = stacked(moved_m, turned);
            let found = prediction.by_parameter[index];
            assert!(
                (difference - found).amax() < 1e-6 * found.amax().max(1.0),
                "{}: {difference:?} {found:?}",
                Parameter::from_index(index)
            );
        }
    }
}
