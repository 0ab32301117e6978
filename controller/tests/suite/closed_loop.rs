//! Options of the simulation and their effect.

use cdcr_controller::closed_loop::ClosedLoop;
use cdcr_controller::nmpc::{NmpcSettings, SettingsError};
use cdcr_controller::reference::ReferenceSample;
use cdcr_controller::robot::{BendRates, Configuration, Obstacle, Robot, RobotParameters, Shape};
use nalgebra::Vector3;

const PERIOD_S: f64 = 0.005;
/// Default stopping behaviour of drivers: periods, and rad/s².
const STOPPING: (f64, f64) = (3.0, 40.0);

type Loop = ClosedLoop<fn(f64) -> ReferenceSample>;

/// One straight section with a ball beside its tip.
fn begin(period_s: f64) -> Result<Loop, SettingsError> {
    let robot = Robot::new(&RobotParameters::paper(1)).unwrap();
    let shape = Shape::Sphere {
        centre_m: Vector3::new(0.12, 0.0, 0.28),
    };
    let ball = Obstacle::new(shape, 0.02, Vector3::zeros()).unwrap();
    let (settings, straight) = (NmpcSettings::default(), Configuration::straight(1));
    ClosedLoop::new(&robot, period_s, settings, straight, &[ball], |_| {
        ReferenceSample::default()
    })
}

/// Bends towards the ball for a second. Returns the smallest clearance (m), and the smallest at rest if no
/// other command follows.
fn least_m(mut closed: Loop) -> [f64; 2] {
    let desired_rates = BendRates::from_slice(&[1.0, 0.0]).unwrap();
    let mut least_m = [f64::INFINITY; 2];
    for _ in 0..200 {
        let before = *closed.configuration();
        let ball = closed.input().obstacles[0];
        closed.advance(&desired_rates);
        let rates = closed.command().rates;
        let (valid_periods, deceleration_rad_s2) = STOPPING;
        let way_s = valid_periods * PERIOD_S + 0.5 * rates.as_slice()[0] / deceleration_rad_s2;
        let rests_m = closed
            .robot()
            .clearance_m(&before.advanced(&rates, way_s), &ball);
        least_m = [
            least_m[0].min(closed.clearance_m()),
            least_m[1].min(rests_m),
        ];
    }
    least_m
}

#[test]
fn a_loop_refuses_the_periods_that_a_controller_refuses() {
    for period_s in [f64::NAN, 0.0, -PERIOD_S, f64::INFINITY] {
        assert_eq!(begin(period_s).unwrap_err().key, "period_s", "{period_s}");
    }
}

#[test]
fn a_loop_refuses_a_start_of_another_robot() {
    let (settings, two) = (NmpcSettings::default(), Configuration::straight(2));
    for sections in [1, 3] {
        let robot = Robot::new(&RobotParameters::paper(sections)).unwrap();
        let nowhere = |_| ReferenceSample::default();
        let refused = ClosedLoop::new(&robot, PERIOD_S, settings, two, &[], nowhere);
        assert_eq!(refused.map(|_| ()).unwrap_err().key, "start_sections");
    }
}

#[test]
fn commands_keep_clear_for_as_long_as_a_robot_obeys_them() {
    let of = |(periods, deceleration_rad_s2)| {
        let closed = begin(PERIOD_S).unwrap();
        least_m(closed.with_stopping(periods, deceleration_rad_s2))
    };
    let [nearest_m, rests_m] = of(STOPPING);
    assert!(nearest_m < 0.0101 && rests_m >= 0.01 - 1e-12, "{rests_m} m");
    // With fewer periods or an infinite deceleration the robot keeps less; by default it stops at once.
    let with_less = [(1.0, 40.0), (3.0, f64::INFINITY)].map(of);
    for [nearest_m, rests_m] in [least_m(begin(PERIOD_S).unwrap())]
        .into_iter()
        .chain(with_less)
    {
        assert!(
            (0.01..0.0101).contains(&nearest_m) && rests_m < 0.009,
            "{nearest_m} m, at rest {rests_m} m"
        );
    }
}

#[test]
fn a_body_that_is_beside_its_model_keeps_as_much_more_distance() {
    let closed = begin(PERIOD_S).unwrap().with_tip_offset(0.02);
    assert_eq!(closed.input().tip_offset_m, 0.02);
    let [nearest_m, _] = least_m(closed);
    assert!((0.03..0.0301).contains(&nearest_m), "{nearest_m} m");
}
