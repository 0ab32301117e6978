//! Motors that rested.

use core::ops::Range;
use core::slice::from_ref;

use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::*;
use crate::estimator::actuator::added;
use crate::estimator::rest::{SHOWN, UNSEEN_RAD};
use RestCause::{GoesOn, Silence, Stated};

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
fn loses(lost: f64, ages_s: &Range<f64>, cause: RestCause) -> f64 {
    let (mut estimator, measured) = moving(lost);
    let led_rad = |estimator: &Estimator| estimator.motors().as_slice()[0];
    let before_rad = led_rad(&estimator);
    estimator.rested(&robot(1), &measured, 0.0, from_ref(ages_s), cause);
    let motion_rad = RATE_RAD_S * (RESTED_S.end - RESTED_S.start);
    (before_rad - led_rad(&estimator)) / motion_rad
}

#[test]
fn a_stated_rest_is_lost_where_a_measurement_shows_it() {
    let is = |share: f64, expected: f64| (share - expected).abs() < 1e-9;
    assert!(is(loses(1.0, &RESTED_S, Stated), 1.0));
    // Not quite there, by noise.
    assert!(is(loses(0.85, &RESTED_S, Stated), 1.0));
    // Obeyed, or something between: only a silence makes this a rest.
    assert!(is(loses(0.0, &RESTED_S, Stated), 0.0));
    assert!(is(loses(0.6, &RESTED_S, Stated), 0.0));
    assert!(is(loses(0.6, &RESTED_S, Silence), 1.0));
    assert!(is(loses(0.4, &RESTED_S, Silence), 0.0));
    // Much longer than the motors rested.
    assert!(is(loses(1.0, &(0.0..1e9), Stated), 0.0));
}

#[test]
fn a_stated_rest_that_noise_hides_is_not_lost() {
    // 0.006 rad.
    let short_s = 0.02..0.023;
    assert!(loses(0.1, &short_s, Stated).abs() < 1e-9);
    assert!((loses(0.1, &short_s, Silence) - 0.1).abs() < 1e-9);
}

/// Each of 0.006 rad, one after the other before a measurement could show the first.
#[test]
fn stated_rests_that_noise_hides_are_lost_where_a_measurement_shows_all_of_them() {
    let rests_s = [0.02..0.023, 0.04..0.043];
    let (mut estimator, measured) = moving(0.2);
    let led_rad = estimator.motors().as_slice()[0];
    for alone_s in &rests_s {
        assert!(!estimator.rested(&robot(1), &measured, 0.0, from_ref(alone_s), Stated));
    }
    assert!(estimator.rested(&robot(1), &measured, 0.0, &rests_s, Stated));
    let lost_rad = led_rad - estimator.motors().as_slice()[0];
    assert!((lost_rad - 0.012).abs() < 1e-9, "{lost_rad}");
}

#[test]
fn a_stated_rest_that_noise_hides_is_lost_where_the_average_shows_it() {
    const LOST_RAD: f64 = 0.006;
    let rates = BendRates::from_slice(&[RATE_RAD_S, 0.0]).unwrap();
    for (seen_rad, is_lost) in [(LOST_RAD, true), (0.2 * LOST_RAD, false)] {
        let mut estimator = moving(0.0).0;
        let mut lost = [false; 2];
        for cycle in 0..14 {
            let at = estimator.motors().advanced(&rates, -seen_rad / RATE_RAD_S);
            let measured = Measurement::Configuration(at);
            let ago_s = 0.02 + PERIOD_S * f64::from(cycle);
            let ages_s = ago_s..ago_s + LOST_RAD / RATE_RAD_S;
            let is_first = usize::from(cycle > 0);
            lost[is_first] |= estimator.rested(&robot(1), &measured, 0.0, &[ages_s], Stated);
            estimator.correct(&robot(1), &measured, 0.0);
            estimator.predict(&rates, PERIOD_S);
        }
        assert_eq!(lost, [false, is_lost], "{seen_rad} rad");
    }
}

