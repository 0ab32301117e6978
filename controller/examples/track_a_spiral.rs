//! The paper's first simulation (Eq. 8): the tip of three sections follows a spiral.
//! `cargo run --release -p cdcr-controller --example track_a_spiral`

use cdcr_controller::closed_loop::ClosedLoop;
use cdcr_controller::nmpc::NmpcSettings;
use cdcr_controller::reference::ReferenceSample;
use cdcr_controller::robot::{Configuration, Robot, RobotParameters};

/// Prints the largest error.
pub fn main() -> Result<(), Box<dyn std::error::Error>> {
    let robot = Robot::new(&RobotParameters::paper(3))?;
    // The spiral is the path of the tip when the last section bends by 2t/15 towards t and the others are straight.
    let bent = |t: f64| Configuration::from_bend_angles(&[[0.0; 2], [0.0; 2], [2.0 * t / 15.0, t]]);
    let begin_s = 5_f64.to_radians();
    let spiral = |time_s| ReferenceSample::at_position(robot.tip_position(&bent(begin_s + time_s)));

    let settings = NmpcSettings::default();
    let mut closed = ClosedLoop::new(&robot, 0.005, settings, bent(begin_s), &[], spiral)?;
    let largest_m = closed.run(4.97)?.error_max_m;
    println!("largest error: {:.1e} mm", 1e3 * largest_m);
    if largest_m > 1e-9 {
        return Err("the spiral was lost".into());
    }
    Ok(())
}
