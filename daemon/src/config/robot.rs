use cdcr_controller::robot::{Robot, RobotError, RobotParameters, SectionParameters};
use cdcr_shared_types::Service;
use serde::{Deserialize, Serialize};

use super::{ConfigError, Origins};

/// What the robot is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct RobotConfig {
    /// Name of the robot in the service names.
    pub name: String,
    /// Largest speed of a cable \[m/s\].
    pub cable_speed_max_m_s: f64,
    /// How far a cable can be pulled or paid out from its length at the straight robot \[m\].
    pub cable_stroke_max_m: f64,
    /// The sections, base first.
    pub sections: Vec<SectionParameters>,
}

impl Default for RobotConfig {
    fn default() -> Self {
        let RobotParameters {
            sections,
            cable_speed_max_m_s,
            cable_stroke_max_m,
        } = RobotParameters::paper(3);
        Self {
            name: "cdcr".to_owned(),
            cable_speed_max_m_s,
            cable_stroke_max_m,
            sections,
        }
    }
}

impl RobotConfig {
    /// The robot that the keys describe.
    pub(super) fn robot(&self, origins: &Origins) -> Result<Robot, ConfigError> {
        Service::Status
            .name(&self.name)
            .map_err(|error| origins.error(&["robot.name"], &error.to_string()))?;
        let parameters = RobotParameters {
            sections: self.sections.clone(),
            cable_speed_max_m_s: self.cable_speed_max_m_s,
            cable_stroke_max_m: self.cable_stroke_max_m,
        };
        Robot::new(&parameters)
            .map_err(|error| origins.error(&[&key_of(&error)], &error.to_string()))
    }
}

/// The configuration key that a robot error speaks of.
fn key_of(error: &RobotError) -> String {
    match error {
        RobotError::SectionCount { .. } => "robot.sections".to_owned(),
        RobotError::Section { section, key, .. } | RobotError::CableRadius { section, key, .. } => {
            format!("robot.sections[{}].{key}", section - 1)
        }
        RobotError::Whole { key, .. } => format!("robot.{key}"),
    }
}
