//! A load keeps a robot beside the place where its motors stand: sag, and the droop of servos.

use cdcr_shared_types::codes::MeasurementKind;
use cdcr_shared_types::limits::{BEND_TOLERANCE_RAD, POSE_DIFFERS_RAD};
use cdcr_shared_types::{Measurement, RobotDescription};

use super::{CommandedPosition, bounds};

/// Time over which the distance is averaged \[s\]. The distance of a robot that jams grows faster than its average follows.
const TIME_CONSTANT_S: f64 = 2.0;
/// Longest time that one measurement counts for \[s\].
const STEP_MAX_S: f64 = 0.1;

/// Mean distance from the measured robot to its motors while they followed commands.
#[derive(Debug, Clone, Default)]
pub(super) struct Load {
    /// By measured bends, and by measured cables.
    known: [Option<Known>; 2],
}

#[derive(Debug, Clone, Copy)]
struct Known {
    /// Of the bends or the cables; the others are not used.
    distance: CommandedPosition,
    measured_ns: u64,
}

impl Load {
    /// Adds a measurement of the robot while the motors were at `motors`.
    pub(super) fn learn(&mut self, motors: &CommandedPosition, measured: &Measurement) {
        let distance = motors.minus(&CommandedPosition::from_measurement(measured));
        let known = &mut self.known[kind_of(measured)];
        let distance = known.map_or(distance, |before| {
            let passed_ns = measured.measured_ns.saturating_sub(before.measured_ns);
            let passed_s = (1e-9 * passed_ns as f64).min(STEP_MAX_S);
            before
                .distance
                .towards(&distance, passed_s / TIME_CONSTANT_S)
        });
        if distance.is_finite() {
            *known = Some(Known {
                distance,
                measured_ns: measured.measured_ns,
            });
        }
    }

    /// The robot is measured where this load keeps it, beside motors at `motors`: nobody has moved it. Farther away than a
    /// reset accepts by itself, nothing is known.
    pub(super) fn keeps(
        &self,
        robot: &RobotDescription,
        motors: &CommandedPosition,
        measured: &Measurement,
    ) -> bool {
        let Some(known) = &self.known[kind_of(measured)] else {
            return false;
        };
        let place = motors.minus(&known.distance);
        bounds::check_near(robot, &place, measured, BEND_TOLERANCE_RAD).is_ok()
            && bounds::check_near(robot, motors, measured, POSE_DIFFERS_RAD).is_ok()
    }
}

fn kind_of(measured: &Measurement) -> usize {
    usize::from(measured.kind == MeasurementKind::CableLengths.code())
}
