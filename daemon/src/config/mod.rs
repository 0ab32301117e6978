//! The configuration: layers of TOML → typed → validated [`Config`].
//!
//! Every key has a default, so an empty file is the paper's robot with three sections. The file overrides the
//! defaults, the environment overrides the file, and options override the environment ([`Layers`]). An error
//! names its place, its key and the allowed values; no value is silently corrected.
//!
//! A key is declared once, in the struct of its table (`table!`): name, type, default, range and description.
//! The default file, the schema, explanations and error messages are generated from it, and tests compare the
//! committed files. Rules between keys are in `rules`.

/// A table of the configuration: parameters read from TOML, each with a default.
macro_rules! table {
    ($(#[$doc:meta])* pub struct $($table:tt)+) => {
        cdcr_controller::parameters! {
            $(#[$doc])*
            #[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
            #[cfg_attr(test, derive(schemars::JsonSchema))]
            #[serde(default, deny_unknown_fields, expecting = "a table")]
            pub struct $($table)+
        }
    };
}

/// The whole configuration, table by table.
macro_rules! tables {
    ($($(#[doc = $doc:literal])+ $name:ident: $table:ty;)+) => {
        table! {
            /// All configuration keys.
            pub struct Config { $($(#[doc = $doc])+ $name: $table = <$table>::default();)+ }
        }

        /// The tables with the declarations of their keys.
        const TABLES: &[(&str, &[UserParameter])] = &[$((stringify!($name), <$table>::PARAMETERS),)+];
    };
}

mod control;
mod error;
mod explain;
mod keys;
mod layers;
mod link;
mod origin;
mod realtime;
mod robot;
mod rules;
mod settings;
mod transport;

use std::path::Path;

use cdcr_controller::nmpc::NmpcSettings;
use cdcr_controller::parameters::UserParameter;
use cdcr_controller::plant::Flaws;
use cdcr_controller::robot::{Configuration, Robot};
use cdcr_shared_types::Location;

pub use control::{
    ActuatorConfig, ApproachKind, CycleConfig, EstimatorConfig, MotionConfig, ObstaclesConfig,
    REST_MAX_S, ReferenceConfig, SafetyConfig, SourceSilent,
};
pub use error::ConfigError;
use error::Result;
pub use explain::{SCHEMA_TEXT, explain};
pub(crate) use keys::changed as changed_keys;
pub use layers::Layers;
pub use link::{Interface, LinkConfig, LinkKind, TipSensor};
pub use origin::Origins;
pub use realtime::{RealtimeConfig, RealtimeMode};
pub use robot::RobotConfig;
pub(crate) use rules::numbers;
pub use settings::ConfigDraft;
pub use transport::TransportConfig;

/// The default configuration as a commented file, printed by `cdcrd config default`.
pub const DEFAULT_TEXT: &str = include_str!("../../../configs/default.toml");

tables! {
    /// Geometry and limits of the robot.
    robot: RobotConfig;
    /// Source of measurements and receiver of commands.
    link: LinkConfig;
    /// Dynamics of the motors. They are compensated: measurements are extrapolated along the motion of the motors, which are commanded
    /// ahead of the reference by the sum of delay and time constant.
    actuator: ActuatorConfig;
    /// Estimator of the robot's configuration.
    estimator: EstimatorConfig;
    /// Period, deadline, time budget and lateness.
    cycle: CycleConfig;
    /// Motions that the daemon plans itself.
    motion: MotionConfig;
    /// Limits beyond which robot, sensors or obstacles cause a fault.
    safety: SafetyConfig;
    /// Supervision of the sources of obstacles.
    obstacles: ObstaclesConfig;
    /// The reference and its lease.
    reference: ReferenceConfig;
    /// The optimal control problem and its solver.
    controller: NmpcSettings;
    /// Threads, priorities, memory.
    realtime: RealtimeConfig;
    /// Location of daemon and clients in shared memory.
    transport: TransportConfig;
}

/// A validated configuration, as domain values.
#[derive(Debug, Clone)]
pub struct Validated {
    /// The configuration as written, with the values in force for keys that depend on the kind of robot:
    /// `realtime.mode`, `obstacles.source_timeout_ms` and `controller.rate_weight`.
    pub config: Config,
    pub robot: Robot,
    /// True geometry of the simulated robot, if configured.
    pub truth: Option<Robot>,
    /// Flaws of the simulated robot.
    pub flaws: Flaws,
    /// Initial configuration of the simulation, or of the estimate.
    pub initial: Configuration,
    /// Location of the shared-memory files.
    pub location: Location,
    /// Group with access in addition to the daemon's user.
    pub group_id: Option<u32>,
}

/// Nanoseconds of a validated duration in milliseconds.
pub fn ns(milliseconds: f64) -> u64 {
    (milliseconds * 1e6).round() as u64
}

impl Config {
    /// Reads and validates a file, without environment and options.
    pub fn load(path: &Path) -> Result<Validated> {
        Layers::default().file(path)?.settings()?.validate()
    }

    /// Validates a text; `file` is for messages.
    pub fn parse(text: &str, file: &Path) -> Result<Validated> {
        Layers::default().text(text, file)?.settings()?.validate()
    }

    /// Validates a configuration that came from no file.
    pub fn check(self) -> Result<Validated> {
        ConfigDraft::new(self, Origins::default()).validate()
    }
}

#[cfg(test)]
mod tests;
