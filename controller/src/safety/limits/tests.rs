use proptest::prelude::*;

use super::*;
use crate::robot::RobotParameters;

const PERIOD_S: f64 = 0.005;

fn robot() -> Robot {
    Robot::new(&RobotParameters::paper(2)).expect("the paper's robot")
}

fn rates(values: [f64; 4]) -> BendRates {
    BendRates::from_slice(&values).expect("two sections")
}

fn configuration(values: [f64; 4]) -> Configuration {
    Configuration::from_slice(&values).expect("two sections")
}

#[test]
fn a_bend_that_the_box_would_let_out_is_shortened_onto_its_limit() {
    let robot = Robot::new(&RobotParameters::paper(1)).unwrap();
    // Along the border, keeping the bend inside asks for more than 2 rad/s in one component.
    let (mut over, mut cut) = (0.0_f64, 0);
    // Once round, in steps of a milliradian.
    for step in 0..6284 {
        let angle = f64::from(step) * 1e-3;
        for inside in [0.0, 1e-9, 1e-3, 0.02] {
            let size = 2.8 - inside;
            let at = [size * angle.cos(), size * angle.sin()];
            let at = Configuration::from_slice(&at).unwrap();
            for desired_rates in [[2.0, 2.0], [-2.0, 2.0], [1.3, -2.0], [50.0, -3.0]] {
                let desired_rates = BendRates::from_slice(&desired_rates).unwrap();
                let limited = limit(&robot, &at, &desired_rates, 0.005);
                let target = at.advanced(&limited.rates, 0.005);
                over = over.max(target.bend_rad(0) - 2.8);
                let rates = limited.rates.as_slice();
                assert!(rates.iter().all(|rate| rate.abs() <= 2.0), "{rates:?}");
                cut += u32::from(limited.hit.bend);
            }
        }
    }
    assert!(over <= 1e-12, "{over} rad beyond the limit");
    assert!(cut > 1000, "{cut} cases at the limit");
}

proptest! {
    /// Rest is rest: wherever the robot is measured, beyond its limits, too, no component of a shortened ramp is
    /// larger than the ramp's, and zero rates are zero to the bit.
    #[test]
    fn a_ramp_is_only_shortened_and_rest_stays_rest(
        bends in prop::array::uniform4(-7.0..7.0_f64),
        ramp in prop::array::uniform4(-4.0..4.0_f64),
        stroke_m in 0.001..0.1_f64,
        speed_m_s in 0.001..0.1_f64,
    ) {
        let mut parameters = RobotParameters::paper(2);
        parameters.cable_stroke_max_m = stroke_m;
        parameters.cable_speed_max_m_s = speed_m_s;
        let robot = Robot::new(&parameters).expect("legal");
        let shortened = shorten(&robot, &configuration(bends), &rates(ramp), PERIOD_S).rates;
        for (rate, ramp) in shortened.as_slice().iter().zip(ramp) {
            prop_assert!(rate.abs() <= ramp.abs() && rate * ramp >= 0.0, "{rate} of {ramp}");
        }
        let rest = shorten(&robot, &configuration(bends), &BendRates::zero(2), PERIOD_S);
        prop_assert_eq!((rest.rates, rest.hit), (BendRates::zero(2), LimitsHit::default()));
        // Inside the limits nothing is lost that a limit does not ask for.
        let inside = configuration(bends).bend_rad(0).max(configuration(bends).bend_rad(1)) < 2.0;
        if inside && stroke_m > 0.09 && speed_m_s > 0.095 && ramp.iter().all(|rate| rate.abs() < 1.0) {
            prop_assert_eq!(shortened, rates(ramp));
        }
    }
}

proptest! {
    /// No component grows faster than the acceleration allows; slowing down is free; zero is always allowed.
    #[test]
    fn speed_grows_by_the_acceleration_at_most(
        previous in prop::array::uniform4(-2.0..2.0_f64),
        desired_rates in prop::array::uniform4(-3.0..3.0_f64),
        change_rad_s in 0.0..1.0_f64,
    ) {
        let (robot, straight) = (robot(), configuration([0.0; 4]));
        let limits = Limits::new(&robot, &straight, PERIOD_S);
        let limits = limits.with_acceleration(&rates(previous), change_rad_s);
        let limited = limits.nearest(&rates(desired_rates));
        for (rate, previous) in limited.rates.as_slice().iter().zip(previous) {
            let most = if rate * previous > 0.0 { previous.abs() } else { 0.0 };
            prop_assert!(rate.abs() <= (most + change_rad_s) * (1.0 + 1e-12));
        }
        prop_assert_eq!(limited.hit.any(), limited.rates != rates(desired_rates));
        let slower = rates(previous.map(|rate| 0.3 * rate));
        prop_assert_eq!(limits.nearest(&slower), Limited { rates: slower, hit: LimitsHit::default() });
    }
}

