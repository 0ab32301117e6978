//! Obstacles out of reach: further than the robot, or one of its sections, can move.

use core::f64::consts::PI;

use cdcr_controller::robot::{Configuration, Robot, RobotParameters, SECTIONS_MAX};
use nalgebra::Vector3;
use proptest::prelude::*;

use crate::clearance::oracle::axis_distance_m;
use crate::clearance::scene::{
    bend_max_rad, capsule, places, robots_and_shapes, segment, sphere, vector,
};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(crate::repetitions(50, 400)))]

    #[test]
    fn what_is_out_of_reach_is_further_than_the_travel(
        (robot, shape) in robots_and_shapes(), place in places(), travel_m in -0.1..1.0_f64,
        direction in vector(1.0),
    ) {
        let [start_m, end_m] = segment(&robot, &shape, place);
        let direction = direction.normalize();
        for obstacle in [sphere(start_m, 0.02), capsule(start_m, end_m, 0.02)] {
            let clearance_m = robot.clearance_m(&shape, &obstacle);
            if !robot.reaches(&shape, &obstacle, travel_m) {
                prop_assert!(clearance_m > travel_m);
            }
            let body = robot.body(&shape);
            for (j, section) in robot.sections().iter().enumerate() {
                let (exact_m, least_m) = (body.clearance_of(j, &obstacle), body.clearance_min_of(j, &obstacle));
                prop_assert!(least_m <= exact_m);
                // By at most the distance of the arc from its chord, on either side.
                let bulge_m = 0.125 * section.length_m * shape.bend_rad(j);
                let is_known = shape.bend_rad(j) <= PI && least_m > f64::NEG_INFINITY;
                prop_assert!(!is_known || exact_m - least_m <= 2.0 * bulge_m + 1e-6);
                // For any direction a lower bound; for that of a straight section the clearance itself.
                let own = body.nearest_of(j, &obstacle).direction;
                for direction in [own, -own, direction] {
                    let least_m = body.clearance_min_along(j, &obstacle, &direction);
                    let is_half = shape.bend_rad(j) > PI - 1e-9;
                    prop_assert!(least_m <= exact_m || is_half && least_m.is_nan());
                }
                let least_m = body.clearance_min_along(j, &obstacle, &own);
                prop_assert!(bulge_m > 0.0 || exact_m < 1e-3 || exact_m - least_m <= 1e-9);
            }
            // Within the diameter of the largest bounding ball, the bound must not exclude the obstacle.
            let largest_m = robot.sections().iter().map(|section| section.length_m).fold(0.0, f64::max);
            prop_assert!(robot.reaches(&shape, &obstacle, clearance_m));
            prop_assert!(!robot.reaches(&shape, &obstacle, clearance_m - largest_m - 1e-9));
        }
    }

    #[test]
    fn no_point_is_displaced_further_or_leaves_its_chord_by_more_than_the_bounds(
        (robot, shape) in robots_and_shapes(), largest_rad in 1e-4..1.0_f64,
        rates in prop::array::uniform12(-1.0..1.0_f64),
    ) {
        let [mut middle, mut moved] = [shape; 2];
        for (i, rate) in rates.iter().enumerate().take(robot.coordinate_count()) {
            middle.as_mut_slice()[i] += 0.5 * largest_rad * rate;
            moved.as_mut_slice()[i] += largest_rad * rate;
        }
        let frames = [&shape, &moved].map(|shape| robot.section_frames(shape));
        let displacement_m = robot.displacement_m((&shape, &frames[0]), (&moved, &frames[1]));
        // One second from one shape to the other.
        let rates_rad_s = core::array::from_fn(|j| largest_rad * rates[2 * j].hypot(rates[2 * j + 1]));
        let acceleration_m_s2 = robot.acceleration_m_s2(&rates_rad_s);
        for j in 0..robot.section_count() {
            for part in 0..=20 {
                let point_m = |shape| robot.body_point(shape, j, f64::from(part) / 20.0);
                let [begin_m, middle_m, end_m] = [&shape, &middle, &moved].map(point_m);
                prop_assert!((end_m - begin_m).norm() <= displacement_m[j] + 1e-12);
                let beside_m = (middle_m - 0.5 * (begin_m + end_m)).norm();
                prop_assert!(beside_m <= acceleration_m_s2[j] / 8.0 + 1e-12);
            }
        }
    }

    #[test]
    fn no_point_moves_further_than_the_travel_and_no_section_out_of_reach_comes_near(
        (robot, shape) in robots_and_shapes(), place in places(), safe_m in 0.0..0.1_f64,
        changes in prop::array::uniform6((0.0..1.0_f64, -PI..PI, prop::bool::weighted(0.3))),
    ) {
        let mut moved = shape;
        for (j, (size, phi, is_along)) in changes.iter().enumerate().take(robot.section_count()) {
            // An arc's end moves fastest along the bend.
            let phi = if *is_along { shape.direction_rad(j) } else { *phi };
            moved.as_mut_slice()[2 * j] += size * phi.cos();
            moved.as_mut_slice()[2 * j + 1] += size * phi.sin();
        }
        let travel_m = robot.travel_m(&changes.map(|(size, _, _)| size));
        let reach_m = travel_m.map(|travel_m| travel_m + safe_m);
        let [start_m, end_m] = segment(&robot, &shape, place);
        let obstacles = [sphere(start_m, 0.02), capsule(start_m, end_m, 0.01)];
        let sections = obstacles.map(|obstacle| robot.body(&shape).sections_in_reach(&obstacle, &reach_m));
        for (j, parameters) in robot.sections().iter().enumerate() {
            for i in 0..=20 {
                let [before_m, after_m] = [shape, moved].map(|shape| robot.body_point(&shape, j, f64::from(i) / 20.0));
                let moved_m = (after_m - before_m).norm();
                prop_assert!(moved_m <= travel_m[j] + 1e-14, "section {j}: {moved_m} of {} m", travel_m[j]);
                for (obstacle, sections) in obstacles.iter().zip(sections) {
                    let radii_m = parameters.body_radius_m + obstacle.radius_m();
                    let clearance_m = axis_distance_m(obstacle.shape(), after_m) - radii_m;
                    prop_assert!(sections & (1 << j) != 0 || clearance_m > safe_m);
                }
            }
        }
        prop_assert_eq!(travel_m[robot.section_count()..].iter().sum::<f64>(), 0.0);
    }

    #[test]
    fn a_section_is_in_reach_just_where_its_clearance_is_below_the_travel(
        (robot, shape) in robots_and_shapes(), place in places(), travel_m in prop::array::uniform6(0.0..0.5_f64),
    ) {
        prop_assume!(bend_max_rad(&shape) <= PI);
        let [start_m, end_m] = segment(&robot, &shape, place);
        for obstacle in [sphere(start_m, 0.02), capsule(start_m, end_m, 0.01)] {
            let body = robot.body(&shape);
            let sections = body.sections_in_reach(&obstacle, &travel_m);
            for j in 0..robot.section_count() {
                let clearance_m = body.clearance_of(j, &obstacle);
                let is_in_reach = sections & (1 << j) != 0;
                let beyond_m = clearance_m - travel_m[j];
                prop_assert!((is_in_reach && beyond_m < 1e-11) || (!is_in_reach && beyond_m > 0.0));
            }
            prop_assert_eq!(sections >> robot.section_count(), 0);
        }
    }
}

#[test]
fn what_is_unknown_or_moves_without_bound_is_in_reach() {
    let robot = Robot::new(&RobotParameters::paper(3)).unwrap();
    let far = sphere(Vector3::repeat(1e3), 0.0);
    let mut shape = Configuration::straight(3);
    let body = robot.body(&shape);
    assert_eq!(body.sections_in_reach(&far, &[1.0; SECTIONS_MAX]), 0);
    let travel_m = robot.travel_m(&[0.0, f64::INFINITY, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!(body.sections_in_reach(&far, &travel_m), 0b110);
    let travel_m = robot.travel_m(&[f64::NAN, 0.0, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!(body.sections_in_reach(&far, &travel_m), 0b111);
    shape.as_mut_slice()[2] = f64::NAN;
    let body = robot.body(&shape);
    assert_eq!(body.sections_in_reach(&far, &[1.0; SECTIONS_MAX]), 0b110);
}
