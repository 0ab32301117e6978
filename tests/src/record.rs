//! A telemetry record as the controller sees it: the robot, its state, the obstacles around it.

use cdcr_client::obstacles;
use cdcr_controller::robot::{Configuration, Obstacle, Robot, RobotParameters, SectionParameters};
use cdcr_daemon::convert;
use cdcr_shared_types::{RobotDescription, SectionDescription, Telemetry};

/// The robot of a description.
pub fn robot_of(description: &RobotDescription) -> Robot {
    let used = &description.section[..description.sections as usize];
    let section = |section: &SectionDescription| SectionParameters {
        length_m: section.length_m,
        cable_radius_m: section.cable_radius_m,
        cable_offset_rad: section.cable_offset_rad,
        bend_max_rad: section.bend_max_rad,
        rate_max_rad_s: section.rate_max_rad_s,
        body_radius_m: section.body_radius_m,
    };
    let parameters = RobotParameters {
        sections: used.iter().map(section).collect(),
        cable_speed_max_m_s: description.cable_speed_max_m_s,
        cable_stroke_max_m: description.cable_stroke_max_m,
    };
    Robot::new(&parameters).expect("a robot that a daemon runs")
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

/// The largest of some rates, without their signs \[rad/s\].
pub fn largest(rates: &[f64]) -> f64 {
    rates.iter().fold(0.0, |most, rate| rate.abs().max(most))
}
