use super::*;
use crate::robot::RobotParameters;

const PERIOD_S: f64 = 0.005;
const RULES: FollowingRules = FollowingRules {
    warning_rad: 0.1,
    fault_rad: 0.3,
    lag_s: 0.1,
};

fn bends(u: f64, v: f64) -> Configuration {
    Configuration::from_slice(&[u, v]).unwrap()
}

fn robot() -> Robot {
    Robot::new(&RobotParameters::paper(1)).unwrap()
}

/// Largest error of a robot that moves with `rate(t)`, and is measured by `plant(commanded, t)`.
fn largest_rad(
    obeys_positions: bool,
    rate: impl Fn(f64) -> f64,
    mut plant: impl FnMut(f64, f64) -> f64,
) -> f64 {
    let robot = robot();
    let mut watch = FollowingWatch::new(RULES, obeys_positions, bends(0.0, 0.0));
    let (mut largest, mut commanded) = (0.0_f64, 0.0);
    for step in 0..2000 {
        let time_s = f64::from(step) * PERIOD_S;
        let rates = BendRates::from_slice(&[rate(time_s), 0.0]).unwrap();
        watch.commanded(&rates, PERIOD_S, PERIOD_S);
        commanded += PERIOD_S * rate(time_s);
        let error = watch.measured(&robot, &bends(plant(commanded, rate(time_s)), 0.0));
        largest = largest.max(error.largest_rad());
    }
    largest
}

#[test]
fn lag_and_delay_are_no_error_and_standing_still_is() {
    let swing = |time_s: f64| 2.0 * (3.0 * time_s).cos();
    assert!(largest_rad(true, swing, |commanded, _| commanded) < 1e-12);
    let mut lagging = 0.0;
    let lag = largest_rad(true, swing, |commanded, _| {
        lagging += PERIOD_S / 0.03 * (commanded - lagging);
        lagging
    });
    assert!(lag < 0.01, "{lag}");
    let mut queue = std::collections::VecDeque::from([0.0; 16]);
    let delay = largest_rad(true, swing, |commanded, _| {
        queue.push_back(commanded);
        queue.pop_front().unwrap()
    });
    assert!(delay < 1e-12, "{delay}");
    assert!(largest_rad(true, swing, |_, _| 0.0) > RULES.fault_rad);
    // A constant offset is the error that it is.
    let offset = largest_rad(true, swing, |commanded, _| commanded + 0.05);
    assert!((offset - 0.05).abs() < 0.01, "{offset}");
}

/// The window is the lag, at any period: what was commanded before it is forgotten.
#[test]
fn the_window_is_as_long_as_the_lag() {
    for (period_s, lag_s) in [
        (0.005, 0.1),
        (0.02, 0.1),
        (0.1, 0.1),
        (0.001, 0.1),
        (0.02, 0.0),
    ] {
        let rules = FollowingRules { lag_s, ..RULES };
        let mut watch = FollowingWatch::new(rules, true, bends(0.0, 0.0));
        let rates = BendRates::from_slice(&[1.0, 0.0]).unwrap();
        let mut commanded = 0.0;
        for _ in 0..200 {
            watch.commanded(&rates, period_s, period_s);
            commanded += period_s;
        }
        // A robot that lags by half of it is not an error, one by twice of it and two periods is.
        let at = |behind_s: f64| bends(commanded - behind_s, 0.0);
        let near_rad = watch.measured(&robot(), &at(0.5 * lag_s)).largest_rad();
        assert!(near_rad < 1e-12, "{period_s} s: {near_rad}");
        let far_s = 2.0 * lag_s + 2.0 * period_s;
        let far_rad = watch.measured(&robot(), &at(far_s)).largest_rad();
        assert!(
            far_rad >= lag_s + period_s - 1e-9,
            "{period_s} s: {far_rad}"
        );
    }
}

#[test]
fn a_robot_that_obeys_speeds_may_drift_but_not_stand() {
    let turn = |time_s: f64| if time_s < 5.0 { 0.5 } else { -0.5 };
    let mut slow = 0.0;
    let drift = largest_rad(false, turn, |_, rate| {
        slow += PERIOD_S * 0.97 * rate;
        slow
    });
    assert!(drift < RULES.warning_rad, "{drift}");
    assert!(largest_rad(false, turn, |_, _| 0.0) > RULES.fault_rad);
}

