//! How the robot is controlled: actuators, estimate, period, motions, faults, obstacles, reference.

use cdcr_controller::estimator::Actuator;
use cdcr_controller::reference::ApproachLimits;
use serde::{Deserialize, Serialize};

use super::{LinkKind, ns};

table! {
    /// How the robot's motors follow their commands, and the cables the motors.
    pub struct ActuatorConfig {
        /// From the release of a command until the motors begin to follow it, {range}.
        delay_ms: f64 = 0.0, in 0.0..=300.0;
        /// Time constant of their lag, of first order, {range}.
        time_constant_ms: f64 = 0.0, in 0.0..=300.0;
        /// Play between each motor and its cable, {range}: so far a motor that turns round goes before its cable comes along. Configure what
        /// you measure. With a fifth more than the true play a robot with a tip sensor still rests, with more than a third it swings.
        play_m: f64 = 0.0, in 0.0..=0.01;
    }
}

impl ActuatorConfig {
    /// By how much a robot that moves evenly is behind its commands \[ms\].
    pub fn lead_ms(&self) -> f64 {
        self.delay_ms + self.time_constant_ms
    }

    /// The model of them.
    pub fn model(&self) -> Actuator {
        Actuator {
            delay_s: self.delay_ms * 1e-3,
            time_constant_s: self.time_constant_ms * 1e-3,
            play_m: self.play_m,
        }
    }
}

table! {
    /// How the configuration of the robot is estimated.
    pub struct EstimatorConfig {
        /// By how much the estimate follows later what is measured, {range}; 0: at once. Three filters of first order, each with a third of it as
        /// time constant: twice as long, noise of the sensors changes the rates a sixth as much. At least four times the lag of the motors
        /// that [actuator] does not know, or the loop may oscillate. The ideal simulated robot is measured exactly, and believed at once.
        time_constant_ms: f64 = 180.0, in 0.0..=10_000.0;
        /// Noise of a measured coordinate of the tip, {range}: standard deviation. What the estimate makes of a tip that alone is measured
        /// depends on it. Beside bends or cables, a quarter of it is what the tip may be beside without being corrected. cdcrctl calibrate
        /// noise measures it.
        tip_noise_m: f64 = 3e-4, in 1e-6..=0.1;
    }
}

table! {
    /// The period and what counts as late.
    pub struct CycleConfig {
        /// Period of the loop, {range}, and at least twice gather_lead_ms.
        period_ms: f64 = 5.0, in 0.1..=100.0, "at least twice cycle.gather_lead_ms";
        /// Deadline after the release, {range}, and at most the period; 0: the period.
        deadline_ms: f64 = 0.0, in 0.0..=100.0, "at most cycle.period_ms";
        /// A start later than this after its release counts as a late start, {range}.
        late_start_ms: f64 = 1.0, in 0.001..=100.0;
        /// Longest time of one solve, {range}, and at most the period; 0: all that is left until the deadline, less
        /// the margin. It is cut where the other parts of the period would not fit (docs/realtime.md).
        budget_ms: f64 = 0.0, in 0.0..=100.0, "at most cycle.period_ms";
        /// Time that the solver leaves at least for what follows it, {range}, and at most half the period; 0: a tenth of the
        /// period, at least 0.04 ms. What guard and exchange are measured to take beyond that is left, too.
        budget_margin_ms: f64 = 0.0, in 0.0..=50.0, "at most half of cycle.period_ms";
        /// How long before the cycle thread wakes up (realtime.spin_us before its release) the inputs are gathered, {range}, and at
        /// most half the period.
        gather_lead_ms: f64 = 0.2, in 0.02..=50.0, "at most half of cycle.period_ms";
        /// Leaky bucket: +1 for each deadline miss, each skipped period and each cycle on stale inputs, -1/9 for each good
        /// cycle, so that more than one bad release in ten fills it. At this level the robot is stopped, {range}; 0: 40, which are 200 ms without control at 5 ms, and a simulated robot is not
        /// stopped: the daemon logs a warning and goes on.
        miss_limit: u32 = 0, in 0.0..=1e6;
        /// Watchdog: the process ends when the cycle or exchange thread makes no progress for this long, the reporter
        /// for five times as long, or the thread of the status for twenty times; {range}, and at least 10 periods. The robot then holds when its last command runs out (link.command_valid_ms).
        watchdog_ms: f64 = 1000.0, in 50.0..=60_000.0, "at least ten times cycle.period_ms";
    }
}

