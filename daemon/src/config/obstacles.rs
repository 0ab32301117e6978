use serde::{Deserialize, Serialize};

/// What happens when a source of obstacles is silent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum SourceSilent {
    /// The robot holds until the source is heard again, or a client clears the obstacles. They stay meanwhile.
    #[default]
    Hold,
    /// The obstacles stay, and the robot goes on.
    Keep,
}

cdcr_controller::parameters! {
    /// Those who send obstacles.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[cfg_attr(test, derive(schemars::JsonSchema))]
    #[serde(default, deny_unknown_fields)]
    pub struct ObstaclesConfig {
        /// A source of obstacles, that is a client that has sent one with a limited lifetime, which sends nothing for this long is
        /// silent, {range}; 0: nobody is watched, and obstacles expire whatever became of their source. With a timeout an
        /// obstacle expires only while its source lives: when that is heard after the lifetime and has not renewed it. Clearing
        /// the obstacles ends the watch over all sources.
        source_timeout_ms: f64 = 0.0, in 0.0..=60_000.0;
        /// What happens when a source is silent. "hold": the robot holds until the source is heard again, or a client clears the
        /// obstacles. "keep": the robot goes on. With both the obstacles stay where the source saw them last.
        source_silent: SourceSilent = SourceSilent::Hold;
    }
}
