//! Measurements that jump, wander off or stand still, and noise, late ones and fast robots that do none of it.

use nalgebra::Vector3;

use super::*;
use crate::robot::{Configuration, RobotParameters};

const MS: u64 = 1_000_000;
const RULES: PlausibilityRules = PlausibilityRules {
    jump_rad: 0.1,
    jump_limit: 3,
    frozen_rad: 0.05,
};

fn robot() -> Robot {
    Robot::new(&RobotParameters::paper(2)).unwrap()
}

fn bends(u: f64) -> Configuration {
    Configuration::from_slice(&[0.3, 0.0, u, -0.2]).unwrap()
}

fn measured(u: f64) -> Measurement {
    Measurement::Configuration(bends(u))
}

#[test]
fn what_the_rates_can_do_is_no_jump_and_more_is() {
    let (robot, mut watch) = (robot(), MeasurementWatch::new(RULES));
    // 2 rad/s for 10 ms and the tolerance of 0.1 rad.
    assert_eq!(watch.check(&robot, &measured(0.0), 0), Plausibility::Good);
    assert_eq!(
        watch.check(&robot, &measured(0.119), 10 * MS),
        Plausibility::Good
    );
    // The tolerance is not granted anew: 20 ms are 0.04 rad.
    assert_eq!(
        watch.check(&robot, &measured(0.141), 20 * MS),
        Plausibility::Jump
    );
    // Left out: the next one is compared with what was good.
    assert_eq!(
        watch.check(&robot, &measured(0.159), 30 * MS),
        Plausibility::Good
    );
    assert_eq!(
        watch.check(&robot, &measured(f64::NAN), 40 * MS),
        Plausibility::Jump
    );
}

#[test]
fn a_series_of_jumps_is_a_fault_and_then_the_next_measurement_is_believed() {
    let (robot, mut watch) = (robot(), MeasurementWatch::new(RULES));
    watch.check(&robot, &measured(0.0), 0);
    let found = [1, 2, 3, 4, 5].map(|ms| watch.check(&robot, &measured(1.0), ms * MS));
    let expected = [
        Plausibility::Jump,
        Plausibility::Jump,
        Plausibility::Lost,
        Plausibility::Good,
        Plausibility::Good,
    ];
    assert_eq!(found, expected);
    // Back again is a jump like any other.
    assert_eq!(
        watch.check(&robot, &measured(0.0), 6 * MS),
        Plausibility::Jump
    );
}

#[test]
fn an_odd_one_now_and_then_is_no_series() {
    let (robot, mut watch) = (robot(), MeasurementWatch::new(RULES));
    for ms in 0..100 {
        let odd = ms % 3 > 0;
        let found = watch.check(&robot, &measured(f64::from(u8::from(odd))), ms * MS);
        let expected = if odd {
            Plausibility::Jump
        } else {
            Plausibility::Good
        };
        assert_eq!(found, expected, "{ms}");
    }
}

/// Numbers from -1 to 1 without a pattern, the same in each run.
fn noise() -> impl FnMut() -> f64 {
    let mut state = 1_u64;
    move || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 32) as f64 / f64::from(1_u32 << 31) - 1.0
    }
}

/// The rules that a daemon has unless configured.
fn usual() -> MeasurementWatch {
    MeasurementWatch::new(PlausibilityRules {
        jump_rad: 0.2,
        jump_limit: 3,
        frozen_rad: 0.2,
    })
}

#[test]
fn noise_never_jumps_whether_the_robot_rests_or_moves_as_fast_as_it_can() {
    let (robot, mut noise) = (robot(), noise());
    for rate_rad_s in [0.0, 2.0] {
        let (mut watch, mut u, mut rate) = (usual(), 0.0, rate_rad_s);
        for cycle in 0..20_000 {
            u += rate * 5e-3;
            if f64::abs(u) > 2.0 {
                rate = -rate;
            }
            let found = watch.check(&robot, &measured(u + 0.05 * noise()), cycle * 5 * MS);
            assert_eq!(found, Plausibility::Good, "{cycle}");
        }
        // The worst noise: from one end to the other each time.
        for cycle in 20_000..21_000 {
            u += rate * 5e-3;
            let end = if cycle % 2 == 0 { 0.05 } else { -0.05 };
            let found = watch.check(&robot, &measured(u + end), cycle * 5 * MS);
            assert_eq!(found, Plausibility::Good, "{cycle}");
        }
    }
}

