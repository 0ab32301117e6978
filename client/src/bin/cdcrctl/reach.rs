//! Checks whether the robot's model reaches the points of a reference before anything moves, with the bend
//! limits only. The dry run covers rates, strokes and obstacles.

use anyhow::bail;
use cdcr_client::Trajectory;
use cdcr_controller::robot::{Configuration, Jacobian, Robot};
use cdcr_shared_types::Telemetry;
use nalgebra::{Matrix3, Vector3};

use crate::bend_limit::BendShare;
use crate::dry_run::{away, robot_and_pose};

/// Maximum number of checked points, evenly spaced along the reference.
const POINTS_MAX: usize = 2000;
/// Iterations towards a point.
const STEPS: usize = 60;
/// Additional start configurations, if the solution of the previous point does not lead near enough.
const SHAPES: u32 = 100;

/// Fails at the first point that the tip misses by more than `allowed_m` with any bends; `record` has the
/// robot and its tip offset.
pub(crate) fn check(
    record: &Telemetry,
    trajectory: &dyn Trajectory,
    allowed_m: f64,
) -> anyhow::Result<()> {
    let (robot, mut shape) = robot_and_pose(record)?;
    let offset_m = Vector3::from(record.tip_offset_m);
    let duration_s = trajectory.duration_s();
    let even = |k: usize| duration_s * k as f64 / (POINTS_MAX - 1) as f64;
    let times_s = match trajectory.knots_s() {
        Some(knots_s) if knots_s.len() <= POINTS_MAX => knots_s.to_vec(),
        _ => (0..POINTS_MAX).map(even).collect(),
    };
    for time_s in times_s {
        let point_m = trajectory.position_m(time_s);
        let (found, left_m) = nearest(
            &robot,
            &shape,
            &(Vector3::from(point_m) - offset_m),
            allowed_m,
        );
        if left_m > allowed_m {
            bail!(
                "not reachable: at {time_s:.2} s {}, the first point that is missed by more than {} mm (--max-error){}; nothing moved",
                away(left_m, point_m),
                1e3 * allowed_m,
                limit(&robot, &found)
            );
        }
        shape = found;
    }
    Ok(())
}

/// Fails when the tip misses the point by more than `allowed_m` with any bends, as [`check`] does.
pub(crate) fn check_point(
    record: &Telemetry,
    point_m: [f64; 3],
    allowed_m: f64,
) -> anyhow::Result<()> {
    let (robot, shape) = robot_and_pose(record)?;
    let modelled_m = Vector3::from(point_m) - Vector3::from(record.tip_offset_m);
    let (away_m, reach_m) = (modelled_m.norm(), robot.reach_m());
    if away_m > reach_m + allowed_m {
        bail!(
            "not reachable: the point is {away_m:.3} m from the base, and the robot is {reach_m:.3} m long; nothing moved"
        );
    }
    let (found, left_m) = nearest(&robot, &shape, &modelled_m, allowed_m);
    if left_m > allowed_m {
        bail!(
            "not reachable: {}{}; nothing moved",
            away(left_m, point_m),
            limit(&robot, &found)
        );
    }
    Ok(())
}

/// Names the bend limit that keeps the tip from getting nearer than in the configuration `found`.
fn limit(robot: &Robot, found: &Configuration) -> String {
    let bend = BendShare::of(robot, found).at_limit();
    bend.map_or_else(String::new, |bend| format!(": {bend}"))
}

/// A configuration with its tip near the point, and the distance \[m\]: the first within `cutoff_m`,
/// otherwise the nearest.
fn nearest(
    robot: &Robot,
    from: &Configuration,
    point_m: &Vector3<f64>,
    cutoff_m: f64,
) -> (Configuration, f64) {
    let mut best = approached(robot, from, point_m);
    for number in 1..=SHAPES {
        if best.1 <= cutoff_m {
            break;
        }
        let found = approached(robot, &some_shape(robot, number), point_m);
        if found.1 < best.1 {
            best = found;
        }
    }
    best
}