impl CycleConfig {
    /// Level at which the leaky bucket is full when the configuration sets no `miss_limit`: 200 ms without control at
    /// 5 ms.
    pub const MISS_LIMIT: u32 = 40;
    /// What one gather and one publication take at least, with a little more for slower machines \[ns\].
    pub const EXCHANGE_NS: u64 = 40_000;

    /// Deadline D after the release \[ns\].
    pub fn deadline_ns(&self) -> u64 {
        match ns(self.deadline_ms) {
            0 => ns(self.period_ms),
            deadline_ns => deadline_ns,
        }
    }

    /// Time that the solver leaves at least for what follows it \[ns\], by default a tenth of the period. And at least
    /// what the exchange needs on the same core, without which the reference does not arrive. What was measured to
    /// take longer is left by the [`CoreBudget`](crate::core_budget::CoreBudget).
    pub fn budget_margin_ns(&self) -> u64 {
        match ns(self.budget_margin_ms) {
            0 => (ns(self.period_ms) / 10).max(Self::EXCHANGE_NS),
            margin_ns => margin_ns,
        }
    }
}

/// Time that a robot has to come to rest when the process ends \[s\]. The unit gives the process a little more.
pub const REST_MAX_S: f64 = 10.0;

/// How a reference is reached that begins elsewhere than the tip is, or in motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum ApproachKind {
    /// `Smooth`, and `Direct` for the ideal simulated robot.
    #[default]
    Auto,
    /// Along a smooth path within the limits of the approach.
    Smooth,
    /// As fast as the other limits allow.
    Direct,
    /// As `Smooth`, and not at all from farther away than `approach_distance_m`.
    Refuse,
}

table! {
    /// Motions that the daemon makes by itself.
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
        /// How a reference is reached that begins elsewhere than the tip is, or in motion, or replaces another one. "smooth": the distance
        /// between tip and reference decays within the limits below, while the reference goes on. "direct": as fast as the
        /// other limits allow, as in the paper. "refuse": as "smooth", and a request to track is refused from farther away than
        /// approach_distance_m; a robot that tracks holds where its reference is replaced by one that far. "auto": "smooth", and "direct" for the ideal simulated robot.
        approach: ApproachKind = ApproachKind::Auto;
        /// Largest speed with which the distance decays, {range}. To join a reference in motion the tip is for a moment up to
        /// 1.5 times as fast as it.
        approach_speed_m_s: f64 = 0.1, in 1e-4..=100.0;
        /// Largest acceleration that an approach adds to that of the reference, {range}. A motion that would take the tip
        /// farther aside than 2 % of the robot's length is joined faster. The tip turns towards an orientation at home_rate_rad_s at most.
        approach_acceleration_m_s2: f64 = 0.5, in 1e-3..=1e4;
        /// With approach = "refuse": a reference that is farther from the tip than this when it shall be tracked, or when it
        /// replaces another one, is not followed, {range}.
        approach_distance_m: f64 = 0.02, in 0.0..=100.0;
    }
}

impl MotionConfig {
    /// Largest acceleration of a robot behind a driver whose configuration has none \[rad/s²\].
    pub const ACCELERATION_RAD_S2: f64 = 40.0;

    /// Limits of the approach of a robot that `is_ideal` or not and is `reach_m` (m) long; `None`: there is none.
    pub fn approach_limits(&self, is_ideal: bool, reach_m: f64) -> Option<ApproachLimits> {
        let is_direct = match self.approach {
            ApproachKind::Auto => is_ideal,
            ApproachKind::Direct => true,
            ApproachKind::Smooth | ApproachKind::Refuse => false,
        };
        (!is_direct).then_some(ApproachLimits {
            speed_m_s: self.approach_speed_m_s,
            acceleration_m_s2: self.approach_acceleration_m_s2,
            excursion_m: 0.02 * reach_m,
            turn_rad_s: self.home_rate_rad_s,
        })
    }

    /// A reference may be this far from the tip when it shall be tracked \[m\].
    pub fn approach_distance_m(&self) -> f64 {
        match self.approach {
            ApproachKind::Refuse => self.approach_distance_m,
            _ => f64::INFINITY,
        }
    }
}

