use cdcr_controller::estimator::Actuator;
use cdcr_controller::nmpc::NmpcSettings;
use cdcr_controller::reference::{ApproachLimits, EXCURSION_SHARE};
use cdcr_controller::safety::{FollowingRules, PlausibilityRules};

use crate::accounting::Limits;
use crate::config::{ApproachKind, Config, Interface, LinkKind, ns};

/// Fixed rules of a cycle, from the configuration.
#[derive(Debug, Clone, Copy)]
pub struct Policy {
    /// Deceleration of the rates when holding or stopping \[rad/s²\].
    pub deceleration_rad_s2: f64,
    /// Largest growth of a component's rate \[rad/s²\]; infinite: no limit.
    pub acceleration_rad_s2: f64,
    /// Rate of the fastest component when homing \[rad/s\].
    pub home_rate_rad_s: f64,
    /// Bends below this count as straight if they last \[rad\].
    pub home_tolerance_rad: f64,
    /// Part of a command that the robot executes.
    pub interface: Interface,
    /// Model of the motors' response to commands.
    pub actuator: Actuator,
    /// Time by which commands lead the reference \[ns\].
    pub reference_lead_ns: u64,
    /// Time constant of the estimate's correction by measurements \[s\].
    pub estimator_time_constant_s: f64,
    /// Limits of the approach to a reference; `None`: it is followed at once.
    pub approach: Option<ApproachLimits>,
    /// A reference farther from the tip than this is not approached \[m\].
    pub approach_distance_m: f64,
    /// Standard deviation of a measured coordinate of the tip \[m\].
    pub tip_noise_m: f64,
    /// Validity of a command after its release \[ns\].
    pub command_valid_ns: u64,
    /// Deadline after the release \[ns\].
    pub deadline_ns: u64,
    /// A start later than this after the release is a late start \[ns\].
    pub late_start_ns: u64,
    /// A measurement older than this counts as lost \[ns\].
    pub measurement_timeout_ns: u64,
    /// Level at which the leaky bucket stops the robot; 0: misses are counted only.
    pub miss_limit: u32,
    /// A smaller clearance is a fault \[m\].
    pub clearance_fault_m: f64,
    /// Largest change of the common mode of a section's cables \[m\]; 0: no limit.
    pub cable_common_m: f64,
    /// Rules for plausible measurements.
    pub plausibility: PlausibilityRules,
    /// Limits of the following error.
    pub following: FollowingRules,
    /// Inputs older than this make the robot hold \[ns\].
    pub stale_inputs_max_ns: u64,
}

impl Policy {
    /// A reset has to accept a pose measured farther than this from where the last command left the robot \[rad\].
    pub const POSE_DIFFERS_RAD: f64 = cdcr_shared_types::limits::POSE_DIFFERS_RAD;

    /// Level of the full leaky bucket if the configuration sets no `miss_limit`: 200 ms without control at 5
    /// ms.
    const MISS_LIMIT: u32 = 40;

    /// Default acceleration limit of a robot with motors \[rad/s²\].
    pub const ACCELERATION_RAD_S2: f64 = 40.0;

    /// Age of the newest measurement of the tip above which its sensor measures no more \[ns\].
    pub const TIP_SILENT_NS: u64 =
        1_000_000 * cdcr_shared_types::limits::TIP_SENSOR_SILENT_MS as u64;

    /// Time constant of the motors \[ns\].
    pub fn motor_time_constant_ns(&self) -> u64 {
        (self.actuator.time_constant_s * 1e9) as u64
    }