#[test]
fn legal_rates_pass_unchanged() {
    let desired_rates = rates([0.1, -0.2, 0.3, 0.4]);
    let limited = limit(&robot(), &configuration([0.1; 4]), &desired_rates, PERIOD_S);
    assert_eq!(
        (limited.rates, limited.hit),
        (desired_rates, LimitsHit::default())
    );
}

#[test]
fn rates_and_non_finite_rates_are_cut() {
    let limited = limit(
        &robot(),
        &configuration([0.0; 4]),
        &rates([9.0, 0.0, -9.0, 0.0]),
        PERIOD_S,
    );
    assert!(limited.hit.rate);
    assert!(
        limited
            .rates
            .as_slice()
            .iter()
            .all(|rate| rate.abs() <= 2.0)
    );
    let limited = limit(
        &robot(),
        &configuration([0.0; 4]),
        &rates([f64::NAN, 0.0, 1.0, 0.0]),
        PERIOD_S,
    );
    assert!(limited.hit.non_finite);
    assert_eq!(limited.rates, BendRates::zero(2));
}

/// Rates and states of another robot move nothing, wherever they are given.
#[test]
fn what_has_another_number_of_sections_is_no_command() {
    let (robot, here, legal) = (robot(), configuration([0.0; 4]), rates([0.1; 4]));
    for sections in [1, 3] {
        let other_rates = BendRates::zero(sections);
        let other_at = Configuration::straight(sections);
        let cases = [
            (&here, None, &other_rates),
            (&other_at, None, &legal),
            (&here, Some(&other_at), &legal),
        ];
        for (at, commanded, desired_rates) in cases {
            let limits = Limits::new(&robot, at, PERIOD_S).with_commanded(commanded);
            for limited in [limits.nearest(desired_rates), limits.shorten(desired_rates)] {
                assert!(limited.hit.non_finite);
                assert_eq!(limited.rates, BendRates::zero(2));
            }
        }
    }
}

#[test]
fn a_bend_never_leaves_its_limit_and_returns_when_it_is_beyond() {
    let robot = robot();
    let mut bend = configuration([2.79, 0.0, 0.0, -2.79]);
    for _ in 0..20 {
        let limited = limit(&robot, &bend, &rates([2.0, 2.0, 2.0, -2.0]), PERIOD_S);
        bend = bend.advanced(&limited.rates, PERIOD_S);
        assert!(bend.bend_rad(0) <= 2.8 + 1e-12 && bend.bend_rad(1) <= 2.8 + 1e-12);
    }
    let beyond = configuration([2.9, 0.0, 0.0, 0.0]);
    let limited = limit(&robot, &beyond, &rates([2.0, 0.0, 0.0, 0.0]), PERIOD_S);
    assert!(limited.hit.bend && limited.rates.as_slice()[0] < 0.0);
}

#[test]
fn cables_keep_their_speed_limit() {
    let mut parameters = RobotParameters::paper(2);
    parameters.cable_speed_max_m_s = 0.01;
    let robot = Robot::new(&parameters).expect("legal");
    let limited = limit(
        &robot,
        &configuration([0.0; 4]),
        &rates([2.0, 0.0, 2.0, 0.0]),
        PERIOD_S,
    );
    let speeds = robot.cable_speeds(&limited.rates);
    assert!(limited.hit.cable_speed);
    assert!(speeds.iter().all(|speed| speed.abs() <= 0.01 + 1e-15));
}

#[test]
fn no_cable_leaves_its_stroke_and_one_beyond_it_comes_back() {
    let mut parameters = RobotParameters::paper(2);
    parameters.cable_stroke_max_m = 0.02;
    let robot = Robot::new(&parameters).expect("legal");
    let farthest_m = |bend: &Configuration| {
        let strokes_m = robot.cable_strokes(bend);
        strokes_m.iter().fold(0.0_f64, |most, m| most.max(m.abs()))
    };
    let (mut bend, mut hits) = (configuration([0.0; 4]), 0);
    for step in 0..400 {
        let turn = f64::from(step).sin();
        let desired_rates = rates([2.0, 0.3 * turn, 1.5, -turn]);
        let limited = limit(&robot, &bend, &desired_rates, PERIOD_S);
        hits += u32::from(limited.hit.cable_stroke);
        bend = bend.advanced(&limited.rates, PERIOD_S);
        assert!(farthest_m(&bend) <= 0.02 + 1e-15, "{}", farthest_m(&bend));
    }
    assert!(hits > 100, "{hits}");
    let beyond = configuration([1.8, 0.0, 0.0, 0.0]);
    let out = limit(&robot, &beyond, &rates([1.0, 0.0, 0.0, 0.0]), PERIOD_S);
    assert!(out.hit.cable_stroke);
    assert!(
        out.rates.as_slice().iter().all(|rate| rate.abs() < 1e-4),
        "{:?}",
        out.rates
    );
    let desired_rates = rates([-1.0, 0.0, 0.0, 0.0]);
    let back = limit(&robot, &beyond, &desired_rates, PERIOD_S);
    assert_eq!(
        (back.rates, back.hit),
        (desired_rates, LimitsHit::default())
    );
}

