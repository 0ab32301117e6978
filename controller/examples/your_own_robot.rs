//! A robot other than the paper's, with slow winches: its tip moves to a point and rests there.
//! `cargo run --release -p cdcr-controller --example your_own_robot`

use cdcr_controller::closed_loop::ClosedLoop;
use cdcr_controller::nmpc::NmpcSettings;
use cdcr_controller::reference::ReferenceSample;
use cdcr_controller::robot::{Configuration, Robot, RobotParameters};

/// Prints the error at the end.
pub fn main() -> Result<(), Box<dyn std::error::Error>> {
    // A short stiff section carries a long slim one. Further fields of `SectionParameters` are taken from the paper's
    // robot.
    let mut parameters = RobotParameters::paper(2);
    parameters.sections[0].length_m = 0.12;
    parameters.sections[0].bend_max_rad = 1.0;
    parameters.sections[1].length_m = 0.4;
    parameters.sections[1].body_radius_m = 0.01;
    parameters.cable_speed_max_m_s = 0.01;
    let robot = Robot::new(&parameters)?;

    let there = Configuration::from_bend_angles(&[[0.5, 0.3], [1.2, 2.0]]);
    let goal = ReferenceSample::at_position(robot.tip_position(&there));
    let (settings, start) = (NmpcSettings::default(), Configuration::straight(2));
    let mut closed = ClosedLoop::new(&robot, 0.01, settings, start, &[], |_| goal)?;
    closed.run(10.0)?;
    println!("error after 10 s: {:.1e} mm", 1e3 * closed.error_m());
    if closed.error_m() > 1e-6 {
        return Err("the point was not reached".into());
    }
    Ok(())
}
