use serde::{Deserialize, Serialize};

/// How the configuration of the robot is estimated.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct EstimatorConfig {
    /// Time constant with which the estimate follows what is measured \[ms\]; 0: at once.
    pub time_constant_ms: f64,
}

impl Default for EstimatorConfig {
    fn default() -> Self {
        Self {
            time_constant_ms: 100.0,
        }
    }
}
