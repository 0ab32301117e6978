mod rest;

use super::*;
use crate::robot::RobotParameters;

fn robot(sections: usize) -> Robot {
    Robot::new(&RobotParameters::paper(sections)).expect("the paper's robot")
}

#[test]
fn age_is_compensated_by_past_commands_not_by_the_present_rates() {
    let robot = robot(1);
    let rates = |u: f64| BendRates::from_slice(&[u, 0.0]).unwrap();
    let mut estimator = Estimator::new(Configuration::straight(1));
    for u in [1.0, 2.0, -3.0] {
        estimator.predict(&rates(u), 0.005);
    }
    // The measurement is 12.5 ms old: after half of the first move.
    let measured = Configuration::from_slice(&[0.1, 0.0]).unwrap();
    let lengths = robot.cable_lengths(&measured);
    let expected = 0.1 + 0.0025 * 1.0 + 0.005 * 2.0 - 0.005 * 3.0;
    for measurement in [
        Measurement::Configuration(measured),
        Measurement::CableLengths(lengths),
    ] {
        let estimate = *estimator.correct(&robot, &measurement, 0.0125);
        assert!(
            (estimate.as_slice()[0] - expected).abs() < 1e-13,
            "{estimate:?}"
        );
    }
}

#[test]
fn a_tip_position_determines_one_section_and_corrects_several() {
    for sections in 1..=3 {
        let robot = robot(sections);
        let values: Vec<f64> = (0..2 * sections).map(|i| 0.4 - 0.1 * i as f64).collect();
        let truth = Configuration::from_slice(&values).unwrap();
        let off: Vec<f64> = values.iter().map(|value| value + 0.02).collect();
        let mut estimator = Estimator::new(Configuration::from_slice(&off).unwrap());
        let rates = BendRates::from_slice(&vec![1.0; 2 * sections]).unwrap();
        estimator.predict(&rates, 0.005);
        // The tip before that move.
        let tip = robot.tip_position(&truth);
        let estimate = *estimator.correct(&robot, &Measurement::TipPosition(tip), 0.005);
        let now = truth.advanced(&rates, 0.005);
        let error = (robot.tip_position(&estimate) - robot.tip_position(&now)).norm();
        // The prior is vague, so the assumed noise has little weight.
        assert!(error < 5e-4, "{error}");
    }
}

/// A position-controlled robot is pushed aside, and only its tip is measured. Kalman filter and smoothing are in series and do not
/// reduce each other's gain.
#[test]
fn the_offset_of_a_tip_is_learnt_within_a_second() {
    for sections in 1..=3 {
        let robot = robot(sections);
        let truth = Configuration::from_slice(&vec![0.31; 2 * sections]).unwrap();
        let begin = Configuration::from_slice(&vec![0.3; 2 * sections]).unwrap();
        let mut estimator = Estimator::new(begin).with_time_constant(0.1);
        // The initial configuration is known.
        let begin_tip = Measurement::TipPosition(robot.tip_position(&begin));
        estimator.correct(&robot, &begin_tip, 0.0);
        let tip = robot.tip_position(&truth);
        let error_m = |estimate: &Configuration| (robot.tip_position(estimate) - tip).norm();
        let begin_m = error_m(&begin);
        let rest = BendRates::zero(sections);
        let mut left = 0.0;
        for _ in 0..200 {
            estimator.predict(&rest, 0.005);
            let estimate = *estimator.correct(&robot, &Measurement::TipPosition(tip), 0.0);
            left = error_m(&estimate) / begin_m;
        }
        assert!(left < 0.05, "{sections} sections: {left} is left");
    }
}

