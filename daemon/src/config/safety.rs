use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What counts as a fault of the robot, its sensors or its surroundings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SafetyConfig {
    /// A clearance below this is a fault \[m\]; 0: contact of body and obstacle.
    pub clearance_fault_m: f64,
    /// A measurement may differ from the one before by this much, beyond what the largest rates can do
    /// \[rad\].
    pub measurement_jump_rad: f64,
    /// So many implausible measurements in a row are a fault; fewer are left out.
    pub measurement_jump_limit: u32,
    /// A measurement that does not change at all while the robot is commanded to move this far is a fault
    /// \[rad\].
    pub measurement_frozen_rad: f64,
}

impl Default for SafetyConfig {
    fn default() -> Self {
        Self {
            clearance_fault_m: 0.0,
            measurement_jump_rad: 0.2,
            measurement_jump_limit: 3,
            measurement_frozen_rad: 0.2,
        }
    }
}