#[test]
fn a_ramp_faster_than_the_robot_is_noticed_before_it_is_ahead_by_more_than_the_tolerance() {
    let robot = robot();
    // What is measured often, seldom, late and irregularly.
    let stamps_ms: [fn(u64) -> u64; 4] = [
        |i| 5 * i,
        |i| 40 * i,
        |i| i,
        |i| 5 * i + [0, 4, 1, 30][i as usize % 4],
    ];
    for stamp_ms in stamps_ms {
        for rate_rad_s in [3.0, 6.0, 42.0, -3.0] {
            let (mut watch, mut ahead_rad, mut last_ms) = (usual(), 0.0, 0);
            let mut stamps: Vec<u64> = (0..500).map(stamp_ms).collect();
            stamps.sort_unstable();
            let noticed = stamps.into_iter().find(|&ms| {
                let s = ms as f64 * 1e-3;
                let found = watch.check(&robot, &measured(rate_rad_s * s), ms * MS);
                if found == Plausibility::Good {
                    ahead_rad = (f64::abs(rate_rad_s) - 2.0) * s;
                    last_ms = ms;
                }
                found == Plausibility::Lost
            });
            assert!(ahead_rad <= 0.2 + 1e-9, "{rate_rad_s}: {ahead_rad}");
            assert!(noticed.is_some(), "{rate_rad_s} after {last_ms} ms");
        }
    }
}

#[test]
fn late_and_irregular_measurements_of_a_robot_at_its_largest_rate_are_good() {
    let (robot, mut watch, mut noise) = (robot(), usual(), noise());
    let mut ms = 0;
    while ms < 60_000 {
        let u = (ms as f64 * 1e-3 * 2.0).rem_euclid(8.0);
        let triangle = if u < 4.0 { u - 2.0 } else { 6.0 - u };
        let found = watch.check(&robot, &measured(triangle), ms * MS);
        assert_eq!(found, Plausibility::Good, "{ms}");
        ms += 1 + (noise().abs().powi(4) * 400.0) as u64;
    }
}

#[test]
fn a_step_is_noticed_at_once_in_every_component() {
    let robot = robot();
    for k in 0..4 {
        let mut watch = usual();
        let mut stepped = bends(0.0);
        watch.check(&robot, &Measurement::Configuration(stepped), 0);
        stepped.as_mut_slice()[k] += 0.25;
        let found = watch.check(&robot, &Measurement::Configuration(stepped), 5 * MS);
        assert_eq!(found, Plausibility::Jump, "{k}");
    }
}

fn cables(robot: &Robot, bends: &Configuration) -> [f64; CABLES_MAX] {
    robot.cable_lengths(bends)
}

#[test]
fn cables_are_compared_with_bends_and_the_tip_with_itself() {
    let (robot, mut watch) = (robot(), MeasurementWatch::new(RULES));
    watch.check(&robot, &measured(0.0), 0);
    let cables = |u| Measurement::CableLengths(cables(&robot, &bends(u)));
    assert_eq!(watch.check(&robot, &cables(0.05), MS), Plausibility::Good);
    assert_eq!(
        watch.check(&robot, &cables(0.5), 2 * MS),
        Plausibility::Jump
    );
    let tip = |u| Measurement::TipPosition(robot.tip_position(&bends(u)));
    assert_eq!(watch.check(&robot, &tip(0.05), 3 * MS), Plausibility::Good);
    assert_eq!(watch.check(&robot, &tip(0.06), 4 * MS), Plausibility::Good);
    let far = Measurement::TipPosition(Vector3::new(0.5, 0.0, 0.0));
    assert_eq!(watch.check(&robot, &far, 5 * MS), Plausibility::Jump);
}

