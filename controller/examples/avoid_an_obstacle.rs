//! A ball lies where the tip is to pass: the robot goes round it, keeps its distance, and goes on.
//! `cargo run --release -p cdcr-controller --example avoid_an_obstacle`

use cdcr_controller::closed_loop::ClosedLoop;
use cdcr_controller::nmpc::NmpcSettings;
use cdcr_controller::reference::ReferenceSample;
use cdcr_controller::robot::{Configuration, Obstacle, Robot, RobotParameters};
use nalgebra::{Rotation3, Vector3};

/// Prints the smallest clearance, and the error at the end.
pub fn main() -> Result<(), Box<dyn std::error::Error>> {
    let robot = Robot::new(&RobotParameters::paper(2))?;
    let start = Configuration::from_bend_angles(&[[0.4, 0.0], [0.5, 0.0]]);
    let tip_m = robot.tip_position(&start);
    let circle_m = |time_s| Rotation3::from_axis_angle(&Vector3::z_axis(), time_s) * tip_m;
    let ball = Obstacle::ball(circle_m(1.5) + Vector3::new(0.0, 0.02, 0.03), 0.02)?;

    // A horizon of 0.1 s: the detour begins before the obstacle is reached.
    let settings = NmpcSettings {
        horizon_steps: 20,
        ..NmpcSettings::default()
    };
    let circle = |time_s| ReferenceSample::at(circle_m(time_s));
    let mut closed = ClosedLoop::new(&robot, 0.005, settings, start, &[ball], circle)?;
    let mut nmpc = closed.solver()?;
    let (mut nearest_m, mut farthest_m) = (f64::INFINITY, 0.0_f64);
    while closed.time_s() < 3.0 {
        closed.step(&mut nmpc);
        nearest_m = nearest_m.min(closed.clearance_m());
        farthest_m = farthest_m.max(closed.error_m());
    }
    let numbers_mm = [nearest_m, farthest_m, closed.error_m()].map(|number_m| 1e3 * number_m);
    println!("smallest clearance, largest and last error: {numbers_mm:.6?} mm");
    let is_clear = nearest_m > settings.safe_distance_m - 1e-9;
    if !is_clear || farthest_m < 1e-3 || closed.error_m() > 1e-6 {
        return Err("the way round was not found".into());
    }
    Ok(())
}
