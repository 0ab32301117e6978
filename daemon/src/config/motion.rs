use cdcr_controller::reference::ApproachLimits;
use serde::{Deserialize, Serialize};

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