#[test]
fn a_tip_may_step_by_what_one_jump_at_the_base_makes_and_no_farther() {
    let robot = robot();
    let step = |step_m: f64| {
        let mut watch = usual();
        let tip_m = robot.tip_position(&bends(0.0));
        watch.check(&robot, &Measurement::TipPosition(tip_m), 0);
        let stepped = Measurement::TipPosition(tip_m + Vector3::new(0.0, step_m, 0.0));
        watch.check(&robot, &stepped, 1)
    };
    let jump_m = 0.2 * robot.sections().iter().map(|s| s.length_m).sum::<f64>();
    assert_eq!(step(jump_m * 0.999), Plausibility::Good);
    assert_eq!(step(jump_m * 1.001), Plausibility::Jump);
}

#[test]
fn a_tip_of_a_robot_at_its_largest_rates_is_good() {
    let (robot, mut watch) = (robot(), usual());
    for ms in 0..2000 {
        let bend = 2.0 * (ms as f64 * 1e-3) - 2.0;
        let tip_m =
            robot.tip_position(&Configuration::from_slice(&[bend, -bend, bend, bend]).unwrap());
        let found = watch.check(&robot, &Measurement::TipPosition(tip_m), ms * MS);
        assert_eq!(found, Plausibility::Good, "{ms}");
    }
}

#[test]
fn corrections_that_cancel_out_freeze_nothing() {
    let (robot, mut watch) = (robot(), MeasurementWatch::new(RULES));
    for cycle in 0..2000 {
        let rate = if cycle % 2 == 0 { 2.0 } else { -2.0 };
        let rates = BendRates::from_slice(&[rate, -rate, rate, 0.0]).unwrap();
        watch.commanded(&rates, 5e-3);
        let found = watch.check(&robot, &measured(0.2), cycle * 5 * MS);
        assert_eq!(found, Plausibility::Good, "{cycle}");
    }
    // Ways of different components are not added up: 0.039 rad each, and 0.01 left.
    let each = BendRates::from_slice(&[1.0, 1.0, -1.0, 1.0]).unwrap();
    watch.commanded(&each, 0.039);
    assert_eq!(
        watch.check(&robot, &measured(0.2), 10_001 * MS),
        Plausibility::Good
    );
}

/// All components are commanded at 1 rad/s and measured so, all but what `freeze` does to it; the
/// millisecond in which that was noticed, of 100.
fn frozen_after_ms(
    robot: &Robot,
    mut measure: impl FnMut(Configuration) -> Measurement,
) -> Option<(u64, usize)> {
    let mut watch = MeasurementWatch::new(RULES);
    let rates = BendRates::from_slice(&[1.0, -1.0, 1.0, 1.0]).unwrap();
    let mut bends = bends(0.2);
    watch.check(robot, &measure(bends), 0);
    (1..=100).find_map(|ms| {
        watch.commanded(&rates, 1e-3);
        bends = bends.advanced(&rates, 1e-3);
        match watch.check(robot, &measure(bends), ms * MS) {
            Plausibility::Frozen { channel } => Some((ms, channel)),
            _ => None,
        }
    })
}

#[test]
fn a_single_component_that_stands_still_is_noticed_and_none_is_where_all_move() {
    let robot = robot();
    let first = bends(0.2);
    for k in 0..4 {
        let noticed = frozen_after_ms(&robot, |mut bends| {
            bends.as_mut_slice()[k] = first.as_slice()[k];
            Measurement::Configuration(bends)
        });
        let is_named = matches!(noticed, Some((50..=51, channel)) if channel == k);
        assert!(is_named, "{k}: {noticed:?}");
    }
    let all_move = frozen_after_ms(&robot, Measurement::Configuration);
    assert_eq!(all_move, None);
}