    pub fn new(config: &Config) -> Self {
        Self {
            deceleration_rad_s2: config.motion.deceleration_rad_s2,
            acceleration_rad_s2: acceleration_rad_s2(config),
            home_rate_rad_s: config.motion.home_rate_rad_s,
            home_tolerance_rad: config.motion.home_tolerance_rad,
            interface: config.link.interface,
            actuator: actuator(config),
            reference_lead_ns: ns(config.actuator.lead_ms()),
            estimator_time_constant_s: estimator_time_constant_s(config),
            approach: approach_limits(config),
            approach_distance_m: approach_distance_m(config),
            tip_noise_m: config.estimator.tip_noise_m,
            command_valid_ns: command_valid_ns(config),
            deadline_ns: config.cycle.deadline_ns(),
            late_start_ns: ns(config.cycle.late_start_ms),
            measurement_timeout_ns: ns(config.link.measurement_timeout_ms),
            miss_limit: miss_limit(config),
            clearance_fault_m: config.safety.clearance_fault_m,
            cable_common_m: config.safety.cable_common_m,
            plausibility: PlausibilityRules {
                jump_rad: config.safety.measurement_jump_rad,
                jump_limit: config.safety.measurement_jump_limit,
                // Commands have an effect later, by the lead of the motors.
                frozen_rad: config.safety.measurement_frozen_rad
                    + lead_s(config) * config.robot.fastest_rad_s(),
            },
            following: FollowingRules {
                warning_rad: config.safety.following_warning_rad,
                fault_rad: config.safety.following_fault_rad,
                lag_s: config.safety.following_lag_ms * 1e-3 + lead_s(config),
            },
            stale_inputs_max_ns: stale_inputs_max_ns(config),
        }
    }

    /// Time of the `elapsed_ns` since a command for which the robot executed it \[ns\]: until its target, or
    /// until the end of its validity.
    pub fn moving_ns(&self, elapsed_ns: u64, period_ns: u64) -> u64 {
        elapsed_ns.min(match self.interface {
            Interface::Position => period_ns,
            Interface::Velocity => self.command_valid_ns,
        })
    }

    /// Time since a command after which the robot rests, if no other follows \[ns\]. Motors that obey positions
    /// reach their target after a period; the motors do not notice one missed period.
    pub fn rests_after_ns(&self, period_ns: u64) -> u64 {
        match self.interface {
            Interface::Position => self.command_valid_ns.min(2 * period_ns),
            Interface::Velocity => self.command_valid_ns,
        }
    }

    pub fn limits(&self) -> Limits {
        Limits {
            deadline_ns: self.deadline_ns,
            late_start_ns: self.late_start_ns,
            miss_limit: match self.miss_limit {
                0 => Self::MISS_LIMIT,
                limit => limit,
            },
        }
    }

    /// A full leaky bucket stops the robot.
    pub fn stops_on_misses(&self) -> bool {
        self.miss_limit > 0
    }

    /// A bucket at `level` would stop a robot behind a driver, but does not stop this one.
    pub fn tolerates(&self, level: u32) -> bool {
        !self.stops_on_misses() && level >= self.limits().miss_limit
    }
}

/// The model of the motors and cables.
fn actuator(config: &Config) -> Actuator {
    Actuator {
        delay_s: config.actuator.delay_ms * 1e-3,
        time_constant_s: config.actuator.time_constant_ms * 1e-3,
        play_m: config.actuator.play_m,
    }
}

/// Validity of a command after its release \[ns\].
fn command_valid_ns(config: &Config) -> u64 {
    match ns(config.link.command_valid_ms) {
        0 => 3 * ns(config.cycle.period_ms),
        valid_ns => valid_ns,
    }
}

/// Limits of the approach; `None`: no limits.
pub(crate) fn approach_limits(config: &Config) -> Option<ApproachLimits> {
    let (motion, is_ideal) = (&config.motion, config.link.is_ideal());
    let is_direct = match motion.approach {
        ApproachKind::Auto => is_ideal,
        ApproachKind::Direct => true,
        ApproachKind::Smooth | ApproachKind::Refuse => false,
    };
    (!is_direct).then_some(ApproachLimits {
        speed_m_s: motion.approach_speed_m_s,
        acceleration_m_s2: motion.approach_acceleration_m_s2,
        excursion_m: EXCURSION_SHARE * config.robot.length_m(),
        turn_rad_s: motion.home_rate_rad_s,
    })
}

