//! Clearance against the sampled curve, and the clearance of two obstacles.

use proptest::prelude::*;

use crate::clearance::oracle::check_against_oracle;
use crate::clearance::scene::{capsule, places, robots_and_shapes, segment, sphere};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(crate::repetitions(50, 400)))]

    #[test]
    fn spheres_agree_with_the_sampled_curve(
        (robot, shape) in robots_and_shapes(), place in places(), radius_m in 0.0..0.1_f64,
    ) {
        let [centre_m, _] = segment(&robot, &shape, place);
        check_against_oracle(&robot, &shape, &sphere(centre_m, radius_m));
    }

    #[test]
    fn capsules_agree_with_the_sampled_curve(
        (robot, shape) in robots_and_shapes(), place in places(), radius_m in 0.0..0.1_f64,
    ) {
        let [start_m, end_m] = segment(&robot, &shape, place);
        check_against_oracle(&robot, &shape, &capsule(start_m, end_m, radius_m));
        check_against_oracle(&robot, &shape, &capsule(end_m, start_m, radius_m));
    }

    #[test]
    fn both_curves_sampled_are_never_nearer((robot, shape) in robots_and_shapes(), place in places()) {
        let [start_m, end_m] = segment(&robot, &shape, place);
        let clearance_m = robot.clearance_m(&shape, &capsule(start_m, end_m, 0.0));
        for (j, section) in robot.sections().iter().enumerate() {
            for i in 0..=40 {
                let body_m = robot.body_point(&shape, j, f64::from(i) / 40.0);
                for k in 0..=40 {
                    let axis_m = start_m + (end_m - start_m) * (f64::from(k) / 40.0);
                    let sampled_m = (body_m - axis_m).norm() - section.body_radius_m;
                    prop_assert!(clearance_m <= sampled_m + 1e-13);
                }
            }
        }
    }

    #[test]
    fn a_capsule_without_length_is_a_sphere(
        (robot, shape) in robots_and_shapes(), place in places(), radius_m in 0.0..0.1_f64,
    ) {
        let [centre_m, _] = segment(&robot, &shape, place);
        let ball = robot.nearest(&shape, &sphere(centre_m, radius_m));
        prop_assert_eq!(ball, robot.nearest(&shape, &capsule(centre_m, centre_m, radius_m)));
    }

    #[test]
    fn a_sphere_along_a_capsule_is_never_nearer((robot, shape) in robots_and_shapes(), place in places(), t in 0.0..1.0_f64) {
        let [start_m, end_m] = segment(&robot, &shape, place);
        let whole_m = robot.clearance_m(&shape, &capsule(start_m, end_m, 0.01));
        let part_m = robot.clearance_m(&shape, &sphere(start_m + (end_m - start_m) * t, 0.01));
        prop_assert!(whole_m <= part_m + 1e-13);
    }
}
