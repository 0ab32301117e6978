//! Motors that rested.

use super::*;

const PERIOD_S: f64 = 0.005;
const RATE_RAD_S: f64 = 2.0;
/// 30 ms of rest, until 20 ms ago.
const RESTED_S: Range<f64> = 0.02..0.05;

/// Motors without delay after constant rates, and where they are led if they lost this part of them.
fn moving(lost: f64) -> (Estimator, Measurement) {
    let mut estimator = Estimator::new(Configuration::straight(1)).with_time_constant(0.18);
    let rates = BendRates::from_slice(&[RATE_RAD_S, 0.0]).unwrap();
    for cycle in 0..100 {
        estimator.predict(&rates, PERIOD_S);
        if cycle < 99 {
            let obeyed = Measurement::Configuration(*estimator.motors());
            estimator.correct(&robot(1), &obeyed, 0.0);
        }
    }
    let lost_s = lost * (RESTED_S.end - RESTED_S.start);
    let at = estimator.motors().advanced(&rates, -lost_s);
    (estimator, Measurement::Configuration(at))
}

/// What the estimate loses, as a share of the motion in that rest.
fn loses(lost: f64, ages_s: &Range<f64>, was_silent: bool) -> f64 {
    let (mut estimator, measured) = moving(lost);
    let led_rad = |estimator: &Estimator| estimator.motors().as_slice()[0];
    let before_rad = led_rad(&estimator);
    estimator.rested(&robot(1), &measured, 0.0, ages_s, was_silent);
    let motion_rad = RATE_RAD_S * (RESTED_S.end - RESTED_S.start);
    (before_rad - led_rad(&estimator)) / motion_rad
}

#[test]
fn a_stated_rest_is_lost_where_a_measurement_shows_it() {
    let is = |share: f64, expected: f64| (share - expected).abs() < 1e-9;
    assert!(is(loses(1.0, &RESTED_S, false), 1.0));
    // Not quite there, by noise.
    assert!(is(loses(0.85, &RESTED_S, false), 1.0));
    // Obeyed, or something between: only a silence makes this a rest.
    assert!(is(loses(0.0, &RESTED_S, false), 0.0));
    assert!(is(loses(0.6, &RESTED_S, false), 0.0));
    assert!(is(loses(0.6, &RESTED_S, true), 1.0));
    assert!(is(loses(0.4, &RESTED_S, true), 0.0));
    // Much longer than the motors rested.
    assert!(is(loses(1.0, &(0.0..1e9), false), 0.0));
}

#[test]
fn a_stated_rest_that_noise_hides_is_not_lost() {
    // 0.006 rad.
    let short_s = 0.02..0.023;
    assert!(loses(0.1, &short_s, false).abs() < 1e-9);
    assert!((loses(0.1, &short_s, true) - 0.1).abs() < 1e-9);
}
