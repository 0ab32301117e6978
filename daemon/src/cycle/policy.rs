use cdcr_controller::nmpc::NmpcSettings;
use cdcr_controller::safety::PlausibilityRules;

use crate::config::{Config, ns};
use crate::rt::accounting::Limits;

/// The fixed rules of a cycle, from the configuration.
#[derive(Debug, Clone, Copy)]
pub struct Policy {
    /// How fast rates shrink when holding or stopping \[rad/s²\].
    pub deceleration_rad_s2: f64,
    /// Rate of the fastest component on the way home \[rad/s\].
    pub home_rate_rad_s: f64,
    /// Bends that count as straight when they last \[rad\].
    pub home_tolerance_rad: f64,
    /// Deadline after the release \[ns\].
    pub deadline_ns: u64,
    /// A start later than this is a late start \[ns\].
    pub late_start_ns: u64,
    /// A measurement older than this is lost \[ns\].
    pub measurement_timeout_ns: u64,
    /// Level at which the leaky bucket stops the robot.
    pub miss_limit: u32,
    /// A smaller clearance is a fault \[m\].
    pub clearance_fault_m: f64,
    /// Which measurements are taken for true.
    pub plausibility: PlausibilityRules,
}

impl Policy {
    /// Those of a configuration.
    pub fn new(config: &Config) -> Self {
        Self {
            deceleration_rad_s2: config.motion.deceleration_rad_s2,
            home_rate_rad_s: config.motion.home_rate_rad_s,
            home_tolerance_rad: config.motion.home_tolerance_rad,
            deadline_ns: config.cycle.deadline_ns(),
            late_start_ns: ns(config.cycle.late_start_ms),
            measurement_timeout_ns: ns(config.link.measurement_timeout_ms),
            miss_limit: config.cycle.miss_limit,
            clearance_fault_m: config.safety.clearance_fault_m,
            plausibility: PlausibilityRules {
                jump_rad: config.safety.measurement_jump_rad,
                jump_limit: config.safety.measurement_jump_limit,
                frozen_rad: config.safety.measurement_frozen_rad,
            },
        }
    }

    /// What counts as late.
    pub fn limits(&self) -> Limits {
        Limits {
            deadline_ns: self.deadline_ns,
            late_start_ns: self.late_start_ns,
            miss_limit: self.miss_limit,
        }
    }
}

/// What can be changed while the loop runs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// The optimal control problem and its solver.
    pub nmpc: NmpcSettings,
    /// Longest time of one solve \[ns\]; 0: all that is left until the deadline, less the margin.
    pub budget_ns: u64,
}

impl Settings {
    /// Those that the configuration begins with.
    pub fn new(config: &Config) -> Self {
        Self {
            nmpc: config.controller,
            budget_ns: ns(config.cycle.budget_ms),
        }
    }
}
