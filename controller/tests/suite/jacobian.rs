//! The tip's Jacobian against finite differences of the forward kinematics, for 1 to 6 different sections,
//! bent, nearly straight and straight. Velocities are compared with the tip's position, angular velocities by
//! the identity Ṙ = skew(ω) R.

use cdcr_controller::robot::{
    Configuration, Jacobian, Robot, RobotParameters, SECTIONS_MAX, ranges,
};
use nalgebra::{Matrix3, Vector3};
use proptest::prelude::*;

/// Step of the fourth-order differences (rad). Truncation (step⁴/30 times a fifth derivative) stays near
/// 1e-13; rounding (a few 1e-15 of a chain of six sections, over the step) near 4e-12.
const STEP_RAD: f64 = 1e-3;
/// Tolerance of a difference, per metre of reach or per radian.
const DIFFERENCE_TOLERANCE: f64 = 1e-11;

/// Robots of 1 to 6 different sections, each bent, nearly straight or exactly straight.
fn robots_and_shapes() -> impl Strategy<Value = (Robot, Configuration)> {
    let bend_rad = prop_oneof![
        6 => 0.0..2.8_f64,
        1 => 1e-12..1e-3_f64,
        1 => Just(0.0),
        // Beyond the limits of a robot, where the closed form replaces the series.
        1 => 3.1..6.2_f64,
    ];
    let section = (0.05..0.5_f64, bend_rad, -3.2..3.2_f64);
    prop::collection::vec(section, 1..=SECTIONS_MAX).prop_map(|sections| {
        let mut parameters = RobotParameters::paper(sections.len());
        for (target, (length_m, ..)) in parameters.sections.iter_mut().zip(&sections) {
            target.length_m = *length_m;
        }
        let angles: Vec<[f64; 2]> = sections
            .iter()
            .map(|(_, theta, phi)| [*theta, *phi])
            .collect();
        (
            Robot::new(&parameters).unwrap(),
            Configuration::from_bend_angles(&angles),
        )
    })
}

/// Fourth-order central difference of `f` at 0.
fn difference<T>(f: impl Fn(f64) -> T) -> T
where
    T: std::ops::Sub<Output = T> + std::ops::Mul<f64, Output = T>,
{
    let near = f(STEP_RAD) - f(-STEP_RAD);
    let far = f(2.0 * STEP_RAD) - f(-2.0 * STEP_RAD);
    (near * 8.0 - far) * (1.0 / (12.0 * STEP_RAD))
}

fn moved(shape: &Configuration, i: usize, by_rad: f64) -> Configuration {
    let mut moved = *shape;
    moved.as_mut_slice()[i] += by_rad;
    moved
}

fn skew(w: Vector3<f64>) -> Matrix3<f64> {
    w.cross_matrix()
}

/// Checks every column.
fn check(robot: &Robot, shape: &Configuration) -> Result<(), TestCaseError> {
    let mut jacobian = Jacobian::new();
    let pose = robot.tip_jacobian(shape, &mut jacobian);
    prop_assert_eq!(pose, robot.tip_pose(shape));
    prop_assert_eq!(jacobian.column_count(), robot.coordinate_count());
    for i in 0..robot.coordinate_count() {
        let [vx, vy, vz, wx, wy, wz] = *jacobian.column(i);

        let velocity = difference(|step| robot.tip_position(&moved(shape, i, step)));
        let error = (velocity - Vector3::new(vx, vy, vz)).norm();
        prop_assert!(
            error < DIFFERENCE_TOLERANCE * robot.reach_m().max(1.0),
            "column {i}: v off by {error:e}"
        );

        let rotation_rate = difference(|step| robot.tip_pose(&moved(shape, i, step)).rotation);
        let error = (rotation_rate - skew(Vector3::new(wx, wy, wz)) * pose.rotation).amax();
        prop_assert!(
            error < DIFFERENCE_TOLERANCE,
            "column {i}: omega off by {error:e}"
        );
    }
    Ok(())
}