/// A contact is found by what the measurements show beside the estimate.
#[test]
fn a_push_is_seen_while_the_average_shows_rests() {
    const PUSH_RAD: f64 = 0.05;
    let rates = BendRates::from_slice(&[RATE_RAD_S, 0.0]).unwrap();
    // The largest part of a push in the second bend that is seen, while 6 mrad of each 60 ms are lost in the first one.
    let seen_rad = |is_stated: bool| {
        let mut estimator = Estimator::new(Configuration::straight(1)).with_time_constant(0.18);
        let (mut at_rad, mut rest_ended, mut lost, mut seen_rad) = (0.0, None, 0, 0.0_f64);
        for cycle in 1..=200 {
            estimator.predict(&rates, PERIOD_S);
            at_rad += RATE_RAD_S * PERIOD_S;
            if cycle % 12 == 0 {
                at_rad -= 0.006;
                rest_ended = is_stated.then_some(cycle);
            }
            let push_rad = if cycle > 105 { PUSH_RAD } else { 0.0 };
            let place = Configuration::from_slice(&[at_rad, push_rad]).unwrap();
            let measured = Measurement::Configuration(place);
            if let Some(ended) = rest_ended {
                let ago_s = PERIOD_S * f64::from(cycle - ended);
                if estimator.rested(&robot(1), &measured, 0.0, &[ago_s..ago_s + 0.003], Stated) {
                    (rest_ended, lost) = (None, lost + 1);
                }
            }
            estimator.correct(&robot(1), &measured, 0.0);
            seen_rad = seen_rad.max(estimator.measured_beside().as_slice()[1]);
        }
        (lost, seen_rad)
    };
    let [(none, unstated_rad), (some, stated_rad)] = [false, true].map(seen_rad);
    assert!(none == 0 && some > 8, "{none} {some}");
    assert!(
        (stated_rad - unstated_rad).abs() < 1e-3,
        "{stated_rad} {unstated_rad}"
    );
}

#[test]
fn a_stated_rest_of_which_much_more_is_under_way_than_seen_is_left_to_a_later_statement() {
    let lost_s = |age_s: f64, seen_s: f64| {
        let mut estimator = moving(0.0).0;
        let rates = BendRates::from_slice(&[RATE_RAD_S, 0.0]).unwrap();
        let led = *estimator.motors();
        let measured = Measurement::Configuration(led.advanced(&rates, -age_s - seen_s));
        estimator.rested(&robot(1), &measured, age_s, &[0.0..age_s + seen_s], Stated);
        (led.as_slice()[0] - estimator.motors().as_slice()[0]) / RATE_RAD_S
    };
    assert!((lost_s(0.03, 0.02) - 0.05).abs() < 1e-9);
    assert_eq!(lost_s(0.1, 0.02), 0.0);
    assert!((lost_s(0.1, 0.11) - 0.21).abs() < 1e-9);
}

/// A machine that stalls would show the noise of single measurements as motion of the tip.
#[test]
fn a_silence_leaves_the_filters_on_where_nothing_was_commanded() {
    for (rate_rad_s, moves) in [(0.0, false), (0.1, true)] {
        let mut estimator = Estimator::new(Configuration::straight(1)).with_time_constant(0.18);
        let rates = BendRates::from_slice(&[rate_rad_s, 0.0]).unwrap();
        for _ in 0..100 {
            estimator.predict(&rates, PERIOD_S);
            let measured = Measurement::Configuration(*estimator.motors());
            estimator.correct(&robot(1), &measured, 0.0);
        }
        let led_rad = estimator.motors().as_slice()[0];
        let noisy = Configuration::from_slice(&[led_rad - 0.003, 0.0]).unwrap();
        let measured = Measurement::Configuration(noisy);
        estimator.predict(&BendRates::zero(1), PERIOD_S);
        estimator.rested(&robot(1), &measured, 0.0, &[0.0..0.03], Silence);
        estimator.correct(&robot(1), &measured, 0.0);
        let moved_rad = led_rad - estimator.motors().as_slice()[0];
        assert_eq!(moved_rad > 0.002, moves, "{moved_rad} rad");
    }
}

/// An error of the estimate from before the rest, in another direction.
#[test]
fn a_stated_rest_is_lost_where_the_estimate_was_beside_the_robot_before() {
    let (mut estimator, _) = moving(1.0);
    let led = estimator.motors().as_slice()[0];
    let place = Configuration::from_slice(&[led - 0.06, 0.04]).unwrap();
    let measured = Measurement::Configuration(place);
    assert!(estimator.rested(&robot(1), &measured, 0.0, &[RESTED_S], Stated));
}

