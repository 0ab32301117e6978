use cdcr_controller::robot::{self, Robot, RobotError, RobotParameters, SectionParameters};
use cdcr_shared_types::Service;

use super::Origins;
use super::error::Result;

table! {
    /// Geometry and limits of the robot.
    pub struct RobotConfig {
        /// Name of the robot in the service names: 1 to 40 letters, digits, '-' and '_'.
        name: String = "cdcr".to_owned();
        /// Largest speed of a cable, {range}. All rates are scaled down together to respect it.
        cable_speed_max_m_s: f64 = RobotParameters::paper(0).cable_speed_max_m_s, in robot::ranges::CABLE_SPEED_MAX_M_S, usual 0.0..=5.0;
        /// Largest stroke of a cable, pulled or paid out, from the straight robot, {range}. All
        /// rates are scaled down together to respect it.
        cable_stroke_max_m: f64 = RobotParameters::paper(0).cable_stroke_max_m, in robot::ranges::CABLE_STROKE_MAX_M;
        /// Largest commanded speed of the end of any section, the tip included, {range}, and at least 0.001; 0: no limit. All rates are
        /// scaled down together to respect it: it bounds how fast a wrong sensor or model can drive the robot.
        tip_speed_max_m_s: f64 = 0.0, in 0.0..=*robot::ranges::TIP_SPEED_MAX_M_S.end(), usual 0.0..=5.0;
        /// Overlap of two parts of the body, by body_radius_m, that a command may lead to, {range}; as much as the body is thick: no check. Rates that
        /// would lead deeper are scaled down together; a robot that is deeper already may only move out. A trunk that coils on purpose
        /// sets it to 2.
        self_overlap_max_m: f64 = RobotParameters::paper(0).self_overlap_max_m, in robot::ranges::SELF_OVERLAP_MAX_M;
        /// Bending sections, base first: 1 to 6 tables, each with every key.
        sections: Vec<SectionParameters> = RobotParameters::paper(3).sections;
    }
}

impl RobotConfig {
    /// Length of the robot \[m\].
    pub(crate) fn length_m(&self) -> f64 {
        self.sections.iter().map(|s| s.length_m).sum()
    }

    /// Largest rate of any section \[rad/s\].
    pub(crate) fn fastest_rad_s(&self) -> f64 {
        let rates = self.sections.iter().map(|s| s.rate_max_rad_s);
        rates.fold(0.0, f64::max)
    }

    /// Largest stroke of a cable with every section at its largest bend \[m\].
    pub(crate) fn full_stroke_m(&self) -> f64 {
        self.strokes_m().sum()
    }

    /// Motion of a cable of one section at full bend, of the section in which it is least \[m\].
    pub(crate) fn least_stroke_m(&self) -> f64 {
        self.strokes_m().fold(f64::INFINITY, f64::min)
    }

    fn strokes_m(&self) -> impl Iterator<Item = f64> {
        let sections = self.sections.iter();
        sections.map(|s| s.cable_radius_m * s.bend_max_rad)
    }

    /// The robot described by the keys.
    pub(super) fn robot(&self, origins: &Origins) -> Result<Robot> {
        let name = Service::Status.name(&self.name);
        name.map_err(|error| origins.error(&["robot.name"], error))?;
        let parameters = RobotParameters {
            sections: self.sections.clone(),
            cable_speed_max_m_s: self.cable_speed_max_m_s,
            cable_stroke_max_m: self.cable_stroke_max_m,
            tip_speed_max_m_s: self.tip_speed_max_m_s,
            self_overlap_max_m: self.self_overlap_max_m,
        };
        Robot::new(&parameters).map_err(|error| origins.error(&[&key_of(&error)], error))
    }
}

/// The configuration key that a robot error concerns.
fn key_of(error: &RobotError) -> String {
    match error {
        RobotError::SectionCount { .. } => "robot.sections".to_owned(),
        RobotError::Section { section, key, .. } | RobotError::CableRadius { section, key, .. } => {
            format!("robot.sections[{}].{key}", section - 1)
        }
        RobotError::Whole { key, .. } => format!("robot.{key}"),
    }
}