/// Commands of 1 rad/s for a second end in a fault; the motors rest somewhere on the way of the last 0.1 s. Whatever
/// is measured then, for how long, the expected position is that of the last command, until control begins again.
#[test]
fn in_a_latched_mode_the_last_command_is_not_forgotten() {
    let robot = robot();
    for obeys_positions in [true, false] {
        let mut watch = FollowingWatch::new(RULES, obeys_positions, bends(0.0, 0.0));
        let mut turn = |rate: f64, measured: f64, is_latched: bool| {
            watch.latch(is_latched);
            let rates = BendRates::from_slice(&[rate, 0.0]).unwrap();
            watch.commanded(&rates, PERIOD_S, PERIOD_S);
            watch.measured(&robot, &bends(measured, 0.0)).largest_rad()
        };
        for step in 1..=200 {
            turn(1.0, f64::from(step) * PERIOD_S, false);
        }
        for step in 0..2000 {
            let rate = (1.0 - f64::from(step) * 0.2).max(0.0);
            for on_the_way in [0.93, 1.0] {
                assert!(turn(rate, on_the_way, true) < 1e-9);
            }
            let error_rad = turn(0.0, 0.4, true);
            assert!((error_rad - 0.5).abs() < 0.02, "{error_rad} rad");
        }
        // Speeds lead on by the motion of the lag.
        let moved = turn(0.0, 1.5, true);
        let expected_rad = if obeys_positions { 0.48 } else { 0.37 };
        assert!((moved - expected_rad).abs() < 0.02, "{moved} rad");
        watch.begin(bends(1.5, 0.0));
        assert!(watch.measured(&robot, &bends(1.5, 0.0)).largest_rad() < 1e-12);
    }
}

/// Motors that lag complete their motion after the stop: speeds beyond the integral, which has returned to what was
/// measured, positions with a droop beside it. They rest where their commands led them, whatever the error was before,
/// unless it was a fault.
#[test]
fn motors_that_complete_their_motion_rest_where_their_commands_led_them() {
    let robot = robot();
    for (obeys_positions, rate_rad_s, delay, lag_s, droop_rad) in [
        (false, 2.0, 6, 0.1, 0.0),
        (false, 2.0, 12, 0.1, 0.0),
        (false, 1.0, 40, 0.05, 0.0),
        (false, 1.0, 10, 0.2, 0.0),
        (false, -2.0, 6, 0.1, 0.0),
        (true, 2.0, 6, 0.1, 0.0),
        (true, 0.5, 6, 0.1, 0.25),
    ] {
        for stop_s in [0.3, 1.0, 2.0, 4.0] {
            let rules = FollowingRules {
                lag_s: 0.1 + lag_s + f64::from(delay) * PERIOD_S,
                ..RULES
            };
            let mut watch = FollowingWatch::new(rules, obeys_positions, bends(0.0, 0.0));
            let mut queue = std::collections::VecDeque::from(vec![0.0; delay as usize]);
            let (mut goal, mut motor, mut rate) = (0.0, 0.0, 0.0_f64);
            for step in 0..2000 {
                let is_latched = f64::from(step) * PERIOD_S > stop_s;
                watch.latch(is_latched);
                let wanted: f64 = if is_latched { 0.0 } else { rate_rad_s };
                rate += (wanted - rate).clamp(-0.1, 0.1);
                let rates = BendRates::from_slice(&[rate, 0.0]).unwrap();
                watch.commanded(&rates, PERIOD_S, PERIOD_S);
                goal += PERIOD_S * rate;
                queue.push_back(goal);
                motor += PERIOD_S / lag_s * (queue.pop_front().unwrap() - motor);
                watch.measured(&robot, &bends(motor - droop_rad, 0.0));
                assert!(!watch.is_broken());
            }
            let rests_rad = watch.error().largest_rad();
            let case = (obeys_positions, rate_rad_s, delay, lag_s, stop_s);
            assert!(rests_rad < 0.03, "{case:?}: {rests_rad} rad");
        }
    }
}

#[test]
fn the_error_of_the_cables_has_their_sign() {
    let robot = robot();
    let mut watch = FollowingWatch::new(RULES, true, bends(0.0, 0.0));
    let measured = bends(0.2, -0.1);
    let lengths = robot.cable_lengths(&measured);
    let straight = robot.cable_lengths(&Configuration::straight(1));
    let error = *watch.measured(&robot, &measured);
    for cable in 0..3 {
        let longer_m = lengths[cable] - straight[cable];
        assert!((error.cable_m[cable] - longer_m).abs() < 1e-15);
    }
    assert!((error.bend_rad[0] - 0.2_f64.hypot(0.1)).abs() < 1e-15);
    watch.measured_lengths(&robot, &lengths.map(|length_m| length_m + 1e-3));
    for cable in 0..3 {
        let longer_m = lengths[cable] + 1e-3 - straight[cable];
        assert!((watch.error().cable_m[cable] - longer_m).abs() < 1e-15);
    }
    assert!((watch.error().bend_rad[0] - 0.2_f64.hypot(0.1)).abs() < 1e-15);
    watch.begin(measured);
    assert_eq!(
        *watch.measured(&robot, &measured),
        FollowingError::default()
    );
}
