//! A ball lies on the path of the tip: the robot passes around it, keeps the safe distance, and returns to the
//! reference.
//! `cargo run --release -p cdcr-controller --example avoid_an_obstacle`

use cdcr_controller::closed_loop::ClosedLoop;
use cdcr_controller::nmpc::NmpcSettings;
use cdcr_controller::reference::ReferenceSample;
use cdcr_controller::robot::{Configuration, Obstacle, Robot, RobotParameters};
use nalgebra::{Rotation3, Vector3};

/// Prints the smallest clearance, the largest error, and the error at the end.
pub fn main() -> Result<(), Box<dyn std::error::Error>> {
    let robot = Robot::new(&RobotParameters::paper(2))?;
    let start = Configuration::from_bend_angles(&[[0.4, 0.0], [0.5, 0.0]]);
    let tip_m = robot.tip_position(&start);
    let circle =
        |time_s: f64| ReferenceSample::at_position(Rotation3::new(Vector3::z() * time_s) * tip_m);
    let ball = Obstacle::ball(circle(1.5).position_m + Vector3::new(0.0, 0.02, 0.03), 0.02)?;
    // A horizon of 0.1 s: the detour begins before the obstacle is reached.
    let settings = NmpcSettings {
        horizon_steps: 20,
        ..NmpcSettings::default()
    };
    let mut closed = ClosedLoop::new(&robot, 0.005, settings, start, &[ball], circle)?;
    let run = closed.run(3.0)?;
    println!("{run:?}, last error {:.1e} m", closed.error_m());
    let is_clear = run.clearance_min_m > settings.safe_distance_m - 1e-9;
    if !is_clear || run.error_max_m < 1e-3 || closed.error_m() > 1e-6 {
        return Err("the way round was not found".into());
    }
    Ok(())
}
