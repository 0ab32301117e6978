//! A load keeps a robot beside the place where its motors stand: sag, and the droop of servos.

use cdcr_shared_types::limits::{BEND_TOLERANCE_RAD, COORDINATES_MAX, POSE_DIFFERS_RAD};
use cdcr_shared_types::{Measurement, RobotDescription};

use super::{CommandedPosition, measured_bends};

type Bends = [f64; COORDINATES_MAX];

/// Way of a bend component of the motors over which its distance is averaged \[rad\]. A robot that jams or presses against
/// something stays behind by the way of its motors: its distance is far from the average then, however long it lasts.
const WAY_RAD: f64 = 1.0;
/// At first the distance is that of this time, also of motors at rest \[ns\].
const FIRST_NS: u64 = 1_000_000_000;
/// Time constant of the present distance, and of the first one \[s\]: a single measurement may be wrong.
const PRESENT_S: f64 = 0.05;
/// Longest time that one measurement counts for \[s\].
const STEP_MAX_S: f64 = 0.02;

/// Distance of the motors from the measured robot.
#[derive(Debug, Clone, Default)]
pub(super) struct Load {
    /// By measured bends, and by measured cables.
    known: [Option<Known>; 2],
}

#[derive(Debug, Clone, Copy)]
struct Known {
    /// The distance while the motors moved the robot \[rad\].
    load_rad: Bends,
    present_rad: Bends,
    /// Motors at the newest measurement while they obeyed \[rad\].
    motors_rad: Bends,
    first_ns: u64,
    measured_ns: u64,
    /// The first time is over.
    is_settled: bool,
}

impl Load {
    /// Adds a measurement of the robot while the motors were at `motors`; `obeys`: they follow commands of a robot in control.
    pub(super) fn learn(
        &mut self,
        robot: &RobotDescription,
        motors: &CommandedPosition,
        measured: &Measurement,
        obeys: bool,
    ) {
        let bends = measured_bends::bends_rad(robot, measured);
        let distance_rad: Bends = core::array::from_fn(|i| motors.bend_rad[i] - bends[i]);
        if !distance_rad.iter().all(|rad| rad.is_finite()) {
            return;
        }
        let known = &mut self.known[usize::from(measured_bends::is_of_cables(measured))];
        match known {
            Some(known) => known.add(&distance_rad, motors, measured.measured_ns, obeys),
            None if obeys => {
                *known = Some(Known {
                    load_rad: distance_rad,
                    present_rad: distance_rad,
                    motors_rad: motors.bend_rad,
                    first_ns: measured.measured_ns,
                    measured_ns: measured.measured_ns,
                    is_settled: false,
                });
            }
            None => {}
        }
    }

    /// The robot is where this load has kept it beside its motors: nobody has moved it, and nothing holds it. Of a distance
    /// that no reset accepts by itself, nothing is known.
    pub(super) fn explains_distance(&self) -> bool {
        let mut known = self.known.iter().flatten().peekable();
        known.peek().is_some() && known.all(Known::explains_distance)
    }
}

impl Known {
    fn add(
        &mut self,
        distance_rad: &Bends,
        motors: &CommandedPosition,
        measured_ns: u64,
        obeys: bool,
    ) {
        let passed_ns = measured_ns.saturating_sub(self.measured_ns);
        let passed_s = (1e-9 * passed_ns as f64).min(STEP_MAX_S);
        self.measured_ns = measured_ns;
        self.is_settled |= obeys && measured_ns.saturating_sub(self.first_ns) >= FIRST_NS;
        for (i, distance_rad) in distance_rad.iter().enumerate() {
            let present_rad = &mut self.present_rad[i];
            *present_rad += passed_s / PRESENT_S * (distance_rad - *present_rad);
            if obeys && !self.is_settled {
                self.load_rad[i] = *present_rad;
            } else if obeys {
                let way_rad = (motors.bend_rad[i] - self.motors_rad[i]).abs();
                let part = (way_rad / WAY_RAD).min(1.0);
                self.load_rad[i] += part * (distance_rad - self.load_rad[i]);
            }
        }
        self.motors_rad = motors.bend_rad;
    }

    fn explains_distance(&self) -> bool {
        let mut pairs = self.present_rad.iter().zip(&self.load_rad);
        let is_explained = pairs.all(|(present_rad, load_rad)| {
            (present_rad - load_rad).abs() <= BEND_TOLERANCE_RAD
                && present_rad.abs() <= POSE_DIFFERS_RAD
        });
        self.is_settled && is_explained
    }
}
