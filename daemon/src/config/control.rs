//! Control of the robot: actuators, estimate, period, motions, faults, obstacles, reference.

use cdcr_controller::estimator::Actuator;
use cdcr_shared_types::limits::PERIOD_MS_MAX;
use serde::{Deserialize, Serialize};

use super::ns;

table! {
    /// How the robot's motors follow their commands, and the cables the motors.
    pub struct ActuatorConfig {
        /// Delay from the release of a command until the motors begin to follow it, {range}, and at most 64 periods.
        delay_ms: f64 = 0.0, in 0.0..=1e3 * Actuator::TIME_MAX_S, "at most 64 times cycle.period_ms";
        /// Time constant of the motors' first-order lag, {range}.
        time_constant_ms: f64 = 0.0, in 0.0..=1e3 * Actuator::TIME_MAX_S;
        /// Play (backlash) between each motor and its cable, {range}: travel of a reversing motor before its cable moves. Set the measured
        /// value. With a tip sensor, the robot still comes to rest with a value 20 % above the true play, and oscillates with one more than 33 % above it.
        play_m: f64 = 0.0, in 0.0..=Actuator::PLAY_MAX_M;
    }
}

impl ActuatorConfig {
    /// Lag of a robot in even motion behind its commands \[ms\].
    pub fn lead_ms(&self) -> f64 {
        self.delay_ms + self.time_constant_ms
    }
}

table! {
    /// How the configuration of the robot is estimated.
    pub struct EstimatorConfig {
        /// Delay of the estimate behind the measurements, {range}; 0: none. Three first-order filters, each with a third of it as
        /// time constant: twice the value cuts the rate changes from sensor noise to a sixth. Use at least four times the motor lag
        /// that is not configured in [actuator], or the loop may oscillate. Not applied to the ideal simulated robot.
        time_constant_ms: f64 = 180.0, in 0.0..=10_000.0;
        /// Standard deviation of the noise of a measured tip coordinate, {range}. It weights the tip in the estimate where only the tip is
        /// measured. Where bends or cables are measured too, tip errors below a quarter of it are not corrected. Measure it with cdcrctl
        /// calibrate noise.
        tip_noise_m: f64 = 3e-4, in 1e-6..=0.1;
    }
}

table! {
    /// Period, deadline, time budget and lateness.
    pub struct CycleConfig {
        /// Period of the control loop, {range}, and at least twice gather_lead_ms.
        period_ms: f64 = 5.0, in 0.1..=PERIOD_MS_MAX as f64, "at least twice cycle.gather_lead_ms";
        /// Deadline after the release, {range}, and at most the period; 0: the period.
        deadline_ms: f64 = 0.0, in 0.0..=PERIOD_MS_MAX as f64, "at most cycle.period_ms";
        /// A cycle that starts later than this after its release counts as a late start, {range}.
        late_start_ms: f64 = 1.0, in 0.001..=100.0;
        /// Longest time of one solve, {range}, and at most the period; 0: the time until the deadline, less
        /// the margin. Reduced where the other parts of the period would not fit (docs/realtime.md).
        budget_ms: f64 = 0.0, in 0.0..=PERIOD_MS_MAX as f64, "at most cycle.period_ms";
        /// Least time that the solver leaves for the rest of the cycle, {range}, and at most half the period; 0: a tenth of the
        /// period, at least 0.04 ms. More is left where clearance guard and exchange are measured to take longer.
        budget_margin_ms: f64 = 0.0, in 0.0..=50.0, "at most half of cycle.period_ms";
        /// Time of the gather before the cycle thread wakes up (realtime.spin_us before its release), {range}, and at
        /// most half the period.
        gather_lead_ms: f64 = 0.2, in 0.02..=50.0, "at most half of cycle.period_ms";
        /// Level of the leaky bucket at which the robot is stopped, {range}. +1 for each deadline miss, skipped period and cycle on
        /// stale inputs, -1/9 for each good cycle: more than one bad release in ten fills it. 0: 40 (200 ms without control at 5 ms), and a simulated robot is not
        /// stopped: the daemon logs a warning and continues.
        miss_limit: u32 = 0, in 0.0..=1e6, usual 0.0..=1000.0;
        /// Watchdog: the process ends when the cycle or exchange thread makes no progress for this time, the reporter
        /// for 5 times or the status thread for 20 times this time; {range}, and at least 10 periods. The robot then holds when its last command expires (link.command_valid_ms).
        watchdog_ms: f64 = 1000.0, in 50.0..=60_000.0, "at least ten times cycle.period_ms";
    }
}

