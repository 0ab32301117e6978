//! How the tip joins a reference that begins in motion.

use cdcr_controller::reference::{
    Approach, ApproachLimits, EXCURSION_SHARE, Orientation, ReferenceSample, Trajectory,
};
use cdcr_controller::robot::Pose;
use nalgebra::{Matrix3, Vector3};

/// Defaults of `motion.approach_speed_m_s`, `motion.approach_acceleration_m_s2` and `motion.home_rate_rad_s`: the daemon does not publish its
/// own.
const SPEED_M_S: f64 = 0.1;
const ACCELERATION_M_S2: f64 = 0.5;
const TURN_RAD_S: f64 = 0.5;

/// The approach from rest at the first of the `points` to their motion; none where it does not end before they do.
pub(super) fn joining(points: &Trajectory, period_ns: u64, reach_m: f64) -> Approach {
    let limits = ApproachLimits {
        speed_m_s: SPEED_M_S,
        acceleration_m_s2: ACCELERATION_M_S2,
        excursion_m: EXCURSION_SHARE * reach_m,
        turn_rad_s: TURN_RAD_S,
    };
    let [first, second] = [0, period_ns].map(|time_ns| points.sample(time_ns));
    let velocity_m_s = (second.position_m - first.position_m) / (period_ns as f64 * 1e-9);
    let tip = Pose {
        position_m: first.position_m,
        rotation: Matrix3::identity(),
    };
    let free = ReferenceSample {
        orientation: Orientation::Free,
        ..first
    };
    let zero = Vector3::zeros();
    let (from, to) = ((&tip, &zero), (&free, &velocity_m_s));
    let joining = Approach::plan(&limits, 0, from, to, period_ns);
    let end_ns = points.end_ns().unwrap_or(0);
    if joining.is_over(end_ns) {
        joining
    } else {
        Approach::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_limits_are_the_defaults_of_the_daemon() {
        const DEFAULTS: &str = include_str!("../../../../../configs/default.toml");
        let defaults: toml_edit::DocumentMut = DEFAULTS.parse().expect("TOML");
        for (key, value) in [
            ("approach_speed_m_s", SPEED_M_S),
            ("approach_acceleration_m_s2", ACCELERATION_M_S2),
            ("home_rate_rad_s", TURN_RAD_S),
        ] {
            let default = defaults["motion"][key].as_float();
            assert_eq!(default, Some(value), "{key}");
        }
    }
}