proptest! {
    #[test]
    fn columns_are_velocities((robot, shape) in robots_and_shapes()) {
        check(&robot, &shape)?;
    }

    #[test]
    fn a_rigid_turn_of_the_base_section_turns_the_tip_about_its_end((robot, shape) in robots_and_shapes()) {
        // Independent of differences: the velocity of the tip relative to the first joint is ω × lever arm.
        let mut whole = Jacobian::new();
        let tip = robot.tip_jacobian(&shape, &mut whole).position_m;
        let first = Robot::new(&RobotParameters { sections: vec![robot.sections()[0]], ..RobotParameters::paper(1) }).unwrap();
        let mut own = Jacobian::new();
        let end = first.tip_jacobian(&shape, &mut own).position_m;
        for i in 0..2 {
            let relative = Vector3::from_fn(|row, _| whole.column(i)[row] - own.column(i)[row]);
            let spin = Vector3::from_column_slice(&own.column(i)[3..]);
            prop_assert!((relative - spin.cross(&(tip - end))).norm() < 1e-15 * robot.reach_m().max(1.0) * 4.0);
        }
    }

    #[test]
    fn by_bend_angles_equals_differences_in_theta_and_phi(angles in prop::collection::vec([-2.8..2.8_f64, -3.2..3.2_f64], 1..=SECTIONS_MAX)) {
        let angles: Vec<[f64; 2]> = angles;
        let robot = Robot::new(&RobotParameters::paper(angles.len())).unwrap();
        let mut jacobian = Jacobian::new();
        robot.tip_jacobian(&Configuration::from_bend_angles(&angles), &mut jacobian);
        let by_angles = jacobian.to_bend_angles(&angles);
        for i in 0..2 * angles.len() {
            let position = |step: f64| {
                let mut moved = angles.clone();
                moved[i / 2][i % 2] += step;
                robot.tip_position(&Configuration::from_bend_angles(&moved))
            };
            let expected = difference(position);
            let found = Vector3::from_column_slice(&by_angles.column(i)[..3]);
            prop_assert!((found - expected).norm() < DIFFERENCE_TOLERANCE * robot.reach_m().max(1.0));
        }
    }
}

#[test]
fn straight_and_nearly_straight_robots_of_every_section_count() {
    for n in ranges::SECTION_COUNT {
        let robot = Robot::new(&RobotParameters::paper(n)).unwrap();
        check(&robot, &Configuration::straight(n)).unwrap();
        for theta in [1e-300, 1e-16, 1e-8, 1e-4] {
            check(
                &robot,
                &Configuration::from_bend_angles(&vec![[theta, 0.4]; n]),
            )
            .unwrap();
        }
    }
}

#[test]
fn a_straight_robot_cannot_move_along_its_axis() {
    for n in ranges::SECTION_COUNT {
        let robot = Robot::new(&RobotParameters::paper(n)).unwrap();
        let mut jacobian = Jacobian::new();
        robot.tip_jacobian(&Configuration::straight(n), &mut jacobian);
        for (i, column) in jacobian.columns().iter().enumerate() {
            assert!(column[2].to_bits() << 1 == 0, "column {i} of {n} sections");
        }
    }
}

#[test]
fn a_jacobian_reused_for_a_smaller_robot_keeps_nothing_of_the_larger() {
    let robot = |n| Robot::new(&RobotParameters::paper(n)).unwrap();
    let bent = |n: usize| Configuration::from_slice(&[0.3; 12][..2 * n]).unwrap();
    let mut reused = Jacobian::new();
    robot(6).tip_jacobian(&bent(6), &mut reused);
    robot(2).tip_jacobian(&bent(2), &mut reused);
    let mut fresh = Jacobian::new();
    robot(2).tip_jacobian(&bent(2), &mut fresh);
    assert_eq!(reused, fresh);
    for i in 4..12 {
        assert_eq!(reused.column(i).map(f64::to_bits), [0; 6]);
    }
}
