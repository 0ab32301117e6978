//! The reference of a robot that is behind it.
//!
//! A solver that sees a reference out of its reach asks for the largest rates of every component. Scaled down to the
//! permitted speed, these no longer lead to the reference: the tip makes a detour, at needlessly large rates that cancel
//! out. So the solver sees how far the tip can be at each step, on the straight line to where it should be.
//!
//! Beside an obstacle that line may be blocked. The solver then sees the reference itself, to find the way round, and
//! its rates are scaled down.

use crate::reference::ReferenceSample;
use crate::robot::{BendRates, Configuration, Pose, Robot};

use super::SolveInput;

/// A body nearer than this to the safe distance is beside an obstacle, as a share of the robot's length.
const BESIDE_SHARE: f64 = 0.005;
/// A clearance smaller by less than this is the same, because of rounding \[m\].
const ROUNDING_M: f64 = 1e-7;

/// Fills `paced` with the samples of `steps` steps, each at most `step_m` per step away from the tip. A sample that is
/// within reach is the same to the bit. Returns whether one is not.
///
/// Its orientation goes the same share of its way, so that a tip between the two is drawn to neither.
pub(super) fn pace_reference(
    reference: &[ReferenceSample],
    steps: usize,
    tip: &Pose,
    step_m: f64,
    paced: &mut Vec<ReferenceSample>,
) -> bool {
    paced.clear();
    let Some(last) = reference.last() else {
        return false;
    };
    let mut is_behind = false;
    paced.extend((0..steps).map(|step| {
        let sample = reference.get(step).unwrap_or(last);
        let away_m = (sample.position_m - tip.position_m).norm();
        let reach_m = (step + 1) as f64 * step_m;
        if away_m > reach_m {
            is_behind = true;
            sample.at_share_from(tip, reach_m / away_m)
        } else {
            *sample
        }
    }));
    is_behind
}

/// The body among its obstacles, at the release and a period later.
pub(super) struct Surroundings<'a> {
    pub(super) robot: &'a Robot,
    pub(super) input: &'a SolveInput<'a>,
    pub(super) safe_distance_m: f64,
    pub(super) period_s: f64,
}

