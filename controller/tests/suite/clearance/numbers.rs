//! Numbers that are not finite, and the largest allowed ones.

use cdcr_controller::robot::{Configuration, Robot, RobotParameters, ranges};
use nalgebra::Vector3;

use crate::clearance::scene::{capsule, sphere};

#[test]
fn a_nan_is_never_a_clearance() {
    for n in ranges::SECTION_COUNT {
        let robot = Robot::new(&RobotParameters::paper(n)).unwrap();
        let mut shape = Configuration::from_bend_angles(&vec![[0.4, 0.3]; n]);
        for i in 0..2 * n {
            for value in [f64::NAN, f64::INFINITY] {
                let before = std::mem::replace(&mut shape.as_mut_slice()[i], value);
                for obstacle in [
                    sphere(Vector3::x(), 0.01),
                    capsule(Vector3::x(), Vector3::y(), 0.01),
                ] {
                    assert!(
                        robot.clearance_m(&shape, &obstacle).is_nan(),
                        "{n} {i} {value}"
                    );
                    assert!(robot.nearest(&shape, &obstacle).clearance_m.is_nan());
                    assert!(robot.reaches(&shape, &obstacle, 0.0));
                }
                shape.as_mut_slice()[i] = before;
            }
        }
    }
}

#[test]
fn the_largest_numbers_allowed_overflow_nothing() {
    let robot = Robot::new(&RobotParameters::paper(6)).unwrap();
    let far_m = Vector3::repeat(1e6);
    for theta in [0.0, 1e-15, 1e-6, 2.8] {
        let shape = Configuration::from_bend_angles(&[[theta, 1.0]; 6]);
        let away = robot.nearest(&shape, &sphere(far_m, 1e6));
        assert!((away.clearance_m - (3_f64.sqrt() - 1.0) * 1e6).abs() < 3.0);
        // Six orders of magnitude longer than the robot: six digits of the distance are lost.
        let through = robot.nearest(&shape, &capsule(-far_m, far_m, 0.0));
        assert!(
            (through.clearance_m + 0.015).abs() < 1e-9,
            "{}",
            through.clearance_m
        );
    }
}