/// A driver states a rest while it lasts. The parts end between releases.
#[test]
fn a_rest_that_is_lost_in_parts_is_lost_as_a_whole() {
    let (mut estimator, measured) = moving(1.0);
    let mut parts = [moving(1.0).0, moving(1.0).0];
    for (estimator, ends_s) in parts.iter_mut().zip([[0.048, 0.036], [0.043, 0.041]]) {
        for ages_s in [ends_s[0]..0.05, ends_s[1]..ends_s[0], 0.02..ends_s[1]] {
            estimator.rested(&robot(1), &measured, 0.0, &[ages_s], Silence);
        }
    }
    estimator.rested(&robot(1), &measured, 0.0, &[RESTED_S], Silence);
    for part in parts {
        assert!(part.motors().distance_rad(estimator.motors()) < 1e-12);
        let [one, other] = [&part, &estimator].map(|it| it.motors.remaining_motion(0.04));
        let [one, other] = [one, other].map(|motion| motion.end_from(&Configuration::straight(1)));
        assert!(one.distance_rad(&other) < 1e-12);
    }
}

/// No measurement shows yet that the rest went on: as far as motion under way may be taken unseen, and not against what is measured.
#[test]
fn a_rest_that_was_shown_goes_on_as_stated_up_to_a_bounded_motion() {
    const AGE_S: f64 = 0.03;
    let mut estimator = moving(0.0).0;
    let rates = BendRates::from_slice(&[RATE_RAD_S, 0.0]).unwrap();
    let at = |estimator: &Estimator, ago_s: f64| {
        Measurement::Configuration(estimator.motors().advanced(&rates, -ago_s))
    };
    let measured = at(&estimator, 0.06);
    let rests = |estimator: &mut Estimator, age_s, ages_s: Range<f64>, cause| {
        let is_lost = estimator.rested(&robot(1), &measured, age_s, &[ages_s], cause);
        estimator.correct(&robot(1), &measured, age_s);
        is_lost
    };
    assert!(rests(&mut estimator, AGE_S, AGE_S..0.06, Stated));
    let obeyed = at(&estimator, 0.0);
    let new_s = 0.0..AGE_S;
    assert!(
        !estimator.rested(&robot(1), &obeyed, 0.0, from_ref(&new_s), GoesOn),
        "it is contradicted"
    );
    assert!(
        rests(&mut estimator, AGE_S, new_s.clone(), GoesOn),
        "0.06 rad"
    );
    for _ in 0..6 {
        estimator.predict(&rates, PERIOD_S);
    }
    assert!(!rests(&mut estimator, AGE_S, new_s, GoesOn), "0.12 rad");
}

/// A driver states its last rest without end, at a speed at which no part of a period is seen, and its motors obey.
#[test]
fn a_rest_that_is_stated_without_end_leaves_the_filters_on() {
    const SLOW_RAD_S: f64 = 0.3;
    const NOISE_RAD: f64 = 3e-3;
    let rates = BendRates::from_slice(&[SLOW_RAD_S, 0.0]).unwrap();
    let mut estimator = Estimator::new(Configuration::straight(1)).with_time_constant(0.18);
    let robot = robot(1);
    let mut at = [0.0; 3];
    let mut largest_jump_rad = 0.0_f64;
    for cycle in 1..=400 {
        estimator.predict(&rates, PERIOD_S);
        let truth_rad = SLOW_RAD_S * PERIOD_S * f64::from(cycle);
        let noise_rad = NOISE_RAD * if cycle % 2 == 0 { 1.0 } else { -1.0 };
        let place = Configuration::from_slice(&[truth_rad + noise_rad, 0.0]).unwrap();
        let measured = Measurement::Configuration(place);
        estimator.rested(&robot, &measured, 0.0, &[0.0..PERIOD_S], GoesOn);
        estimator.correct(&robot, &measured, 0.0);
        at = [at[1], at[2], estimator.motors().as_slice()[0]];
        if cycle > 3 {
            largest_jump_rad = largest_jump_rad.max((at[2] - 2.0 * at[1] + at[0]).abs());
        }
        let behind_rad = truth_rad - at[2];
        assert!(behind_rad < UNSEEN_RAD + NOISE_RAD, "{behind_rad} rad");
    }
    // Of the noise alone, unfiltered: four times as much.
    assert!(largest_jump_rad < NOISE_RAD, "{largest_jump_rad} rad");
}

/// Motors behind a driver, in steps of a millisecond.
struct Motors {
    actuator: Actuator,
    scale: f64,
    /// Commanded positions, and where the motors were \[rad\].
    commanded_rad: Vec<f64>,
    place_rad: Vec<f64>,
}

