use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Motions that the daemon makes by itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MotionConfig {
    /// How fast rates shrink when holding or stopping \[rad/s²\].
    pub deceleration_rad_s2: f64,
    /// Rate of the fastest component on the way home \[rad/s\].
    pub home_rate_rad_s: f64,
}

impl Default for MotionConfig {
    fn default() -> Self {
        Self {
            deceleration_rad_s2: 40.0,
            home_rate_rad_s: 0.5,
        }
    }
}
