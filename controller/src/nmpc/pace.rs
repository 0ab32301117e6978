//! The reference of a robot that is behind it.
//!
//! A solver that sees a reference out of its reach asks for the largest rates of every component. Scaled down to the
//! permitted speed, these no longer lead to the reference: the tip makes a detour, at needlessly large rates that cancel
//! out. So the solver sees how far the tip can be at each step, on the straight line to where it should be.
//!
//! Beside an obstacle that line may be blocked. The solver then sees the reference itself, to find the way round, and
//! its rates are scaled down.

use crate::reference::{Orientation, Pace, ReferenceSample};
use crate::robot::{BendRates, Pose, Robot};

use super::SolveInput;

/// A body nearer than this to the safe distance is beside an obstacle, as a share of the robot's length.
const BESIDE_SHARE: f64 = 0.02;

/// Fills `paced` with the samples of `steps` steps, as far as the tip can follow them. A sample that is within reach is
/// the same to the bit. Returns whether one is not.
pub(super) fn pace_reference(
    pace: &Pace,
    reference: &[ReferenceSample],
    steps: usize,
    (tip, period_s): (&Pose, f64),
    paced: &mut Vec<ReferenceSample>,
) -> bool {
    paced.clear();
    let Some(last) = reference.last() else {
        return false;
    };
    let mut is_behind = false;
    paced.extend((0..steps).map(|step| {
        let sample = reference.get(step).unwrap_or(last);
        let within = pace.within(tip, sample, (step + 1) as f64 * period_s);
        is_behind |= within != *sample;
        within
    }));
    is_behind
}

/// The body may be held by an obstacle: its way to the reference may be blocked.
pub(super) fn is_beside_obstacle(robot: &Robot, input: &SolveInput, safe_distance_m: f64) -> bool {
    let enlarged = robot.enlarged(input.configuration, input.tip_offset_m);
    let body = enlarged.body(input.configuration);
    let clearance_m = body.least_clearance_m(input.obstacles.iter().copied());
    clearance_m <= safe_distance_m + BESIDE_SHARE * robot.reach_m()
}

/// `rates`, scaled down to the pace of every section end, unless they move the tip away from the reference: then an
/// obstacle comes nearer.
pub(super) fn slow_down(
    rates: BendRates,
    robot: &Robot,
    input: &SolveInput,
    pace: &Pace,
    (tip, period_s): (&Pose, f64),
) -> BendRates {
    let Some(sample) = input.reference.first() else {
        return rates;
    };
    let at = input.configuration;
    let moved_m = robot.tip_position(&at.advanced(&rates, period_s)) - tip.position_m;
    if moved_m.dot(&(sample.position_m - tip.position_m)) < 0.0 {
        return rates;
    }
    // A tip that turns moves the other section ends.
    let turning_m_s = if sample.orientation == Orientation::Free {
        0.0
    } else {
        pace.turn_rad_s * robot.reach_m()
    };
    let share = (pace.speed_m_s + turning_m_s) / robot.fastest_section_end_m_s(at, &rates);
    let mut slowed = rates;
    if share < 1.0 {
        for rate in slowed.as_mut_slice() {
            *rate *= share;
        }
    }
    slowed
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    #[test]
    fn a_sample_out_of_reach_is_on_the_line_to_it_and_the_others_stay() {
        let tip_m = Vector3::new(0.1, 0.2, 0.3);
        let tip = Pose {
            position_m: tip_m,
            ..Pose::identity()
        };
        let at = |x_m: f64| ReferenceSample::at(tip_m + Vector3::new(x_m, 0.0, 0.0));
        let pace = Pace::UNLIMITED.at_most(2.0);
        let mut paced = Vec::new();
        let from = (&tip, 0.005);
        let reference = [at(0.5), at(0.015), at(-0.5)];
        assert!(pace_reference(&pace, &reference, 5, from, &mut paced));
        assert_eq!(paced[1], at(0.015));
        for (sample, x_m) in paced.iter().zip([0.01, 0.015, -0.03, -0.04, -0.05]) {
            assert!(
                (sample.position_m - at(x_m).position_m).norm() < 1e-15,
                "{x_m}"
            );
        }
        assert!(!pace_reference(&pace, &[at(0.005)], 1, from, &mut paced));
        assert!(!pace_reference(&pace, &[], 5, from, &mut paced) && paced.is_empty());
    }

    /// A tip between a position and an orientation that exclude each other is drawn to both as before.
    #[test]
    fn position_and_orientation_keep_their_proportion() {
        let pace = Pace {
            speed_m_s: 0.1,
            turn_rad_s: 0.5,
        };
        let turned = Orientation::Full(nalgebra::UnitQuaternion::from_scaled_axis(Vector3::new(
            0.0, 0.2, 0.0,
        )));
        for (away_m, share) in [(0.01, 0.0125), (0.001, 0.0125), (0.1, 0.005)] {
            let sample = ReferenceSample {
                orientation: turned,
                ..ReferenceSample::at(Vector3::new(away_m, 0.0, 0.0))
            };
            let within = pace.within(&Pose::identity(), &sample, 0.005);
            assert!(
                (within.position_m.x - share * away_m).abs() < 1e-15,
                "{away_m}"
            );
            let Orientation::Full(rotation) = within.orientation else {
                panic!("{within:?}")
            };
            assert!((rotation.angle() - share * 0.2).abs() < 1e-12, "{away_m}");
        }
    }
}
