use serde::{Deserialize, Serialize};

use super::LinkKind;

/// What happens when a source of obstacles is silent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum SourceSilent {
    /// The robot holds until the source sends again, or a client clears the obstacles. They stay meanwhile.
    #[default]
    Hold,
    /// The obstacles stay, and the robot goes on.
    Keep,
}

table! {
    /// Supervision of the sources of obstacles.
    pub struct ObstaclesConfig {
        /// A client that has sent an obstacle with a limited lifetime is a source. A source that sends nothing for this long is
        /// silent, {range}; -1: 500 with link.kind = "driver", 0 with "simulated"; 0: sources are not supervised, and obstacles
        /// expire whatever became of their source. With a timeout an obstacle expires only while its source lives: when a message of
        /// it arrives after the lifetime and has not renewed the obstacle. Supervision of a source ends when it removes its last
        /// obstacle, and that of all sources when a client clears the obstacles; the next obstacle with a lifetime begins it again.
        source_timeout_ms: f64 = -1.0, in -1.0..=60_000.0;
        /// What happens when a source is silent. "hold": the robot holds until the source sends again, or a client clears the
        /// obstacles. "keep": the robot goes on. With both the obstacles stay where the source saw them last.
        source_silent: SourceSilent = SourceSilent::Hold;
    }
}

impl ObstaclesConfig {
    /// Timeout of the sources of a robot behind a driver, where the configuration leaves it to the kind of robot \[ms\].
    const DRIVER_SOURCE_TIMEOUT_MS: f64 = 500.0;

    /// The timeout in force for a robot \[ms\].
    pub(super) fn source_timeout_ms(&self, robot: LinkKind) -> f64 {
        match (self.source_timeout_ms, robot) {
            (-1.0, LinkKind::Driver) => Self::DRIVER_SOURCE_TIMEOUT_MS,
            (-1.0, LinkKind::Simulated) => 0.0,
            (timeout_ms, _) => timeout_ms,
        }
    }
}