/// Standard normal numbers, the same in every run.
fn noise(state: &mut u64) -> f64 {
    let mut uniform = || {
        *state = state
            .wrapping_mul(0x5851_f42d_4c95_7f2d)
            .wrapping_add(0x1405_7b7e_f767_814f);
        ((*state >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    };
    let radius = (-2.0 * uniform().ln()).sqrt();
    radius * (core::f64::consts::TAU * uniform()).cos()
}

fn noisy(position_m: Vector3<f64>, deviation_m: f64, state: &mut u64) -> Measurement {
    let noise_m = Vector3::from_fn(|_, _| deviation_m * noise(state));
    Measurement::TipPosition(position_m + noise_m)
}

/// A filter that trusted each measurement fully would drift by 1e5 rad here: no bend moves the tip of a straight robot along its axis.
#[test]
fn a_noisy_tip_of_a_straight_robot_does_not_divert_the_estimate() {
    for sections in 1..=6 {
        let robot = robot(sections);
        let truth = Configuration::straight(sections);
        let rest = BendRates::zero(sections);
        let mut estimator = Estimator::new(truth);
        let (mut state, mut farthest_m) = (sections as u64, 0.0_f64);
        let tip = robot.tip_position(&truth);
        for cycle in 0..4000 {
            estimator.predict(&rest, 0.005);
            let measured = noisy(tip, 1e-3, &mut state);
            let estimate = *estimator.correct(&robot, &measured, 0.0);
            let bend = estimate
                .as_slice()
                .iter()
                .fold(0.0_f64, |a, b| a.max(b.abs()));
            assert!(bend < 1.0, "{sections} sections, cycle {cycle}: {bend} rad");
            if cycle > 100 {
                farthest_m = farthest_m.max((robot.tip_position(&estimate) - tip).norm());
            }
        }
        assert!(farthest_m < 3e-3, "{sections} sections: {farthest_m} m");
    }
}

/// A measurement moves the estimate more if the sensor is better.
#[test]
fn a_tip_is_weighted_by_its_noise() {
    let robot = robot(1);
    let truth = Configuration::from_slice(&[0.31, 0.3]).unwrap();
    let begin = Configuration::from_slice(&[0.3, 0.3]).unwrap();
    let left = |noise_m: f64| {
        let mut estimator = Estimator::new(begin).with_tip_noise(noise_m);
        let tip = Measurement::TipPosition(robot.tip_position(&truth));
        let estimate = *estimator.correct(&robot, &tip, 0.0);
        (truth.as_slice()[0] - estimate.as_slice()[0]) / 0.01
    };
    // The prior is 0.01 rad; at 0.15 m from the base, a radian moves the tip by 0.15 m.
    assert!(
        left(1e-5) < 1e-3 && left(1e-1) > 0.99,
        "{} {}",
        left(1e-5),
        left(1e-1)
    );
    assert!((0.3..0.7).contains(&left(1.5e-3)), "{}", left(1.5e-3));
}

#[test]
fn the_filter_averages_the_noise_of_a_tip_that_moves_as_commanded() {
    for sections in 1..=3 {
        let robot = robot(sections);
        let mut truth = Configuration::from_slice(&vec![0.3; 2 * sections]).unwrap();
        let mut estimator = Estimator::new(Configuration::straight(sections));
        let mut state = 7 + sections as u64;
        let mut squares = 0.0;
        for cycle in 0..4000 {
            let turn = f64::from(cycle) * 0.005;
            let rates: Vec<_> = (0..2 * sections)
                .map(|i| 0.4 * (turn * (1.0 + 0.3 * i as f64) + i as f64).sin())
                .collect();
            let rates = BendRates::from_slice(&rates).unwrap();
            truth = truth.advanced(&rates, 0.005);
            estimator.predict(&rates, 0.005);
            let tip = robot.tip_position(&truth);
            let measured = noisy(tip, 3e-4, &mut state);
            let estimate = *estimator.correct(&robot, &measured, 0.0);
            if cycle >= 1000 {
                squares += (robot.tip_position(&estimate) - tip).norm_squared();
            }
        }
        let deviation_m = (squares / 3000.0).sqrt();
        // The noise of the measurements themselves is √3 · 0.3 mm.
        assert!(deviation_m < 3e-4, "{sections} sections: {deviation_m} m");
    }
}

/// The margin is the offset plus the uncertainty that noise leaves. The tip exceeds it along an axis only rarely, and the margin is
/// smaller for less noise.
#[test]
fn margin_is_the_offset_plus_its_uncertainty() {
    let robot = robot(3);
    let at = Configuration::from_slice(&[0.3; 6]).unwrap();
    let truth_m = Vector3::new(0.01, -0.02, 0.005);
    let tip_m = robot.tip_position(&at) + truth_m;
    let lengths = Measurement::CableLengths(robot.cable_lengths(&at));
    let [more_m, less_m] = [3e-4, 1e-4].map(|noise_m| {
        let estimator = Estimator::new(at).with_time_constant(0.1);
        let mut estimator = estimator.with_tip_noise(noise_m);
        assert_eq!(estimator.tip_margin_m(), 0.0);
        let (mut state, mut beyond, mut open_m) = (7, 0, 0.0);
        for cycle in 0..2200 {
            estimator.predict(&BendRates::zero(3), 0.005);
            estimator.correct(&robot, &lengths, 0.0);
            let seen_m = tip_m.map(|m| m + noise_m * noise(&mut state));
            assert_eq!(estimator.correct_tip(&robot, &seen_m, 0.0), Ok(()));
            let offset_m = estimator.tip_offset_m();
            open_m = estimator.tip_margin_m() - offset_m.norm();
            let off_m = offset_m - truth_m;
            if cycle >= 200 {
                beyond += off_m.iter().filter(|m| m.abs() > open_m).count();
            }
        }
        println!("{noise_m} m: {open_m} m, {beyond} of 6000 beyond");
        assert!(beyond < 30 && open_m < 1.5 * noise_m, "{beyond}, {open_m}");
        open_m
    });
    assert!(less_m < 0.7 * more_m, "{less_m} {more_m}");
}
