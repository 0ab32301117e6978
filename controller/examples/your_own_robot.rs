//! A robot that is not the paper's: a short stiff section that carries a long slim one, with slow winches. Its tip goes to a
//! point, and stays.
//!
//! ```sh
//! cargo run --release -p cdcr-controller --example your_own_robot
//! ```

use std::error::Error;

use cdcr_controller::closed_loop::ClosedLoop;
use cdcr_controller::nmpc::{Nmpc, NmpcSettings};
use cdcr_controller::reference::{ReferenceSample, ReferenceState};
use cdcr_controller::robot::{Configuration, Robot, RobotParameters, SectionParameters};

const PERIOD_S: f64 = 0.01;

/// Prints how long it takes.
pub fn main() -> Result<(), Box<dyn Error>> {
    let stiff = SectionParameters {
        length_m: 0.12,
        cable_radius_m: 0.02,
        cable_offset_rad: 0.0,
        bend_max_rad: 1.0,
        rate_max_rad_s: 0.8,
        body_radius_m: 0.025,
    };
    let slim = SectionParameters {
        length_m: 0.4,
        cable_radius_m: 0.008,
        cable_offset_rad: 60_f64.to_radians(),
        bend_max_rad: 2.5,
        rate_max_rad_s: 1.5,
        body_radius_m: 0.01,
    };
    let robot = Robot::new(&RobotParameters {
        sections: vec![stiff, slim],
        cable_speed_max_m_s: 0.01,
        cable_stroke_max_m: 0.03,
    })?;
    let settings = NmpcSettings::default();
    let mut nmpc = Nmpc::new(robot.clone(), PERIOD_S, settings)?;

    let there = Configuration::from_bend_angles(&[[0.5, 0.3], [1.2, 2.0]]);
    let goal_m = robot.tip_position(&there);
    let goal = |_: f64| ReferenceSample {
        state: ReferenceState::Inside,
        position_m: goal_m,
        ..ReferenceSample::default()
    };
    let start = Configuration::straight(2);
    let mut closed =
        ClosedLoop::new(&robot, PERIOD_S, settings, start, &[], goal)?.with_acceleration(5.0);
    while closed.error_m() > 1e-6 {
        closed.step(&mut nmpc);
        if closed.time_s() > 10.0 {
            return Err("the point was not reached".into());
        }
    }
    println!("reached after {:.2} s", closed.time_s());
    Ok(())
}
