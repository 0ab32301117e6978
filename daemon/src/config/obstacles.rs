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

/// Those who send obstacles.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct ObstaclesConfig {
    /// A source of obstacles with limited lifetimes that sends nothing for this long is silent \[ms\]; 0: nobody is
    /// watched, and obstacles expire whatever became of their source.
    pub source_timeout_ms: f64,
    /// What happens then.
    pub source_silent: SourceSilent,
}
