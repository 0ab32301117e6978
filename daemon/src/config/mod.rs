//! The configuration: layers of TOML → typed → validated [`Config`].
//!
//! Every key has a default, so an empty file is the paper's robot with three sections. Over the default comes
//! the file, over the file the environment, over that the options ([`Layers`]). A mistake is reported with its
//! place, its key and what is allowed; nothing is silently corrected.
//!
//! | what | is written in |
//! |---|---|
//! | keys, types, defaults | the structs of the tables, here |
//! | constant ranges | `ranges`; the robot's and the controller's with the controller |
//! | rules between keys | `rules` |
//! | words for people | the comments of `configs/default.toml` |
//!
//! Schema, explanations and error messages are made of these, and tests compare them with each other.

mod actuator;
mod cycle;
mod error;
mod estimator;
mod explain;
mod keys;
mod layers;
mod link;
mod manual;
mod motion;
mod obstacles;
mod origin;
mod ranges;
mod realtime;
mod reference;
mod robot;
mod rules;
mod safety;
mod schema;
mod settings;
mod transport;

use std::path::Path;

use cdcr_controller::nmpc::NmpcSettings;
use cdcr_controller::robot::{Configuration, Robot};
use cdcr_shared_types::Location;
use serde::{Deserialize, Serialize};

pub use actuator::ActuatorConfig;
pub use cycle::CycleConfig;
pub use error::ConfigError;
pub use estimator::EstimatorConfig;
pub use explain::explain;
pub use layers::Layers;
pub use link::{Interface, LinkConfig, LinkKind};
pub use motion::{MotionConfig, REST_MAX_S};
pub use obstacles::{ObstaclesConfig, SourceSilent};
pub use origin::{Origin, Origins};
pub use realtime::{RealtimeConfig, RealtimeMode};
pub use reference::ReferenceConfig;
pub use robot::RobotConfig;
pub use safety::SafetyConfig;
pub use schema::SCHEMA_TEXT;
pub use settings::Settings;
pub use transport::TransportConfig;

/// The default configuration as a commented file: what `cdcrd config default` prints.
pub const DEFAULT_TEXT: &str = include_str!("../../../configs/default.toml");

/// Everything a user can set.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// What the robot is.
    pub robot: RobotConfig,
    /// Where measurements come from and commands go to.
    pub link: LinkConfig,
    /// How the robot's motors follow their commands.
    pub actuator: ActuatorConfig,
    /// How the configuration of the robot is estimated.
    pub estimator: EstimatorConfig,
    /// The period and what counts as late.
    pub cycle: CycleConfig,
    /// Motions that the daemon makes by itself.
    pub motion: MotionConfig,
    /// What counts as a fault of the robot, its sensors or its surroundings.
    pub safety: SafetyConfig,
    /// Those who send obstacles.
    pub obstacles: ObstaclesConfig,
    /// The reference and its lease.
    pub reference: ReferenceConfig,
    /// The optimal control problem and its solver.
    pub controller: NmpcSettings,
    /// Threads, priorities, memory.
    pub realtime: RealtimeConfig,
    /// Where in shared memory daemon and clients meet.
    pub transport: TransportConfig,
}

/// A configuration whose every part was checked, as domain values.
#[derive(Debug, Clone)]
pub struct Validated {
    /// The configuration as written, but for what depends on the kind of robot and was left to that: `realtime.mode`.
    pub config: Config,
    /// The robot.
    pub robot: Robot,
    /// Where its simulation, or the estimate, begins.
    pub initial: Configuration,
    /// Where daemon and clients meet.
    pub location: Location,
    /// The group that may take part, beside the daemon's user.
    pub group_id: Option<u32>,
}

/// Nanoseconds of a duration in milliseconds that was validated.
pub fn ns(milliseconds: f64) -> u64 {
    (milliseconds * 1e6).round() as u64
}

impl Config {
    /// Reads and checks a file, and nothing but the file.
    ///
    /// # Errors
    /// [`ConfigError`] with file, line, key and remedy.
    pub fn load(path: &Path) -> Result<Validated, ConfigError> {
        Layers::default().file(path)?.settings()?.validate()
    }

    /// Checks a text; `file` is for the messages.
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn parse(text: &str, file: &Path) -> Result<Validated, ConfigError> {
        Layers::default().text(text, file)?.settings()?.validate()
    }

    /// Checks a configuration that came from no file.
    ///
    /// # Errors
    /// As [`Config::load`], without a line.
    pub fn check(self) -> Result<Validated, ConfigError> {
        Settings::from(self).validate()
    }
}

#[cfg(test)]
mod tests;
