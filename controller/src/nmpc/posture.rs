//! Posture: the rates that return the bends to straight while the tip travels.
//!
//! A position has three coordinates, and a robot of n sections 2n bends. The smallest rates that move the tip along a
//! closed path do not lead the body back to the shape in which a round began (Klein & Huang, *IEEE Trans. SMC* 13, 1983).
//! So the cost weights the distance of the rates from u₀ = -α b instead of the rates: b are the bends at the start of the horizon. Where the tip
//! needs all bends, the tip takes precedence. In all other directions the plan follows u₀, down the gradient of |b|² / 2
//! (Liégeois, *IEEE Trans. SMC* 7, 1977), to the shape of the least bends with that tip.
//!
//! α is in proportion to the speed of the reference. So a body rests where its tip does, and its path does not
//! depend on the speed.

use super::NmpcSettings;
use super::motion::Motion;
use crate::reference::{ReferenceSample, ReferenceState};
use crate::robot::{COORDINATES_MAX, Robot};

/// Largest α \[1/s\]. A jump of the reference is not a reason for fast rates.
const PER_S_MAX: f64 = 1.0;

/// The controls of u₀ in each block.
pub(super) fn posture_controls(
    robot: &Robot,
    settings: &NmpcSettings,
    motion: &Motion,
    reference: &[ReferenceSample],
) -> [f64; COORDINATES_MAX] {
    let mut controls = [0.0; COORDINATES_MAX];
    if settings.posture_gain > 0.0 {
        let lengths_per_s = speed_m_s(reference, motion.period_s()) / robot.reach_m();
        let per_s = f64::min(settings.posture_gain * lengths_per_s, PER_S_MAX);
        let rates = motion.start_rad().map(|bend_rad| -per_s * bend_rad);
        let width = motion.width();
        motion.controls_of(&rates[..width], &mut controls[..width]);
    }
    controls
}

/// Mean speed along the reference, whose samples are a period apart. 0 without two of them.
fn speed_m_s(reference: &[ReferenceSample], period_s: f64) -> f64 {
    let is_unknown = |sample: &ReferenceSample| sample.state == ReferenceState::None;
    if reference.len() < 2 || reference.iter().any(is_unknown) {
        return 0.0;
    }
    let steps_m = reference
        .windows(2)
        .map(|pair| (pair[1].position_m - pair[0].position_m).norm());
    steps_m.sum::<f64>() / (period_s * (reference.len() - 1) as f64)
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::nmpc::{Coordinates, Horizon};
    use crate::robot::{BendRates, Configuration, RobotParameters};

    const PERIOD_S: f64 = 0.005;
    const BEND: [f64; 2] = [0.6, 0.8];

    /// Controls of a section bent by 1 rad, where the reference moves by each of these steps (m).
    fn controls(coordinates: Coordinates, steps_m: &[f64]) -> [f64; 2] {
        let robot = Robot::new(&RobotParameters::paper(1)).expect("a robot");
        let settings = NmpcSettings {
            posture_gain: 2.0,
            ..NmpcSettings::default()
        };
        let at = Configuration::from_slice(&BEND).expect("one section");
        let horizon = Horizon::new(&settings, 2);
        let rates = BendRates::zero(1);
        let motion = Motion::new(&robot, PERIOD_S, coordinates, &horizon, &at, &rates, None);
        let mut at_m = 0.0;
        let samples = steps_m.iter().map(|step_m| {
            at_m += step_m;
            ReferenceSample::at_position(Vector3::new(at_m, 0.0, 0.2))
        });
        let samples: Vec<_> = samples.collect();
        let controls = posture_controls(&robot, &settings, &motion, &samples);
        assert_eq!(controls[2..], [0.0; COORDINATES_MAX - 2]);
        [controls[0], controls[1]]
    }

    #[test]
    fn bends_return_with_the_travel_of_the_reference() {
        // 0.03 m/s: the length of the section takes 10 s.
        let travelling = [0.0, 1e-4, 2e-4];
        let [u, v] = controls(Coordinates::BendVector, &travelling);
        assert!((u + 0.2 * BEND[0]).abs() < 1e-12 && (v + 0.2 * BEND[1]).abs() < 1e-12);
        let [theta, phi] = controls(Coordinates::BendAngles, &travelling);
        assert!((theta + 0.2).abs() < 1e-12 && phi.abs() < 1e-12);
    }

    #[test]
    fn a_reference_at_rest_moves_no_bend_and_a_jump_is_no_reason_to_hurry() {
        for resting in [&[][..], &[0.1], &[0.1, 0.0], &[0.1, 0.0, 0.0]] {
            assert!(controls(Coordinates::BendVector, resting) == [0.0; 2]);
        }
        let jumping = controls(Coordinates::BendVector, &[0.0, 0.1]);
        assert!(jumping == BEND.map(|bend| -PER_S_MAX * bend));
    }
}
