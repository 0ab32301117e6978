//! One arc without thickness, with known distances.

use core::f64::consts::{FRAC_PI_2, PI, TAU};

use cdcr_controller::robot::{Configuration, Robot, RobotParameters};
use nalgebra::Vector3;

use crate::clearance::oracle::{axis_distance_m, check_against_oracle, check_consistent};
use crate::clearance::scene::{capsule, sphere};

/// One section of 0.3 m without thickness.
fn line_robot() -> Robot {
    let mut parameters = RobotParameters::paper(1);
    parameters.sections[0].body_radius_m = 0.0;
    Robot::new(&parameters).unwrap()
}

fn bent(theta: f64, phi: f64) -> Configuration {
    Configuration::from_bend_angles(&[[theta, phi]])
}

#[test]
fn the_papers_circle_has_the_routes_of_the_model() {
    let robot = line_robot();
    // The reference at t = π/2: the tip of θ = 75°, φ = π/2.
    let reference = bent(75_f64.to_radians(), FRAC_PI_2);
    let obstacle = sphere(robot.tip_position(&reference), 0.0);
    let clearance_m = |deg: f64| robot.clearance_m(&bent(deg.to_radians(), FRAC_PI_2), &obstacle);
    let tip_m = |deg: f64| {
        let tip = robot.tip_position(&bent(deg.to_radians(), FRAC_PI_2));
        axis_distance_m(obstacle.shape(), tip)
    };
    // The angle at which `distance_m` equals D, between one with less and one with more.
    let crossing_deg =
        |distance_m: &dyn Fn(f64) -> f64, wanted_m: f64, mut less: f64, mut more: f64| {
            for _ in 0..60 {
                let middle = 0.5 * (less + more);
                if distance_m(middle) < wanted_m {
                    less = middle;
                } else {
                    more = middle;
                }
            }
            more
        };
    // The model gives tenths of a degree, rounded to the safe side, and to the nearest for the tip. These
    // digits come from a sampled curve (Python, 4001 samples, bisection).
    for (safe_m, inside, outside, tip_alone) in [
        (0.01, (71.0029, 71.0), (79.5174, 79.6), (79.0177, 79.0)),
        (0.02, (67.0228, 67.0), (84.2634, 84.3), (83.0596, 83.1)),
        (0.04, (59.1007, 59.1), (94.6050, 94.7), (91.2316, 91.2)),
    ] {
        let check = |found: f64, expected: (f64, f64), round: fn(f64) -> f64| {
            assert!((found - expected.0).abs() < 1e-4, "{found}, D = {safe_m} m");
            assert_eq!(round(found * 10.0) / 10.0, expected.1, "D = {safe_m} m");
        };
        check(
            crossing_deg(&clearance_m, safe_m, 75.0, 30.0),
            inside,
            f64::floor,
        );
        check(
            crossing_deg(&clearance_m, safe_m, 75.0, 130.0),
            outside,
            f64::ceil,
        );
        check(
            crossing_deg(&tip_m, safe_m, 75.0, 130.0),
            tip_alone,
            f64::round,
        );
    }
}

#[test]
fn half_a_circle_and_more_know_their_centre_their_gap_and_their_back() {
    let robot = line_robot();
    for theta in [FRAC_PI_2, 3.0, PI, 3.3, 5.0, TAU, 9.0] {
        let shape = bent(theta, 0.0);
        let radius_m = 0.3 / theta;
        let at = |a: f64, share: f64, y: f64| {
            Vector3::new(
                radius_m * (1.0 - share * a.cos()),
                y,
                radius_m * share * a.sin(),
            )
        };
        let distance_m = |point_m| robot.clearance_m(&shape, &sphere(point_m, 0.0));
        assert!(
            (distance_m(at(0.0, 0.0, 0.0)) - radius_m).abs() < 1e-15,
            "centre at {theta}"
        );
        for i in 0..200 {
            let a = TAU * f64::from(i) / 200.0;
            for (share, y) in [(0.3, 0.0), (0.9, 0.02), (1.7, -0.1)] {
                let found_m = distance_m(at(a, share, y));
                // On the arc the distance to the circle, in the gap that to the nearer end by the law of
                // cosines.
                let beyond = if a <= theta {
                    0.0
                } else {
                    (a - theta).min(TAU - a)
                };
                let across = 1.0 + share * share - 2.0 * share * beyond.cos();
                let expected_m = (radius_m * radius_m * across + y * y).sqrt();
                assert!(
                    (found_m - expected_m).abs() < 1e-14,
                    "{theta} {a} {share}: {found_m} {expected_m}"
                );
            }
        }
    }
}