/// Largest distance between the tip and a reference to be tracked \[m\].
fn approach_distance_m(config: &Config) -> f64 {
    match config.motion.approach {
        ApproachKind::Refuse => config.motion.approach_distance_m,
        _ => f64::INFINITY,
    }
}

/// Known lag of the motors behind their commands \[s\].
fn lead_s(config: &Config) -> f64 {
    actuator(config).lead_s()
}

/// Without a configured limit, a robot behind a driver has the default one. A simulated robot has none: a
/// first trial on a machine that stalls should end with a report, not with a stop.
fn miss_limit(config: &Config) -> u32 {
    match (config.cycle.miss_limit, config.link.kind) {
        (0, LinkKind::Simulated) => 0,
        (0, LinkKind::Driver) => Policy::MISS_LIMIT,
        (limit, _) => limit,
    }
}

/// Without a configured limit, a robot with motors has the default one. The ideal robot has none, as in the
/// paper.
fn acceleration_rad_s2(config: &Config) -> f64 {
    match (config.motion.acceleration_rad_s2, config.link.is_ideal()) {
        (0.0, true) => f64::INFINITY,
        (0.0, false) => Policy::ACCELERATION_RAD_S2,
        (limit, _) => limit,
    }
}

/// The ideal robot is measured exactly.
fn estimator_time_constant_s(config: &Config) -> f64 {
    if config.link.is_ideal() {
        0.0
    } else {
        config.estimator.time_constant_ms * 1e-3
    }
}

/// With a driver, measurements come with the inputs: without inputs the cycle relies on prediction alone, for
/// at most the validity of a command. A simulated robot is measured in the cycle itself.
fn stale_inputs_max_ns(config: &Config) -> u64 {
    match config.link.kind {
        LinkKind::Simulated => u64::MAX,
        LinkKind::Driver => command_valid_ns(config),
    }
}

/// Settings that can change while the loop runs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RuntimeSettings {
    /// The optimal control problem and its solver.
    pub nmpc: NmpcSettings,
    /// Longest time of one solve \[ns\]; 0: all the time until the deadline, less the margin.
    pub budget_ns: u64,
}

impl RuntimeSettings {
    /// Initial settings of the configuration.
    pub fn new(config: &Config) -> Self {
        Self {
            nmpc: config.controller,
            budget_ns: ns(config.cycle.budget_ms),
        }
    }
}

/// Settings of a configuration before and after a reload. Clients may have changed those that are equal in
/// both.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChangedSettings {
    pub before: RuntimeSettings,
    pub after: RuntimeSettings,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn policy(kind: LinkKind, miss_limit: u32) -> Policy {
        let mut config = Config::default();
        config.link.kind = kind;
        config.cycle.miss_limit = miss_limit;
        Policy::new(&config)
    }

    #[test]
    fn only_a_simulated_robot_without_a_limit_goes_on_when_the_bucket_is_full() {
        let simulated = policy(LinkKind::Simulated, 0);
        assert!(!simulated.stops_on_misses());
        assert!(!simulated.tolerates(39) && simulated.tolerates(40));
        assert_eq!(simulated.limits().miss_limit, 40);
        for (kind, set, limit) in [
            (LinkKind::Driver, 0, 40),
            (LinkKind::Driver, 7, 7),
            (LinkKind::Simulated, 40, 40),
            (LinkKind::Simulated, 7, 7),
        ] {
            let policy = policy(kind, set);
            assert!(policy.stops_on_misses(), "{kind:?} {set}");
            assert_eq!(policy.miss_limit, limit);
            assert_eq!(policy.limits().miss_limit, limit);
            assert!(!policy.tolerates(u32::MAX), "{kind:?} {set}");
        }
    }
}
