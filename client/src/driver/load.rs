//! A load keeps a robot beside the place where its motors stand: sag, and the droop of servos.

use cdcr_shared_types::limits::{BEND_TOLERANCE_RAD, COORDINATES_MAX, POSE_DIFFERS_RAD};
use cdcr_shared_types::{Measurement, RobotDescription};

use super::{CommandedPosition, bounds, measured_bends};

type Bends = [f64; COORDINATES_MAX];

/// Way of the motors, in their fastest bend component, over which the distance is averaged \[rad\]. A robot that jams or presses
/// against something stays behind by the way of its motors: its distance is far from the average then, however long it lasts.
const WAY_RAD: f64 = 1.0;
/// Faster motion is not counted: it leaves the robot behind by the lag of its motors \[rad/s\].
const SLOW_RAD_S: f64 = 0.3;
/// At first the distance is that of this time of obeying, also of motors at rest \[ns\].
const FIRST_NS: u64 = 1_000_000_000;
/// Time constant of the present distance, and of the first one \[s\]: a single measurement may be wrong.
const PRESENT_S: f64 = 0.05;
/// Longest time that one measurement counts for \[s\].
const STEP_MAX_S: f64 = 0.02;

/// Distance of the motors from the measured robot.
#[derive(Debug, Clone, Default)]
pub(super) struct Load {
    /// By measured bends, and by measured cables.
    known: [Option<MeasuredLoad>; 2],
}

#[derive(Debug, Clone, Copy)]
struct MeasuredLoad {
    /// The distance while the motors moved the robot \[rad\].
    load_rad: Bends,
    present_rad: Bends,
    /// Motors at the newest measurement \[rad\].
    motors_rad: Bends,
    measured_ns: u64,
    /// Time in which the motors obeyed \[ns\].
    obeyed_ns: u64,
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
        let known = &mut self.known[usize::from(measured_bends::is_of_cables(measured))];
        // A driver tells its newest one in each turn.
        if (*known).is_some_and(|known| known.measured_ns == measured.measured_ns) {
            return;
        }
        let bends = measured_bends::bends_rad(robot, measured);
        let used = 2 * bounds::sections(robot).len();
        let distance_rad: Bends = core::array::from_fn(|i| {
            if i < used {
                motors.bend_rad[i] - bends[i]
            } else {
                0.0
            }
        });
        if !distance_rad.iter().all(|rad| rad.is_finite()) {
            return;
        }
        match known {
            Some(known) => known.add(&distance_rad, motors, measured.measured_ns, obeys),
            None if obeys => {
                *known = Some(MeasuredLoad {
                    load_rad: distance_rad,
                    present_rad: distance_rad,
                    motors_rad: motors.bend_rad,
                    measured_ns: measured.measured_ns,
                    obeyed_ns: 0,
                });
            }
            None => {}
        }
    }

    /// The robot is where this load has kept it beside its motors: nobody has moved it, and nothing holds it. Of a distance
    /// that no reset accepts by itself, nothing is known.
    pub(super) fn explains_distance(&self) -> bool {
        let known = || self.known.iter().flatten();
        let newest_ns = known().map(|known| known.measured_ns).max();
        newest_ns.is_some_and(|newest_ns| {
            // A kind that is measured no more says nothing.
            let mut present = known().filter(|known| newest_ns - known.measured_ns < FIRST_NS);
            present.all(MeasuredLoad::explains_distance)
        })
    }
}

impl MeasuredLoad {
    fn change_rad(&self) -> f64 {
        let pairs = self.present_rad.iter().zip(&self.load_rad);
        pairs.fold(0.0, |most, (present_rad, load_rad)| {
            most.max((present_rad - load_rad).abs())
        })
    }

    fn add(
        &mut self,
        distance_rad: &Bends,
        motors: &CommandedPosition,
        measured_ns: u64,
        obeys: bool,
    ) {
        let passed_ns = measured_ns.saturating_sub(self.measured_ns);
        let passed_s = 1e-9 * passed_ns as f64;
        let ways = motors.bend_rad.iter().zip(&self.motors_rad);
        let way_rad = ways.fold(0.0_f64, |most, (now, before)| {
            most.max((now - before).abs())
        });
        (self.measured_ns, self.motors_rad) = (measured_ns, motors.bend_rad);
        let counts = obeys && way_rad <= SLOW_RAD_S * passed_s;
        let is_first = self.obeyed_ns < FIRST_NS;
        self.obeyed_ns += if obeys { passed_ns } else { 0 };
        for (i, distance_rad) in distance_rad.iter().enumerate() {
            let present_rad = &mut self.present_rad[i];
            *present_rad += passed_s.min(STEP_MAX_S) / PRESENT_S * (distance_rad - *present_rad);
            if counts && is_first {
                self.load_rad[i] = *present_rad;
            } else if counts {
                let part = (way_rad / WAY_RAD).min(1.0);
                self.load_rad[i] += part * (distance_rad - self.load_rad[i]);
            }
        }
    }

    fn explains_distance(&self) -> bool {
        let mut distances_rad = self.present_rad.iter();
        self.obeyed_ns >= FIRST_NS
            && self.change_rad() <= BEND_TOLERANCE_RAD
            && distances_rad.all(|rad| rad.abs() <= POSE_DIFFERS_RAD)
    }
}
