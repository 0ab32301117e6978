//! The paper's first simulation (Eq. 8): the tip of three sections follows a spiral.
//!
//! ```sh
//! cargo run --release -p cdcr-controller --example track_a_spiral
//! ```

use std::error::Error;

use cdcr_controller::closed_loop::ClosedLoop;
use cdcr_controller::nmpc::{Nmpc, NmpcSettings};
use cdcr_controller::reference::{ReferenceSample, ReferenceState};
use cdcr_controller::robot::{Configuration, Robot, RobotParameters};

const PERIOD_S: f64 = 0.005;

/// Prints the largest error.
pub fn main() -> Result<(), Box<dyn Error>> {
    let robot = Robot::new(&RobotParameters::paper(3))?;
    let settings = NmpcSettings::default();
    let mut nmpc = Nmpc::new(robot.clone(), PERIOD_S, settings)?;

    // The spiral is where the last section's tip goes when it bends by 2t/15 towards t, and the others are straight.
    let bent = |t: f64| Configuration::from_bend_angles(&[[0.0; 2], [0.0; 2], [2.0 * t / 15.0, t]]);
    let begin_s = 5_f64.to_radians();
    let spiral = |time_s: f64| ReferenceSample {
        state: ReferenceState::Inside,
        position_m: robot.tip_position(&bent(begin_s + time_s)),
        ..ReferenceSample::default()
    };

    let mut closed = ClosedLoop::new(&robot, PERIOD_S, settings, bent(begin_s), &[], spiral)?;
    let mut largest_m = 0.0_f64;
    while closed.time_s() < 4.97 {
        closed.step(&mut nmpc);
        largest_m = largest_m.max(closed.error_m());
    }
    println!("largest error: {:.1e} mm", 1e3 * largest_m);
    if largest_m < 1e-9 {
        Ok(())
    } else {
        Err("the spiral was lost".into())
    }
}