#[test]
fn an_obstacle_at_the_centre_of_the_circle_still_has_a_nearest_point_on_the_arc() {
    // Regression: within rounding of the centre, the point lost all its digits.
    let robot = line_robot();
    let ways = crate::repetitions(2, 12);
    for theta in [0.8, 2.0, 2.8, PI, 4.0, TAU, 8.0] {
        for phi in [0.0, 0.7, -2.0] {
            let shape = bent(theta, phi);
            let centre_m = Vector3::new(phi.cos(), phi.sin(), 0.0) * (0.3 / theta);
            check_against_oracle(&robot, &shape, &sphere(centre_m, 0.0));
            for i in 0..ways {
                let (sin, cos) = (TAU * f64::from(i) / f64::from(ways)).sin_cos();
                for size in [1e-17, 1e-16, 1e-15, 1e-12] {
                    let off_m = Vector3::new(cos * phi.cos(), cos * phi.sin(), sin) * size;
                    let ball = sphere(centre_m + off_m, 0.0);
                    check_against_oracle(&robot, &shape, &ball);
                }
            }
        }
    }
}

#[test]
fn of_two_equally_near_places_one_is_found_and_clearance_does_not_jump() {
    // A capsule across the opening of an arc: two minima, one on each side. As it shifts, the nearest point
    // changes sides.
    let robot = line_robot();
    let shape = bent(2.8, 0.0);
    let middle_m = robot.body_point(&shape, 0, 0.5);
    let centre_m = Vector3::new(0.3 / 2.8, 0.0, 0.0);
    let inwards = (centre_m - middle_m).normalize();
    let side = inwards.cross(&Vector3::y());
    let mut last_m: Option<f64> = None;
    let steps = crate::repetitions(20, 100).cast_signed();
    let step_m = 0.01 / f64::from(steps);
    for i in -steps..=steps {
        let shift = f64::from(i) * step_m;
        let at_m = middle_m + inwards * 0.06 + side * shift + Vector3::y() * 0.01;
        let obstacle = capsule(at_m - side * 0.085, at_m + side * 0.085, 0.0);
        check_against_oracle(&robot, &shape, &obstacle);
        let clearance_m = robot.clearance_m(&shape, &obstacle);
        if let Some(last_m) = last_m.replace(clearance_m) {
            assert!((clearance_m - last_m).abs() < 1.01 * step_m);
        }
    }
}

#[test]
fn it_is_smooth_through_straight() {
    let robot = line_robot();
    let obstacles = [
        sphere(Vector3::new(0.05, 0.02, 0.2), 0.01),
        sphere(Vector3::new(0.05, 0.02, 0.4), 0.01),
        sphere(Vector3::new(0.0, 0.0, 0.1), 0.01),
        capsule(
            Vector3::new(0.05, -0.2, 0.1),
            Vector3::new(0.1, 0.3, 0.25),
            0.01,
        ),
        capsule(
            Vector3::new(0.05, 0.0, -0.1),
            Vector3::new(0.05, 0.0, 0.5),
            0.01,
        ),
    ];
    for obstacle in &obstacles {
        let straight_m = robot.clearance_m(&Configuration::straight(1), obstacle);
        for exponent in 1..330 {
            let theta = 10_f64.powi(-exponent);
            for phi in [0.0, 1.0, 2.5, -2.0] {
                let shape = bent(theta, phi);
                let change_m = robot.clearance_m(&shape, obstacle) - straight_m;
                assert!(
                    change_m.abs() <= 0.15 * theta + 1e-16,
                    "{theta:e}: {change_m:e}"
                );
                check_consistent(&robot, &shape, obstacle, &robot.nearest(&shape, obstacle));
            }
        }
    }
}
