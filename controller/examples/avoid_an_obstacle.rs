//! A ball lies where the tip is to pass: the robot goes round it, keeps its distance, and goes on.
//!
//! ```sh
//! cargo run --release -p cdcr-controller --example avoid_an_obstacle
//! ```

use std::error::Error;

use cdcr_controller::closed_loop::ClosedLoop;
use cdcr_controller::nmpc::{Nmpc, NmpcSettings};
use cdcr_controller::reference::{ReferenceSample, ReferenceState};
use cdcr_controller::robot::{Configuration, Obstacle, Robot, RobotParameters, Shape};
use nalgebra::Vector3;

const PERIOD_S: f64 = 0.005;

/// Prints the smallest clearance, and the error at the end.
pub fn main() -> Result<(), Box<dyn Error>> {
    let robot = Robot::new(&RobotParameters::paper(2))?;
    // A horizon of 0.1 s: the detour begins before the obstacle is reached.
    let settings = NmpcSettings {
        horizon_steps: 20,
        safe_distance_m: 0.01,
        ..NmpcSettings::default()
    };
    let mut nmpc = Nmpc::new(robot.clone(), PERIOD_S, settings)?;

    let start = Configuration::from_bend_angles(&[[0.4, 0.0], [0.5, 0.0]]);
    let tip_m = robot.tip_position(&start);
    let circle_m = |time_s: f64| {
        let (sin, cos) = time_s.sin_cos();
        Vector3::new(tip_m.x * cos, tip_m.x * sin, tip_m.z)
    };
    let centre_m = circle_m(1.5) + Vector3::new(0.0, 0.02, 0.03);
    let ball = Obstacle::new(Shape::Sphere { centre_m }, 0.02, Vector3::zeros())?;
    let circle = |time_s: f64| ReferenceSample {
        state: ReferenceState::Inside,
        position_m: circle_m(time_s),
        ..ReferenceSample::default()
    };

    // As a daemon does: clear for three periods and the ramp that follows, if no other command comes.
    let mut closed = ClosedLoop::new(&robot, PERIOD_S, settings, start, &[ball], circle)?
        .with_stopping(3.0, 40.0);
    let (mut nearest_m, mut farthest_m) = (f64::INFINITY, 0.0_f64);
    while closed.time_s() < 3.0 {
        closed.step(&mut nmpc);
        nearest_m = nearest_m.min(closed.clearance_m());
        farthest_m = farthest_m.max(closed.error_m());
    }
    println!(
        "smallest clearance: {:.3} mm of {} mm; {:.1} mm off at most, {:.1e} mm at the end",
        1e3 * nearest_m,
        1e3 * settings.safe_distance_m,
        1e3 * farthest_m,
        1e3 * closed.error_m()
    );
    if nearest_m > settings.safe_distance_m - 1e-9 && farthest_m > 1e-3 && closed.error_m() < 1e-6 {
        Ok(())
    } else {
        Err("the way round was not found".into())
    }
}
