use serde::{Deserialize, Serialize};

/// What counts as a fault of the robot, its sensors or its surroundings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct SafetyConfig {
    /// A clearance below this is a fault \[m\]; 0: contact of body and obstacle.
    pub clearance_fault_m: f64,
    /// A measured bend component may be this far ahead of where its largest rate can have brought it \[rad\].
    /// Granted once, not anew for each measurement. Twice the largest error of a measurement, or more: then
    /// noise never counts. A coordinate of a tip position: this times the length of the robot.
    pub measurement_jump_rad: f64,
    /// So many implausible measurements in a row are a fault; fewer are left out.
    pub measurement_jump_limit: u32,
    /// A bend component or cable whose measurement does not change at all while it is commanded to move this
    /// far, net, is a fault \[rad\]. More than the sensor resolves, and more than the robot is commanded to
    /// move while a measurement is under way.
    pub measurement_frozen_rad: f64,
    /// A section that is farther from where it is commanded to be than this is a warning \[rad\]. Not judged while only
    /// the tip is measured.
    pub following_warning_rad: f64,
    /// One that is farther than this is a fault \[rad\].
    pub following_fault_rad: f64,
    /// How far the motors may lag behind without an error \[ms\].
    pub following_lag_ms: f64,
}

impl Default for SafetyConfig {
    fn default() -> Self {
        Self {
            clearance_fault_m: 0.0,
            measurement_jump_rad: 0.2,
            measurement_jump_limit: 3,
            measurement_frozen_rad: 0.2,
            following_warning_rad: 0.1,
            following_fault_rad: 0.3,
            following_lag_ms: 100.0,
        }
    }
}