impl Surroundings<'_> {
    fn clearance_m(&self, at: &Configuration, after_s: f64) -> f64 {
        let enlarged = self.robot.enlarged(at, self.input.tip_offset_m);
        let obstacles = self.input.obstacles.iter();
        enlarged
            .body(at)
            .least_clearance_m(obstacles.map(|obstacle| obstacle.moved(after_s)))
    }

    /// An obstacle may hold the body, so that the straight way to the reference is blocked.
    pub(super) fn are_near(&self) -> bool {
        let near_m = self.safe_distance_m + BESIDE_SHARE * self.robot.reach_m();
        self.clearance_m(self.input.configuration, 0.0) <= near_m
    }

    /// `rates`, scaled down so that no section end is faster than `pace_m_s`; unchanged where only the whole of them evades
    /// an obstacle that comes nearer.
    pub(super) fn slow_down(&self, rates: BendRates, pace_m_s: f64) -> BendRates {
        let at = self.input.configuration;
        let share = pace_m_s / self.robot.fastest_section_end_m_s(at, &rates);
        let mut slowed = rates;
        if share < 1.0 {
            for rate in slowed.as_mut_slice() {
                *rate *= share;
            }
        }
        if share < 1.0 && self.only_evades_whole(&rates, &slowed) {
            return rates;
        }
        slowed
    }

    /// An obstacle comes nearer, and the robot gets away from it with `rates` but not with the `slowed` ones.
    fn only_evades_whole(&self, rates: &BendRates, slowed: &BendRates) -> bool {
        let [end, slow_end] =
            [rates, slowed].map(|rates| self.input.configuration.advanced(rates, self.period_s));
        let slow_m = self.clearance_m(&slow_end, self.period_s) + ROUNDING_M;
        slow_m < self.clearance_m(&slow_end, 0.0)
            && slow_m < self.clearance_m(self.input.configuration, 0.0)
            && slow_m < self.clearance_m(&end, self.period_s)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::reference::Orientation;
    use crate::robot::{Obstacle, RobotParameters, Shape};

    #[test]
    fn a_sample_out_of_reach_is_on_the_line_to_it_and_the_others_stay() {
        let tip_m = Vector3::new(0.1, 0.2, 0.3);
        let tip = Pose {
            position_m: tip_m,
            ..Pose::identity()
        };
        let at = |x_m: f64| ReferenceSample::at_position(tip_m + Vector3::new(x_m, 0.0, 0.0));
        let mut paced = Vec::new();
        let reference = [at(0.5), at(0.015), at(-0.5)];
        assert!(pace_reference(&reference, 5, &tip, 0.01, &mut paced));
        assert_eq!(paced[1], at(0.015));
        for (sample, x_m) in paced.iter().zip([0.01, 0.015, -0.03, -0.04, -0.05]) {
            assert!(
                (sample.position_m - at(x_m).position_m).norm() < 1e-15,
                "{x_m}"
            );
        }
        assert!(!pace_reference(&[at(0.005)], 1, &tip, 0.01, &mut paced));
        assert!(!pace_reference(&[], 5, &tip, 0.01, &mut paced) && paced.is_empty());
    }

    /// A tip between a position and an orientation that exclude each other is drawn to both as before.
    #[test]
    fn position_and_orientation_keep_their_proportion() {
        let turn = nalgebra::UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.2, 0.0));
        let sample = ReferenceSample {
            orientation: Orientation::Full(turn),
            ..ReferenceSample::at_position(Vector3::new(0.01, 0.0, 0.0))
        };
        let mut paced = Vec::new();
        assert!(pace_reference(
            &[sample],
            1,
            &Pose::identity(),
            5e-4,
            &mut paced
        ));
        assert!((paced[0].position_m.x - 5e-4).abs() < 1e-15);
        let Orientation::Full(rotation) = paced[0].orientation else {
            panic!("{paced:?}")
        };
        assert!((rotation.angle() - 0.05 * 0.2).abs() < 1e-12);
        // An orientation alone is not paced.
        let turned = ReferenceSample {
            position_m: Vector3::zeros(),
            ..sample
        };
        assert!(!pace_reference(
            &[turned],
            1,
            &Pose::identity(),
            5e-4,
            &mut paced
        ));
    }

    /// Beside an obstacle that stands the rates are scaled down; away from one that comes nearer they are not.
    #[test]
    fn evasion_is_not_slowed_down() {
        let robot = Robot::new(&RobotParameters::paper(3)).unwrap();
        let at = Configuration::straight(3);
        let rates = BendRates::from_slice(&[0.5, 0.0, 0.5, 0.0, 0.5, 0.0]).unwrap();
        let tip_m = robot.tip_position(&at);
        let beside_m = tip_m - Vector3::new(0.05, 0.0, 0.1);
        for (speed_m_s, is_slowed) in [(0.0, true), (0.3, false), (-0.3, true)] {
            let velocity_m_s = Vector3::new(speed_m_s, 0.0, 0.0);
            let shape = Shape::Sphere { centre_m: beside_m };
            let obstacles = [Obstacle::new(shape, 0.02, velocity_m_s).unwrap()];
            let input = SolveInput {
                configuration: &at,
                previous_rates: &rates,
                reference: &[],
                obstacles: &obstacles,
                tip_offset_m: 0.0,
                elapsed_periods: 1,
                seed: 1,
            };
            let surroundings = Surroundings {
                robot: &robot,
                input: &input,
                safe_distance_m: 0.01,
                period_s: 0.005,
            };
            let slowed = surroundings.slow_down(rates, 0.1);
            assert_eq!(slowed != rates, is_slowed, "{speed_m_s}");
            if is_slowed {
                let fastest_m_s = robot.fastest_section_end_m_s(&at, &slowed);
                assert!((fastest_m_s - 0.1).abs() < 1e-12, "{fastest_m_s}");
            }
        }
    }
}