table! {
    /// What counts as a fault of the robot, its sensors or its surroundings.
    pub struct SafetyConfig {
        /// A smaller clearance between body and obstacles than this is a fault, {range}; 0: contact.
        clearance_fault_m: f64 = 0.0, in -10.0..=10.0;
        /// A measured component of the bend vector may be this far ahead of where its largest rate can have brought it,
        /// {range}. Granted once, not anew for each measurement; noise of up to half of it never counts. A
        /// coordinate of a tip position: this times the length of the robot. What is farther ahead is implausible, and
        /// left out.
        measurement_jump_rad: f64 = 0.2, in 1e-6..=1e3;
        /// So many implausible measurements in a row are a fault, {range}.
        measurement_jump_limit: u32 = 3, in 1.0..=1e6;
        /// A bend component or cable whose measurement does not change in any bit while it is commanded to move this far,
        /// net, is frozen, and a fault, {range}. (A cable: this times its distance from the backbone; a tip
        /// position: while any component is.) More than the sensor resolves, and more than the robot is commanded to move
        /// while a measurement is under way.
        measurement_frozen_rad: f64 = 0.2, in 1e-6..=1e3;
        /// Following error: how far a section is measured from where it was commanded to be in the last following_lag_ms. Above
        /// this it is a warning, {range}. Not evaluated while only the tip is measured.
        following_warning_rad: f64 = 0.1, in 1e-6..=1e3, "at most safety.following_fault_rad";
        /// Above this it is a fault, {range}, and at least following_warning_rad.
        following_fault_rad: f64 = 0.3, in 1e-6..=1e3, "at least safety.following_warning_rad";
        /// How far the motors may lag behind their commands without an error, {range}.
        following_lag_ms: f64 = 100.0, in 0.0..=10_000.0;
        /// The mean length of a section's three cables may change by this since control began, {range}; 0: by any amount. Bends change it
        /// as far as the cables' angles are off, a cable that broke and cables that went slack do more; beyond it is a fault. Only where cable lengths are measured.
        cable_common_m: f64 = 0.010, in 0.0..=1.0;
    }
}

/// What happens when a source of obstacles is silent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum SourceSilent {
    /// The robot holds until the source sends again, or a client clears the obstacles. They stay meanwhile.
    #[default]
    Hold,
    /// The obstacles stay, and the robot goes on.
    Keep,
}

table! {
    /// Supervision of the sources of obstacles.
    pub struct ObstaclesConfig {
        /// A client that has sent an obstacle with a limited lifetime is a source. A source that sends nothing for this long is
        /// silent, {range}; -1: 500 with link.kind = "driver", 0 with "simulated"; 0: sources are not supervised, and obstacles
        /// expire whatever became of their source. With a timeout an obstacle expires only while its source lives: when a message of
        /// it arrives after the lifetime and has not renewed the obstacle. Supervision of a source ends when it removes its last
        /// obstacle, and that of all sources when a client clears the obstacles; the next obstacle with a lifetime begins it again.
        source_timeout_ms: f64 = -1.0, in -1.0..=60_000.0;
        /// What happens when a source is silent. "hold": the robot holds until the source sends again, or a client clears the
        /// obstacles. "keep": the robot goes on. With both the obstacles stay where the source saw them last.
        source_silent: SourceSilent = SourceSilent::Hold;
    }
}

impl ObstaclesConfig {
    /// Timeout of the sources of a robot behind a driver, where the configuration leaves it to the kind of robot \[ms\].
    const DRIVER_SOURCE_TIMEOUT_MS: f64 = 500.0;

    /// The timeout in force for a robot \[ms\].
    pub(super) fn source_timeout_ms(&self, robot: LinkKind) -> f64 {
        match (self.source_timeout_ms, robot) {
            (-1.0, LinkKind::Driver) => Self::DRIVER_SOURCE_TIMEOUT_MS,
            (-1.0, LinkKind::Simulated) => 0.0,
            (timeout_ms, _) => timeout_ms,
        }
    }
}

table! {
    /// The reference and its lease.
    pub struct ReferenceConfig {
        /// A reference lease that is not renewed for this long expires, and the robot holds, {range}.
        lease_ms: f64 = 500.0, in 20.0..=60_000.0;
    }
}