#[test]
fn a_single_cable_that_stands_still_is_noticed_once_its_length_should_have_changed() {
    let robot = robot();
    let first = cables(&robot, &bends(0.2));
    for cable in 0..6 {
        let (mut moved_m, mut checked_m) = (0.0_f64, 0.0);
        let noticed = frozen_after_ms(&robot, |bends| {
            let mut lengths = cables(&robot, &bends);
            checked_m = moved_m;
            moved_m = (lengths[cable] - first[cable]).abs();
            lengths[cable] = first[cable];
            Measurement::CableLengths(lengths)
        });
        let allowed_m = 0.05 * robot.sections()[cable / 3].cable_radius_m;
        let named = noticed.map(|(_, channel)| channel);
        assert_eq!(named, (moved_m > allowed_m).then_some(cable));
        assert!(checked_m <= allowed_m + 1e-12, "{cable}");
    }
    let all_move = frozen_after_ms(&robot, |bends| {
        Measurement::CableLengths(cables(&robot, &bends))
    });
    assert_eq!(all_move, None);
}

#[test]
fn a_tip_that_stands_still_is_noticed_as_a_whole() {
    let robot = robot();
    let at = |bends: Configuration| robot.tip_position(&bends);
    let first = at(bends(0.2));
    let noticed = frozen_after_ms(&robot, |_| Measurement::TipPosition(first));
    assert!(matches!(noticed, Some((50..=51, 0))), "{noticed:?}");
    // One coordinate that does not change may be right.
    let noticed = frozen_after_ms(&robot, |bends| {
        let now = at(bends);
        Measurement::TipPosition(Vector3::new(first.x, now.y, now.z))
    });
    assert_eq!(noticed, None);
}

#[test]
fn a_value_that_stands_still_is_frozen_only_while_the_robot_should_move() {
    let (robot, mut watch) = (robot(), MeasurementWatch::new(RULES));
    let still = BendRates::zero(2);
    let moving = BendRates::from_slice(&[0.0, -1.0, 0.2, 0.0]).unwrap();
    for ms in 0..1000 {
        watch.commanded(&still, 1e-3);
        assert_eq!(
            watch.check(&robot, &measured(0.2), ms * MS),
            Plausibility::Good
        );
    }
    for ms in 1000..1049 {
        watch.commanded(&moving, 1e-3);
        assert_eq!(
            watch.check(&robot, &measured(0.2), ms * MS),
            Plausibility::Good
        );
    }
    watch.commanded(&moving, 2e-3);
    assert_eq!(
        watch.check(&robot, &measured(0.2), 1050 * MS),
        Plausibility::Frozen { channel: 1 }
    );
    // Reported once, and again when it should have moved as far again.
    assert_eq!(
        watch.check(&robot, &measured(0.2), 1051 * MS),
        Plausibility::Good
    );
    watch.commanded(&moving, 0.051);
    assert_eq!(
        watch.check(&robot, &measured(0.2), 1052 * MS),
        Plausibility::Frozen { channel: 1 }
    );
    // The smallest change shows that the sensor of this component lives, and of no other.
    let changed = |k: usize| {
        let mut bends = bends(0.2);
        bends.as_mut_slice()[k] += 1e-15;
        Measurement::Configuration(bends)
    };
    watch.commanded(&moving, 0.049);
    assert_eq!(
        watch.check(&robot, &changed(1), 1053 * MS),
        Plausibility::Good
    );
    watch.commanded(&moving, 0.049);
    assert_eq!(
        watch.check(&robot, &changed(1), 1054 * MS),
        Plausibility::Good
    );
    let mut other = MeasurementWatch::new(RULES);
    other.check(&robot, &measured(0.2), 0);
    other.commanded(&moving, 0.051);
    assert_eq!(
        other.check(&robot, &changed(2), MS),
        Plausibility::Frozen { channel: 1 }
    );
}