impl Motors {
    fn delayed_rad(places_rad: &[f64], ago_ms: usize) -> f64 {
        places_rad[places_rad.len().saturating_sub(ago_ms + 1)]
    }

    /// One period at this rate.
    fn go(&mut self, rate_rad_s: f64) {
        let lags_ms = self.actuator.time_constant_s * 1e3;
        let delay_ms = (self.actuator.delay_s * 1e3).round() as usize;
        for _ in 0..5 {
            let next_rad =
                Self::delayed_rad(&self.commanded_rad, 0) + self.scale * rate_rad_s * 1e-3;
            self.commanded_rad.push(next_rad);
            let (to_rad, at_rad) = (
                Self::delayed_rad(&self.commanded_rad, delay_ms),
                Self::delayed_rad(&self.place_rad, 0),
            );
            self.place_rad
                .push(to_rad + (at_rad - to_rad) * (-1.0 / lags_ms).exp());
        }
    }
}

/// By how much false statements may lead the estimate away: docs/model.md.
const FARTHER_RAD: f64 = 0.12;

/// What a driver states in this period, as ages \[s\], the newest rest first: more than one count together.
type Statement = fn(usize) -> Vec<Range<f64>>;

/// Four rests of this duration, with this time from the beginning of one to that of the next \[s\].
fn four(lasts_s: f64, every_s: f64) -> Vec<Range<f64>> {
    let begins_s = (0..4).map(|number| every_s * f64::from(number));
    begins_s.map(|from_s| from_s..from_s + lasts_s).collect()
}

const FALSE: [(&str, Statement); 12] = [
    ("a period", |_| vec![0.0..PERIOD_S]),
    ("30 ms", |_| vec![0.0..0.03]),
    ("30 ms or nothing", |cycle| {
        vec![0.0..0.03; usize::from(cycle % 2 == 0)]
    }),
    ("150 ms or nothing", |cycle| {
        vec![0.0..0.15; usize::from(cycle % 2 == 0)]
    }),
    ("since the beginning", |cycle| {
        vec![0.0..cycle as f64 * PERIOD_S]
    }),
    ("within the delay", |_| vec![0.0..0.01]),
    ("long ago", |_| vec![0.1..0.15]),
    ("four of 2 ms", |_| four(2e-3, 0.01)),
    ("four periods", |_| four(PERIOD_S, 0.02)),
    ("four of 10 ms", |_| four(0.01, 0.08)),
    ("four of 30 ms", |_| four(0.03, 0.04)),
    ("four of 30 ms or nothing", |cycle| {
        if cycle % 2 == 0 {
            four(0.03, 0.06)
        } else {
            Vec::new()
        }
    }),
];

/// How much farther the estimate is from the true bends at any release, at most, with these false statements than without \[rad\]. The motors
/// have this delay, lag and scale, another delay and 20 ms of lag are configured, and they may lose the last of 24 commands each.
fn farther_rad(
    (configured_s, delay_s, time_constant_s, scale): (f64, f64, f64, f64),
    hertz: f64,
    lost_of_24: usize,
    stated: Statement,
) -> f64 {
    const AGE_MS: usize = 4;
    let robot = robot(1);
    let configured = Actuator {
        delay_s: configured_s,
        time_constant_s: 0.02,
        play_m: 0.0,
    };
    let mut motors = Motors {
        actuator: Actuator {
            delay_s,
            time_constant_s,
            play_m: 0.0,
        },
        scale,
        commanded_rad: vec![0.0],
        place_rad: vec![0.0],
    };
    let mut estimators = [(); 2].map(|()| {
        let estimator = Estimator::new(Configuration::straight(1)).with_time_constant(0.18);
        estimator.with_actuator(&robot, configured)
    });
    let (mut state, mut farther_rad) = (7, 0.0_f64);
    for cycle in 0..1000 {
        let noise_rad = 1e-3 * noise(&mut state);
        let bends = [
            Motors::delayed_rad(&motors.place_rad, AGE_MS) + noise_rad,
            0.0,
        ];
        let measured = Measurement::Configuration(Configuration::from_slice(&bends).unwrap());
        let age_s = AGE_MS as f64 * 1e-3;
        estimators[1].rested(&robot, &measured, age_s, &stated(cycle), Stated);
        let truth_rad = Motors::delayed_rad(&motors.place_rad, 0);
        let turn_s = cycle as f64 * PERIOD_S;
        let rate_rad_s = RATE_RAD_S * (core::f64::consts::TAU * hertz * turn_s).sin();
        let errors_rad = estimators.each_mut().map(|estimator| {
            estimator.correct(&robot, &measured, age_s);
            let error_rad = estimator.present().as_slice()[0] - truth_rad;
            estimator.predict(
                &BendRates::from_slice(&[rate_rad_s, 0.0]).unwrap(),
                PERIOD_S,
            );
            error_rad.abs()
        });
        farther_rad = farther_rad.max(errors_rad[1] - errors_rad[0]);
        let is_lost = cycle % 24 >= 24 - lost_of_24;
        motors.go(if is_lost { 0.0 } else { rate_rad_s });
    }
    farther_rad
}