impl CycleConfig {
    /// Smallest cost of one gather and one publication, with a reserve for slower machines \[ns\].
    pub const EXCHANGE_NS: u64 = 40_000;

    /// Deadline D after the release \[ns\].
    pub fn deadline_ns(&self) -> u64 {
        match ns(self.deadline_ms) {
            0 => ns(self.period_ms),
            deadline_ns => deadline_ns,
        }
    }

    /// Smallest time between the end of the solver and the deadline \[ns\]. The default is a tenth of the
    /// period, but at least the exchange's cost on the same core, without which the reference does not
    /// arrive. The [`CoreBudget`](crate::core_budget::CoreBudget) reserves larger measured costs.
    pub fn budget_margin_ns(&self) -> u64 {
        match ns(self.budget_margin_ms) {
            0 => (ns(self.period_ms) / 10).max(Self::EXCHANGE_NS),
            margin_ns => margin_ns,
        }
    }
}

/// Time for the robot to come to rest at the end of the process \[s\]. The service unit grants the process a
/// little more.
pub const REST_MAX_S: f64 = 10.0;

/// How a reference is reached that begins elsewhere than the tip is, or in motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum ApproachKind {
    /// `Smooth`, and `Direct` for the ideal simulated robot.
    Auto,
    /// Along a smooth path within the limits of the approach.
    Smooth,
    /// As fast as the other limits allow.
    Direct,
    /// As `Smooth`, and not at all from farther away than `approach_distance_m`.
    Refuse,
}

table! {
    /// Motions that the daemon plans itself.
    pub struct MotionConfig {
        /// Deceleration of the rates when holding or stopping, {range}.
        deceleration_rad_s2: f64 = 40.0, in 0.01..=1e6;
        /// Largest acceleration of a bend component, {range}; 0: 40, or no limit for the ideal simulated
        /// robot. Deceleration is not limited.
        acceleration_rad_s2: f64 = 0.0, in 0.0..=1e6;
        /// Rate of the fastest bend component while homing, {range}.
        home_rate_rad_s: f64 = 0.5, in 1e-3..=100.0, usual 0.0..=10.0;
        /// Home is reached when the robot is exactly straight, or when all bend components stay below this for
        /// 0.1 s, {range}. Must exceed the sensor noise.
        home_tolerance_rad: f64 = 0.01, in 1e-6..=1.0;
        /// How the tip joins a reference that begins away from it or in motion, or that replaces another one. "smooth": the distance
        /// decays within the limits below while the reference continues. "direct": as fast as the
        /// other limits allow, as in the paper. "refuse": "smooth", but a request to track a reference farther away than
        /// approach_distance_m is rejected, and a tracking robot holds when such a reference replaces its own. "auto": "direct" for the ideal simulated robot, else "smooth".
        approach: ApproachKind = ApproachKind::Auto;
        /// Largest speed at which the distance decays, {range}. To join a moving reference, the tip briefly moves up to
        /// 1.5 times as fast as the reference. A tip that was held back returns at no more than this speed plus the reference's own.
        approach_speed_m_s: f64 = 0.1, in 1e-4..=100.0, usual 0.0..=5.0;
        /// Largest acceleration that an approach adds to the reference's own, {range}. It is exceeded where the tip would otherwise
        /// deviate by more than 2 % of the robot's length. The tip turns towards an orientation at most at home_rate_rad_s.
        approach_acceleration_m_s2: f64 = 0.5, in 1e-3..=1e4;
        /// With approach = "refuse": largest distance between tip and reference, {range}, at a request to track or when a
        /// reference is replaced.
        approach_distance_m: f64 = 0.02, in 0.0..=100.0;
    }
}

