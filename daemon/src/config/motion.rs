use serde::{Deserialize, Serialize};

/// Time that a robot has to come to rest when the process ends \[s\]. The unit gives the process a little more.
pub const REST_MAX_S: f64 = 10.0;

/// Motions that the daemon makes by itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct MotionConfig {
    /// How fast rates shrink when holding or stopping \[rad/s²\].
    pub deceleration_rad_s2: f64,
    /// How fast the rate of a component may grow \[rad/s²\]; 0: as the link says, see
    /// [`ACCELERATION_RAD_S2`](Self::ACCELERATION_RAD_S2). Slowing down is always allowed.
    pub acceleration_rad_s2: f64,
    /// Rate of the fastest component on the way home \[rad/s\].
    pub home_rate_rad_s: f64,
    /// Home is reached when all bends stay below this \[rad\].
    pub home_tolerance_rad: f64,
}

impl MotionConfig {
    /// Largest acceleration of a robot behind a driver whose configuration has none \[rad/s²\].
    pub const ACCELERATION_RAD_S2: f64 = 40.0;
}

impl Default for MotionConfig {
    fn default() -> Self {
        Self {
            deceleration_rad_s2: 40.0,
            acceleration_rad_s2: 0.0,
            home_rate_rad_s: 0.5,
            home_tolerance_rad: 0.01,
        }
    }
}
