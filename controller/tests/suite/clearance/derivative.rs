//! Derivatives against finite differences, and continuity of the clearance.

use cdcr_controller::robot::{COORDINATES_MAX, Nearest, SECTIONS_MAX};
use nalgebra::Vector3;
use proptest::prelude::*;

use crate::clearance::oracle::axis_distance_m;
use crate::clearance::scene::{capsule, places, robots_and_shapes, segment, sphere, vector};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(crate::repetitions(50, 400)))]

    #[test]
    fn the_jacobian_of_a_body_point_is_its_derivative(
        (robot, shape) in robots_and_shapes(), section in 0..SECTIONS_MAX + 1, s in -0.1..1.1_f64,
    ) {
        const STEP_RAD: f64 = 1e-3;
        let mut jacobian = [[f64::NAN; 3]; COORDINATES_MAX];
        let point_m = robot.body_motion(&shape).point_jacobian(section, s, &mut jacobian);
        prop_assert!((point_m - robot.body_point(&shape, section, s)).norm() < 1e-15);
        for (i, column) in jacobian.iter().enumerate() {
            let at = |steps: f64| {
                let mut moved = shape;
                if let Some(component) = moved.as_mut_slice().get_mut(i) {
                    *component += steps * STEP_RAD;
                }
                robot.body_point(&moved, section, s)
            };
            // Fourth order: truncation near 1e-13, rounding near 1e-12.
            let expected = ((at(1.0) - at(-1.0)) * 8.0 - (at(2.0) - at(-2.0))) / (12.0 * STEP_RAD);
            let error = (Vector3::from(*column) - expected).norm();
            prop_assert!(error < 1e-11, "column {i}: off by {error:e}");
            if i / 2 > section || i >= robot.coordinate_count() {
                prop_assert_eq!(*column, [0.0; 3]);
            }
        }
    }

    #[test]
    fn the_gradient_of_clearance_is_direction_times_jacobian(
        (robot, shape) in robots_and_shapes(), place in places(), is_capsule in any::<bool>(),
    ) {
        const STEP_RAD: f64 = 1e-6;
        let [start_m, end_m] = segment(&robot, &shape, place);
        let obstacle = if is_capsule { capsule(start_m, end_m, 0.01) } else { sphere(start_m, 0.01) };
        let nearest = robot.nearest(&shape, &obstacle);
        // Distance has a kink at zero.
        if axis_distance_m(obstacle.shape(), nearest.point_m) < 1e-2 {
            return Ok(());
        }
        let mut jacobian = [[0.0; 3]; COORDINATES_MAX];
        robot.body_motion(&shape).point_jacobian(nearest.section, nearest.s, &mut jacobian);
        for i in 0..robot.coordinate_count() {
            let at = |steps: f64| {
                let mut moved = shape;
                moved.as_mut_slice()[i] += steps * STEP_RAD;
                robot.nearest(&moved, &obstacle)
            };
            let (ahead, behind) = (at(1.0), at(-1.0));
            // Where the nearest point jumps there is a kink too.
            let stays = |other: &Nearest| (other.point_m - nearest.point_m).norm() < 1e-3;
            if !(stays(&ahead) && stays(&behind)) {
                continue;
            }
            let expected = (ahead.clearance_m - behind.clearance_m) / (2.0 * STEP_RAD);
            let column = Vector3::from(jacobian[i]);
            let found = column.dot(&nearest.direction);
            // The difference is a mean of the gradients between both points, so it may differ as much as they
            // do.
            let spread = [ahead, behind].map(|other| {
                let turn = (other.direction - nearest.direction).norm();
                turn * column.norm() + 2.0 * (other.point_m - nearest.point_m).norm()
            });
            let tolerance = 1e-6 * robot.reach_m() + spread[0].max(spread[1]);
            prop_assert!((found - expected).abs() < tolerance, "{i}: {found} for {expected}");
        }
    }

    #[test]
    fn clearance_is_continuous_in_the_bends_and_in_the_obstacle(
        (robot, shape) in robots_and_shapes(), place in places(),
        bends in prop::array::uniform12(-1.0..1.0_f64), by in vector(1.0), exponent in -14.0..-3.0_f64,
    ) {
        let [start_m, end_m] = segment(&robot, &shape, place);
        let size = 10_f64.powf(exponent);
        let mut moved = shape;
        for (component, bend) in moved.as_mut_slice().iter_mut().zip(bends) {
            *component += size * bend;
        }
        // No body point moves faster than the reach per radian; each section moves by at most √2 size.
        let travel_m = size * (by.norm() + 1.5 * robot.reach_m() * robot.section_count() as f64) + 1e-14;
        for (before, after) in [
            (sphere(start_m, 0.01), sphere(start_m + by * size, 0.01)),
            (capsule(start_m, end_m, 0.01), capsule(start_m + by * size, end_m + by * size, 0.01)),
        ] {
            let change_m = robot.clearance_m(&moved, &after) - robot.clearance_m(&shape, &before);
            prop_assert!(change_m.abs() <= travel_m, "{change_m:e} for {travel_m:e} m");
        }
    }
}