#[test]
fn false_statements_lead_the_estimate_away_by_a_bounded_distance() {
    let mut farthest_rad = 0.0_f64;
    for motors in [
        (0.01, 0.01, 0.02, 1.0),
        (0.01, 0.01, 0.02, 0.85),
        (0.01, 0.03, 0.1, 1.0),
        (0.01, 0.03, 0.1, 0.85),
        (0.1, 0.1, 0.02, 1.0),
        (0.1, 0.1, 0.02, 0.85),
    ] {
        for (name, stated) in FALSE {
            let mut most = 0.0_f64;
            for hertz in [0.25, 0.5, 1.0, 2.0] {
                for lost in [0, 6] {
                    most = most.max(farther_rad(motors, hertz, lost, stated));
                }
            }
            println!("{motors:?}, {name}: {most} rad farther");
            farthest_rad = farthest_rad.max(most);
        }
    }
    assert!(farthest_rad < FARTHER_RAD, "{farthest_rad} rad");
}

/// The bound of docs/model.md, which follows from what a measurement has to show, for any number of rests: the motion seen is at most the distance of
/// the measurement divided by the least share, and no more is under way than seen, or 0.1 rad.
#[test]
fn rests_lose_no_more_than_a_measurement_shows_of_them() {
    let robot = robot(1);
    let mut dice = Xoshiro256PlusPlus::seed_from_u64(3);
    let mut losses = [0; 5];
    for _ in 0..4000 {
        let actuator = Actuator {
            delay_s: dice.random_range(0.0..0.1),
            time_constant_s: dice.random_range(0.0..0.1),
            play_m: 0.0,
        };
        let estimator = Estimator::new(Configuration::straight(1)).with_time_constant(0.18);
        let mut estimator = estimator.with_actuator(&robot, actuator);
        for _ in 0..12 {
            let rates = [(); 2].map(|()| dice.random_range(-RATE_RAD_S..RATE_RAD_S));
            for _ in 0..10 {
                estimator.predict(&BendRates::from_slice(&rates).unwrap(), PERIOD_S);
            }
        }
        let (count, age_s) = (dice.random_range(1..5), dice.random_range(0.0..0.02));
        let mut ago_s = 0.0;
        let rests_s: Vec<_> = (0..count)
            .map(|_| {
                let from_s = ago_s + dice.random_range(0.0..0.06);
                ago_s = from_s + dice.random_range(0.001..0.06);
                from_s..ago_s
            })
            .collect();
        let led = *estimator.motors();
        let obeyed = estimator.motors.remaining_motion(age_s).start_from(&led);
        let (mut motors, mut rested) = (estimator.motors.clone(), led);
        for ages_s in &rests_s {
            rested = added(&rested, &motors.rested(ages_s), -1.0);
        }
        let rested = motors.remaining_motion(age_s).start_from(&rested);
        let way = added(&rested, obeyed.as_slice(), -1.0);
        let aside_rad = [(); 2].map(|()| dice.random_range(-0.02..0.02));
        let measured = added(&obeyed, way.as_slice(), dice.random_range(-0.5..2.0));
        let measured = added(&measured, &aside_rad, 1.0);
        let shown_rad = measured.distance_rad(&obeyed) / SHOWN.start;
        let measured = Measurement::Configuration(measured);
        if estimator.rested(&robot, &measured, age_s, &rests_s, Stated) {
            let lost_rad = led.distance_rad(estimator.motors());
            let most_rad = shown_rad + shown_rad.max(UNSEEN_RAD);
            assert!(lost_rad < most_rad + 1e-9, "{lost_rad} of {most_rad} rad");
            losses[count] += 1;
        }
    }
    assert!(losses[1..].iter().all(|lost| *lost > 20), "{losses:?}");
}