table! {
    /// Limits beyond which robot, sensors or obstacles cause a fault.
    pub struct SafetyConfig {
        /// A clearance below this is a fault, {range}; 0: contact.
        clearance_fault_m: f64 = 0.0, in -10.0..=10.0;
        /// Tolerance by which a measured bend component may exceed the motion possible at its largest rate,
        /// {range}. Granted once, not for each measurement; noise up to half of it never counts. For a
        /// tip coordinate: this times the length of the robot. A measurement beyond it is implausible and
        /// ignored.
        measurement_jump_rad: f64 = 0.2, in 1e-6..=1e3;
        /// Number of consecutive implausible measurements that is a fault, {range}.
        measurement_jump_limit: u32 = 3, in 1.0..=1e6, usual 1.0..=100.0;
        /// A measurement is frozen, a fault, when no bit of it changes while its bend component is commanded to move this far,
        /// net, {range}. For a cable: this times its distance from the backbone; for a tip
        /// position: while any component moves this far. Must exceed the sensor's resolution and the commanded motion
        /// during the age of a measurement.
        measurement_frozen_rad: f64 = 0.2, in 1e-6..=1e3;
        /// Following error, the distance of a measured section from its commanded positions of the last following_lag_ms, above
        /// which the daemon warns, {range}. Not evaluated while only the tip is measured.
        following_warning_rad: f64 = 0.1, in 1e-6..=1e3, "at most safety.following_fault_rad";
        /// Following error that is a fault, {range}, and at least following_warning_rad.
        following_fault_rad: f64 = 0.3, in 1e-6..=1e3, "at least safety.following_warning_rad";
        /// Lag of the motors that does not count as following error, {range}.
        following_lag_ms: f64 = 100.0, in 0.0..=10_000.0, usual 1.0..=1000.0;
        /// Largest change of the mean length of a section's three cables since control began, {range}; more is a fault; 0: no limit. Bending changes the mean
        /// slightly where cable angles are inexact; a broken or slack cable changes it more. Only where cable lengths are measured.
        cable_common_m: f64 = 0.010, in 0.0..=1.0;
    }
}

/// What happens when a source of obstacles is silent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum SourceSilent {
    /// The robot holds until the source sends again or its supervision ends; the obstacles stay meanwhile.
    Hold,
    /// The obstacles stay, and the robot continues.
    Keep,
}

table! {
    /// Supervision of the sources of obstacles.
    pub struct ObstaclesConfig {
        /// Time without a message after which a source is silent, {range}; -1: 500 with link.kind = "driver", 0 with "simulated"; 0: sources
        /// are not supervised, and obstacles expire after their lifetime. A source is a client that has sent an obstacle with a
        /// lifetime. With a timeout, an obstacle expires only when its source sends a message after the lifetime without
        /// renewing the obstacle. Supervision of a source ends when it removes its last
        /// obstacle, that of a silent one also when other clients have sent or removed each id that is left of it, that of all
        /// sources when a client clears the obstacles; the next obstacle with a lifetime restarts it.
        source_timeout_ms: f64 = -1.0, in -1.0..=60_000.0;
        /// Reaction to a silent source. "hold": the robot holds until the source sends again or its supervision ends.
        /// "keep": the robot continues. In both cases the obstacles stay at their last positions.
        source_silent: SourceSilent = SourceSilent::Hold;
    }
}

table! {
    /// The reference and its lease.
    pub struct ReferenceConfig {
        /// Time without renewal after which a reference lease expires and the robot holds, {range}.
        lease_ms: f64 = 500.0, in 20.0..=60_000.0;
    }
}
