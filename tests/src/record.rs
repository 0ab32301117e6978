//! Conversions of a telemetry record: robot, state and obstacles for the controller.

use cdcr_client::{model, obstacles};
use cdcr_controller::robot::{Configuration, Obstacle, Robot};
use cdcr_daemon::convert;
use cdcr_shared_types::{RobotDescription, Telemetry};

pub fn robot_of(description: &RobotDescription) -> Robot {
    model::robot_of(description).expect("a robot that a daemon runs")
}

/// The obstacles of a record as used by plan and guard: at the time when the robot has executed its commands.
pub fn obstacles_of(record: &Telemetry) -> Vec<Obstacle> {
    let lead_s = record.reference_lead_ns as f64 * 1e-9;
    let used = obstacles(record).iter();
    let known = used.map(|obstacle| convert::obstacle(obstacle, record.release_ns));
    known
        .map(|known| known.expect("it was accepted").obstacle.moved(lead_s))
        .collect()
}

/// The estimated state of a record.
pub fn configuration_of(record: &Telemetry) -> Configuration {
    let width = 2 * record.robot.sections as usize;
    Configuration::from_slice(&record.bend_rad[..width]).expect("one to six sections")
}

/// Largest absolute rate \[rad/s\]. Fails if one is not finite, which `f64::max` would ignore.
pub fn largest(rates: &[f64]) -> f64 {
    assert!(rates.iter().all(|rate| rate.is_finite()), "{rates:?}");
    rates.iter().fold(0.0, |most, rate| rate.abs().max(most))
}

#[cfg(test)]
mod tests {
    use super::largest;

    #[test]
    #[should_panic(expected = "NaN")]
    fn what_is_not_finite_is_no_rest() {
        let _ = largest(&[0.0, f64::NAN, 0.0]);
    }
}
