//! Checks whether the robot's model reaches the points of a reference before anything moves, with the bend
//! limits only. The dry run covers rates, strokes and obstacles.
//!
//! The tip offset is that of the present pose. It differs from pose to pose, by millimetres to centimetres where lengths or radii of the
//! configuration are wrong, so a point at the edge of the workspace may depend on it; both answers say so.

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

/// Least radius of a circle that is named \[m\].
const CIRCLE_MIN_M: f64 = 0.01;
/// Largest tip offset across the axis with which a circle about it is named \[m\]: it is followed to 1 mm.
const BESIDE_AXIS_M: f64 = 2e-4;

/// Fails at the first point that the tip misses by more than `allowed_m` with any bends; `record` has the
/// robot and its tip offset.
pub(crate) fn check(
    record: &Telemetry,
    trajectory: &dyn Trajectory,
    allowed_m: f64,
) -> anyhow::Result<()> {
    let (robot, mut shape) = robot_and_pose(record)?;
    let mut unmoved = shape;
    let mut is_sure = true;
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
                "not reachable: at {time_s:.2} s {}, the first point that is missed by more than {} mm (--max-error){}{}; nothing moved{}",
                away(left_m, point_m),
                1e3 * allowed_m,
                limit(&robot, &found),
                offset_hint(record, left_m - allowed_m),
                surface(&robot, &robot.tip_position(&found), &offset_m)
            );
        }
        shape = found;
        if is_sure {
            let (found, left_m) = nearest(&robot, &unmoved, &point_m.into(), allowed_m);
            (unmoved, is_sure) = (found, left_m <= allowed_m);
        }
    }
    note(record, is_sure);
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
            "not reachable: the point is {away_m:.3} m from the base, and the robot is {reach_m:.3} m long{}; nothing moved",
            offset_hint(record, away_m - reach_m - allowed_m)
        );
    }
    let (found, left_m) = nearest(&robot, &shape, &modelled_m, allowed_m);
    if left_m > allowed_m {
        bail!(
            "not reachable: {}{}{}; nothing moved{}",
            away(left_m, point_m),
            limit(&robot, &found),
            offset_hint(record, left_m - allowed_m),
            surface(
                &robot,
                &robot.tip_position(&found),
                &Vector3::from(record.tip_offset_m)
            )
        );
    }
    let (_, left_m) = nearest(&robot, &shape, &point_m.into(), allowed_m);
    note(record, left_m <= allowed_m);
    Ok(())
}

/// What a robot of one section reaches instead, at and around the model's tip `nearest_m`. A circle about the axis is named where it is not
/// a point, and lies on the surface in spite of the offset.
fn surface(robot: &Robot, nearest_m: &Vector3<f64>, offset_m: &Vector3<f64>) -> String {
    if robot.section_count() > 1 {
        return String::new();
    }
    let [x, y, z] = (nearest_m + offset_m).into();
    let radius_m = x.hypot(y);
    let point = format!(
        ". With one section, the tip reaches only a surface: each distance from the axis has one height. The nearest point is ({x:.4}, {y:.4}, {z:.4}) m"
    );
    if radius_m < CIRCLE_MIN_M || offset_m.xy().norm() > BESIDE_AXIS_M {
        return point;
    }
    format!(
        "{point}. References on the surface: cdcrctl ref spiral, and circles about the axis such as cdcrctl ref circle --radius {radius_m:.4} --height {z:.4}"
    )
}

/// What to add to a refusal where the offset of another pose, as large as the present one may be, makes up for `beyond_m`.
fn offset_hint(record: &Telemetry, beyond_m: f64) -> String {
    if beyond_m > record.tip_margin_m {
        return String::new();
    }
    format!(
        ". This depends on the tip sensor: it measures the tip {:.1} mm from where the bends place it in the present pose, and this tip offset changes \
         with the pose. Bring the tip nearer (cdcrctl goto) and repeat, or allow a larger --max-error; cdcrctl calibrate geometry reduces the offset",
        offset_mm(record)
    )
}

/// Prints a note where a reference is reachable only with the present offset.
fn note(record: &Telemetry, is_sure: bool) {
    if !is_sure {
        tell!(
            "note: this is at the edge of the workspace, and reachable only with the tip offset of the present pose, {:.1} mm from where the \
             bends place the tip. The offset changes with the pose, so the tip may miss it",
            offset_mm(record)
        );
    }
}

fn offset_mm(record: &Telemetry) -> f64 {
    1e3 * Vector3::from(record.tip_offset_m).norm()
}

/// Names the bend limit that keeps the tip from getting nearer than in the configuration `found`.
fn limit(robot: &Robot, found: &Configuration) -> String {
    let bend = BendShare::largest(robot, found).at_limit();
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
pub(crate) fn approached(
    robot: &Robot,
    from: &Configuration,
    point_m: &Vector3<f64>,
) -> (Configuration, f64) {
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
    use crate::dry_run::tests::robot;

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

    /// The circle that the refusal names is reachable.
    #[test]
    fn one_section_is_told_what_it_reaches_instead() {
        let robot = Robot::new(&RobotParameters::paper(1)).expect("the paper's");
        for point_m in [[0.03, 0.0, 0.255], [0.1, 0.05, 0.2], [0.0, -0.15, 0.29]] {
            let straight = Configuration::straight(1);
            let (found, left_m) = nearest(&robot, &straight, &point_m.into(), 1e-3);
            assert!(left_m > 1e-3, "{left_m}");
            let text = surface(&robot, &robot.tip_position(&found), &Vector3::zeros());
            let number = |name: &str| -> f64 {
                let (_, rest) = text.split_once(name).expect(name);
                let word = rest.split_whitespace().next().expect("a number");
                word.parse().expect(word)
            };
            let (radius_m, height_m) = (number("--radius "), number("--height "));
            for k in 0..16 {
                let (sin, cos) = (0.4 * f64::from(k)).sin_cos();
                let there_m = Vector3::new(radius_m * cos, radius_m * sin, height_m);
                let (_, left_m) = nearest(&robot, &straight, &there_m, 1e-3);
                assert!(left_m < 1e-3, "{text}: {left_m}");
            }
        }
        let above_m = Vector3::new(0.0, 0.0, 0.3);
        for (beside_axis_m, offset_m) in [(0.0, 0.0), (0.1, 2e-3)] {
            let nearest_m = above_m + Vector3::x() * beside_axis_m;
            let text = surface(&robot, &nearest_m, &(Vector3::y() * offset_m));
            assert!(text.contains("nearest point"), "{text}");
            assert!(!text.contains("--radius"), "it would be refused: {text}");
        }
        let two = Robot::new(&RobotParameters::paper(2)).expect("the paper's");
        assert_eq!(surface(&two, &Vector3::zeros(), &Vector3::zeros()), "");
    }

    #[test]
    fn a_refusal_says_where_the_offset_of_this_pose_decides() {
        let record = Telemetry {
            tip_margin_m: 0.0157,
            tip_offset_m: [0.0, 0.0, -0.015],
            robot: robot(1),
            ..Telemetry::default()
        };
        for (z_m, is_refused, is_hinted) in [
            (0.285, false, false),
            (0.295, true, true),
            (0.305, true, false),
        ] {
            let checked = check_point(&record, [0.0, 0.0, z_m], 1e-3);
            let text = checked.map_or_else(|error| error.to_string(), |()| String::new());
            assert_eq!(!text.is_empty(), is_refused, "{z_m}: {text}");
            let hint = "This depends on the tip sensor: it measures the tip 15.0 mm from";
            assert_eq!(text.contains(hint), is_hinted, "{z_m}: {text}");
        }
    }
}
