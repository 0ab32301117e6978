//! The whole body: straight, in contact, of different thickness, beside a moving obstacle.

use cdcr_controller::robot::{
    Configuration, Obstacle, Robot, RobotParameters, SECTIONS_MAX, Shape,
};
use nalgebra::Vector3;
use proptest::prelude::*;

use crate::clearance::oracle::{axis_distance_m, check_consistent};
use crate::clearance::scene::{capsule, places, robots_and_shapes, segment, sphere, vector};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(crate::repetitions(50, 400)))]

    #[test]
    fn frames_computed_before_give_the_same((robot, shape) in robots_and_shapes(), place in places()) {
        let [start_m, end_m] = segment(&robot, &shape, place);
        let body = robot.body_from_frames(&shape, &robot.section_frames(&shape));
        for obstacle in [sphere(start_m, 0.02), capsule(start_m, end_m, 0.02)] {
            prop_assert_eq!(body.nearest(&obstacle), robot.nearest(&shape, &obstacle));
            prop_assert_eq!(body.clearance_m(&obstacle), robot.clearance_m(&shape, &obstacle));
        }
    }

    /// All sections are longer by the same factor. No point of the true body is farther from its model than
    /// the thickening, if the tip is farther from the base than the point.
    #[test]
    fn a_thicker_body_holds_one_that_is_longer(
        n in 1..=SECTIONS_MAX,
        bends in prop::array::uniform12(-0.8..0.8_f64),
        part in -0.05..0.05_f64,
        share in 0.0..=1.0_f64,
    ) {
        let mut parameters = RobotParameters::paper(n);
        let model = Robot::new(&parameters).unwrap();
        for section in &mut parameters.sections {
            section.length_m *= 1.0 + part;
        }
        let truth = Robot::new(&parameters).unwrap();
        let at = Configuration::from_slice(&bends[..2 * n]).unwrap();
        let tip_m = model.tip_position(&at);
        let enlarged = model.enlarged(&at, (truth.tip_position(&at) - tip_m).norm());
        for j in 0..n {
            let more_m = enlarged.sections()[j].body_radius_m - model.sections()[j].body_radius_m;
            let [model_m, true_m] = [&model, &truth].map(|robot| robot.body_point(&at, j, share));
            let is_within = (true_m - model_m).norm() <= more_m + 1e-12;
            prop_assert!(is_within || model_m.norm() > tip_m.norm());
        }
        prop_assert_eq!(&*model.enlarged(&at, 0.0), &model);
    }

    #[test]
    fn a_straight_robot_is_a_segment(n in 1..=SECTIONS_MAX, centre_m in vector(1.5), end_m in vector(1.5)) {
        let robot = Robot::new(&RobotParameters::paper(n)).unwrap();
        let shape = Configuration::straight(n);
        let tip_m = Vector3::z() * robot.reach_m();
        let backbone = Shape::Capsule { start_m: Vector3::zeros(), end_m: tip_m };
        let found_m = robot.clearance_m(&shape, &sphere(centre_m, 0.02));
        prop_assert!((found_m - (axis_distance_m(&backbone, centre_m) - 0.035)).abs() < 1e-15);
        // Two segments: the common perpendicular if it meets both, otherwise an end of one.
        let obstacle = Shape::Capsule { start_m: centre_m, end_m };
        let span = end_m - centre_m;
        let normal = span.cross(&Vector3::z());
        let t = -centre_m.xy().dot(&span.xy()) / span.xy().norm_squared();
        let z = centre_m.z + t * span.z;
        let ends = [
            axis_distance_m(&obstacle, Vector3::zeros()), axis_distance_m(&obstacle, tip_m),
            axis_distance_m(&backbone, centre_m), axis_distance_m(&backbone, end_m),
        ];
        let mut expected_m = ends.into_iter().fold(f64::INFINITY, f64::min);
        if (0.0..=1.0).contains(&t) && (0.0..=tip_m.z).contains(&z) {
            expected_m = expected_m.min(centre_m.dot(&normal).abs() / normal.norm());
        }
        let found_m = robot.clearance_m(&shape, &capsule(centre_m, end_m, 0.02));
        prop_assert!((found_m - (expected_m - 0.035)).abs() < 1e-13);
    }
}

#[test]
fn where_backbone_and_obstacle_meet_the_direction_leads_away() {
    let robot = Robot::new(&RobotParameters::paper(3)).unwrap();
    let bends = [[0.0, 0.0], [1.1, 0.4], [2.0, -2.0]];
    let shape = Configuration::from_bend_angles(&bends);
    for (section, s) in [(0, 0.5), (1, 0.0), (1, 0.3), (2, 1.0), (2, 0.7)] {
        let centre_m = robot.body_point(&shape, section, s);
        let tangent = (robot.body_point(&shape, section, (s + 1e-4).min(1.0))
            - robot.body_point(&shape, section, (s - 1e-4).max(0.0)))
        .normalize();
        for span in [Vector3::zeros(), Vector3::x() * 0.1, tangent * 0.02] {
            let obstacle = capsule(centre_m - span, centre_m + span, 0.01);
            let nearest = robot.nearest(&shape, &obstacle);
            assert!((nearest.clearance_m + 0.025).abs() < 1e-5);
            check_consistent(&robot, &shape, &obstacle, &nearest);
            assert!(nearest.direction.dot(&tangent).abs() < 0.05);
        }
    }
}

#[test]
fn the_thicker_section_is_nearer_at_equal_distance() {
    let mut parameters = RobotParameters::paper(2);
    parameters.sections[1].body_radius_m = 0.03;
    let robot = Robot::new(&parameters).unwrap();
    let beside_the_joint = sphere(Vector3::new(0.1, 0.0, 0.29), 0.01);
    let nearest = robot.nearest(&Configuration::straight(2), &beside_the_joint);
    assert_eq!((nearest.section, nearest.s), (1, 0.0));
    assert!((nearest.clearance_m - (0.1_f64.hypot(0.01) - 0.04)).abs() < 1e-15);
}

#[test]
fn a_moving_obstacle_arrives_when_it_should() {
    let robot = Robot::new(&RobotParameters::paper(1)).unwrap();
    let shape = Configuration::straight(1);
    let centre_m = Vector3::new(0.2, 0.0, 0.1);
    let velocity_m_s = Vector3::new(-0.5, 0.0, 0.0);
    let obstacle = Obstacle::new(Shape::Sphere { centre_m }, 0.025, velocity_m_s).unwrap();
    for (after_s, expected_m) in [
        (0.0, 0.16),
        (0.2, 0.06),
        (0.32, 0.0),
        (0.4, -0.04),
        (0.5, 0.01),
    ] {
        let found_m = robot.clearance_m(&shape, &obstacle.moved(after_s));
        assert!(
            (found_m - expected_m).abs() < 1e-15,
            "after {after_s} s: {found_m} m"
        );
    }
}
