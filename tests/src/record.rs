//! A telemetry record as the controller sees it: the robot, its state, the obstacles around it.

use cdcr_client::{model, obstacles};
use cdcr_controller::robot::{Configuration, Obstacle, Robot};
use cdcr_daemon::convert;
use cdcr_shared_types::{RobotDescription, Telemetry};

pub fn robot_of(description: &RobotDescription) -> Robot {
    model::robot_of(description).expect("a robot that a daemon runs")
}

/// The obstacles of a record as plan and guard took them: where they are when the robot is where its commands lead it.
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

/// The largest of some rates, without their signs \[rad/s\]. Fails where one is not finite: `f64::max` does not see that.
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