/// Damped least-squares iterations, each projected into the bend limits.
fn approached(robot: &Robot, from: &Configuration, point_m: &Vector3<f64>) -> (Configuration, f64) {
    let mut jacobian = Jacobian::new();
    let mut shape = within_limits(robot, *from);
    let mut left_m = point_m - robot.tip_jacobian(&shape, &mut jacobian).position_m;
    let mut damping = 1e-4 * robot.reach_m().powi(2);
    for _ in 0..STEPS {
        if left_m.norm() < 1e-6 {
            break;
        }
        let columns = jacobian.columns().iter();
        let moved = columns.map(|column| Vector3::new(column[0], column[1], column[2]));
        let moved: Vec<_> = moved.collect();
        let square: Matrix3<f64> = moved.iter().map(|column| column * column.transpose()).sum();
        let Some(inverse) = (square + Matrix3::identity() * damping).try_inverse() else {
            break;
        };
        let pull = inverse * left_m;
        let mut next = shape;
        for (bend, column) in next.as_mut_slice().iter_mut().zip(&moved) {
            *bend += column.dot(&pull);
        }
        let next = within_limits(robot, next);
        let next_left_m = point_m - robot.tip_position(&next);
        if next_left_m.norm() < left_m.norm() {
            shape = next;
            left_m = point_m - robot.tip_jacobian(&shape, &mut jacobian).position_m;
            damping *= 0.2;
        } else {
            damping *= 5.0;
        }
    }
    (shape, left_m.norm())
}

fn within_limits(robot: &Robot, mut shape: Configuration) -> Configuration {
    let factors: Vec<f64> = (0..robot.section_count())
        .map(|j| (robot.sections()[j].bend_max_rad / shape.bend_rad(j)).min(1.0))
        .collect();
    for (pair, factor) in shape.as_mut_slice().chunks_mut(2).zip(factors) {
        for bend in pair {
            *bend *= factor;
        }
    }
    shape
}

/// One of many different configurations within the limits: Weyl's sequence in each coordinate.
fn some_shape(robot: &Robot, number: u32) -> Configuration {
    const PRIMES: [f64; 12] = [
        2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0, 19.0, 23.0, 29.0, 31.0, 37.0,
    ];
    let share = |i: usize| (f64::from(number) * PRIMES[i].sqrt()).fract();
    let sections = robot.sections().iter().enumerate();
    let bends: Vec<[f64; 2]> = sections
        .map(|(j, section)| {
            [
                section.bend_max_rad * share(2 * j),
                core::f64::consts::TAU * share(2 * j + 1),
            ]
        })
        .collect();
    Configuration::from_bend_angles(&bends)
}

#[cfg(test)]
mod tests {
    use cdcr_controller::robot::RobotParameters;

    use super::*;

    #[test]
    fn what_a_shape_reaches_is_found_from_any_other() {
        for sections in 1..=6 {
            let parameters = RobotParameters {
                sections: vec![RobotParameters::paper(1).sections[0]; sections],
                ..RobotParameters::paper(1)
            };
            let robot = Robot::new(&parameters).expect("a robot");
            let straight = Configuration::straight(sections);
            for number in 0..200 {
                let point_m = robot.tip_position(&some_shape(&robot, 7919 + number));
                let (_, left_m) = nearest(&robot, &straight, &point_m, 1e-4);
                assert!(left_m <= 1e-4, "{sections} sections, {number}: {left_m}");
            }
        }
    }

    #[test]
    fn what_is_too_far_is_missed_by_what_is_too_much() {
        let robot = Robot::new(&RobotParameters::paper(2)).expect("the paper's");
        let straight = Configuration::straight(2);
        let point_m = Vector3::new(0.0, 0.0, robot.reach_m() + 0.05);
        let (_, left_m) = nearest(&robot, &straight, &point_m, 1e-3);
        assert!((left_m - 0.05).abs() < 1e-3, "{left_m}");
    }

    #[test]
    fn the_bend_limit_that_keeps_a_point_away_is_named() {
        let mut parameters = RobotParameters::paper(2);
        parameters.sections[1].bend_max_rad = 0.2;
        parameters.sections[0].bend_max_rad = 0.2;
        let robot = Robot::new(&parameters).expect("a robot");
        let straight = Configuration::straight(2);
        let point_m = Vector3::new(0.6 * robot.reach_m(), 0.0, 0.5 * robot.reach_m());
        let (found, left_m) = nearest(&robot, &straight, &point_m, 1e-3);
        let text = limit(&robot, &found);
        assert!(
            left_m > 0.1 && text.contains("bend_max_rad = 0.2"),
            "{text}"
        );
        assert_eq!(limit(&robot, &straight), "");
    }
}