/// A robot whose section ends move at most at `tip_speed_max_m_s`.
fn slow_robot(tip_speed_max_m_s: f64) -> Robot {
    let parameters = RobotParameters {
        tip_speed_max_m_s,
        ..RobotParameters::paper(2)
    };
    Robot::new(&parameters).expect("legal")
}

proptest! {
    /// Wherever the robot is and whatever else limits it, no end of a section is faster than its limit, in motion and
    /// on a ramp; the flag is set where it would have been. Without the flag, the command is that of a robot without
    /// the limit, to the bit. All shorter rates in the same direction pass unchanged.
    #[test]
    fn no_end_of_a_section_exceeds_its_speed(
        bends in prop::array::uniform4(-2.7..2.7_f64),
        previous in prop::array::uniform4(-2.0..2.0_f64),
        desired_rates in prop::array::uniform4(-3.0..3.0_f64),
        limit_m_s in prop_oneof![0.001..0.1_f64, 0.1..2.0_f64],
        change_rad_s in prop_oneof![Just(f64::INFINITY), 0.0..1.0_f64],
        stroke_m in prop_oneof![Just(0.25), 0.001..0.1_f64],
        shorter in 0.0..1.0_f64,
    ) {
        let parameters = RobotParameters { cable_stroke_max_m: stroke_m, ..slow_robot(limit_m_s).parameters() };
        let slow = Robot::new(&parameters).expect("legal");
        let free = Robot::new(&RobotParameters { tip_speed_max_m_s: 0.0, ..parameters }).expect("legal");
        let (at, previous, desired_rates) = (configuration(bends), rates(previous), rates(desired_rates));
        let limits = |robot| Limits::new(robot, &at, PERIOD_S).with_acceleration(&previous, change_rad_s);
        let (slow, free) = (limits(&slow), limits(&free));
        for (limited, free) in [
            (slow.nearest(&desired_rates), free.nearest(&desired_rates)),
            (slow.shorten(&desired_rates), free.shorten(&desired_rates)),
        ] {
            let speed_m_s = slow.robot.fastest_section_end_m_s(&at, &limited.rates);
            prop_assert!(speed_m_s <= limit_m_s * (1.0 + 1e-12), "{speed_m_s} m/s");
            let desired_m_s = slow.robot.fastest_section_end_m_s(&at, &desired_rates);
            prop_assert_eq!(limited.hit.tip_speed, desired_m_s > limit_m_s);
            prop_assert_eq!(LimitsHit { tip_speed: false, ..limited.hit }, free.hit);
            if free.rates == limited.rates {
                continue;
            }
            // Only where the other limits permit more than this one; then it is used up.
            let others_m_s = slow.robot.fastest_section_end_m_s(&at, &free.rates);
            prop_assert!(others_m_s > limit_m_s && speed_m_s > limit_m_s * (1.0 - 1e-12));
            for (rate, free) in limited.rates.as_slice().iter().zip(free.rates.as_slice()) {
                prop_assert!((rate - free * limit_m_s / others_m_s).abs() < 1e-14);
            }
        }
        let mut shortened = slow.nearest(&desired_rates).rates;
        shortened.as_mut_slice().iter_mut().for_each(|rate| *rate *= 0.999 * shorter);
        let hit = slow.nearest(&shortened).hit;
        prop_assert!(!hit.any(), "{hit:?}");
        let straight = slow.straight(&desired_rates);
        let speed_m_s = slow.robot.fastest_section_end_m_s(&at, &straight);
        prop_assert!(speed_m_s <= limit_m_s * (1.0 + 1e-12), "{speed_m_s} m/s");
    }
}

/// Rates whose speed is not a number move nothing, and rest is rest.
#[test]
fn a_tip_speed_that_overflows_permits_no_rates() {
    let robot = slow_robot(0.1);
    let far = configuration([1e160, 0.0, 1e200, 1.0]);
    let limits = Limits::new(&robot, &far, PERIOD_S);
    for desired_rates in [rates([1.0; 4]), rates([f64::MAX; 4]), BendRates::zero(2)] {
        for limited in [
            limits.nearest(&desired_rates),
            limits.shorten(&desired_rates),
        ] {
            assert_eq!(limited.rates, BendRates::zero(2));
        }
    }
}
