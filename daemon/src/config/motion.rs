use serde::{Deserialize, Serialize};

/// Time that a robot has to come to rest when the process ends \[s\]. The unit gives the process a little more.
pub const REST_MAX_S: f64 = 10.0;

cdcr_controller::parameters! {
    /// Motions that the daemon makes by itself.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[cfg_attr(test, derive(schemars::JsonSchema))]
    #[serde(default, deny_unknown_fields)]
    pub struct MotionConfig {
        /// How fast the rates shrink when holding or stopping, {range}.
        deceleration_rad_s2: f64 = 40.0, in 0.01..=1e6;
        /// How fast the rate of a component may grow, {range}; 0: 40, and no limit for the ideal simulated
        /// robot. Slowing down is always allowed.
        acceleration_rad_s2: f64 = 0.0, in 0.0..=1e6;
        /// Rate of the fastest component on the way home, {range}.
        home_rate_rad_s: f64 = 0.5, in 1e-3..=100.0;
        /// Home is reached when the robot is exactly straight, or when all components of the bend stay below this for
        /// 0.1 s, {range}. Choose more than the noise of your sensors.
        home_tolerance_rad: f64 = 0.01, in 1e-6..=1.0;
    }
}

impl MotionConfig {
    /// Largest acceleration of a robot behind a driver whose configuration has none \[rad/s²\].
    pub const ACCELERATION_RAD_S2: f64 = 40.0;
}
