//! Resets of a robot whose commanded position is not where it is measured.

use cdcr_controller::plant::{Flaws, Preset};
use cdcr_controller::robot::CABLES_MAX;
use cdcr_controller::safety::{Mode, Reason, Refusal, Request};

use super::trial::{PERIOD_S, TRACK, Trial};
use super::{DIRECT, MOST_RAD_S2, bits};
use crate::config::Interface;

/// Error of an encoder \[m\]: 0.25 rad of the first section, beyond a plausible jump.
const WRONG_M: f64 = 0.25 * 1.5 * 0.0125;

fn apart(a: &[f64], b: &[f64]) -> f64 {
    let pairs = a.iter().zip(b);
    pairs.fold(0.0, |most, (a, b)| most.max((a - b).abs()))
}

fn tracking() -> Trial {
    tracking_with(Preset::Laboratory.flaws())
}

fn tracking_with(flaws: Flaws) -> Trial {
    let mut trial = Trial::with(Interface::Position, flaws, DIRECT);
    trial.turns(3);
    trial.begin_tracking();
    trial.turns(400);
    trial
}

/// The encoder of a cable jumps by `wrong_m`, and the robot rests in the fault.
fn faulted(mut trial: Trial, wrong_m: f64) -> Trial {
    trial.cable_error_m[0] = wrong_m;
    let reason = trial.turns(3).mode.reason();
    assert_eq!(reason, Reason::MeasurementJump);
    trial.turns(100);
    trial
}

/// The commanded position goes on from the last one to the measured one, inside rates and acceleration.
#[test]
fn after_a_wrong_measurement_the_set_point_makes_no_step() {
    let mut trial = faulted(tracking(), WRONG_M);
    let (stood_at, measured) = (trial.target_rad.clone(), trial.measured());
    let (mut before, mut rate_rad_s) = (stood_at.clone(), vec![0.0_f64; 6]);
    for turn in 0..300 {
        let (record, outcome) = match turn {
            0 => (trial.ask(Request::Reset), Ok(())),
            // Control has not begun.
            1 => (trial.ask(TRACK), Err(Refusal::Waits)),
            _ => (trial.turn(), Ok(())),
        };
        assert!(
            record
                .answers
                .iter()
                .flatten()
                .all(|answer| answer.outcome == outcome)
        );
        let mode = record.mode;
        assert!(matches!(mode, Mode::Holding { .. }), "{mode:?}");
        for (i, last) in rate_rad_s.iter_mut().enumerate() {
            let rate = (trial.target_rad[i] - before[i]) / PERIOD_S;
            let most = (last.abs() + MOST_RAD_S2 * PERIOD_S).min(record.policy.home_rate_rad_s);
            assert!(
                rate.abs() <= most + 1e-9,
                "component {i}: {last} → {rate} rad/s"
            );
            *last = rate;
        }
        before.clone_from(&trial.target_rad);
    }
    assert!(apart(&before, &stood_at) > 0.2, "{before:?}");
    // Noise of the encoders, 30 µm.
    assert!(
        apart(&before, measured.as_slice()) < 0.02,
        "{before:?} {measured:?}"
    );
    trial.begin_tracking();
    assert!(matches!(trial.turns(100).mode, Mode::Tracking { .. }));
}

/// A sensor that measures right again: no command moves the robot, to the bit.
#[test]
fn after_a_wrong_measurement_that_passed_a_reset_moves_nothing() {
    let mut trial = faulted(tracking(), WRONG_M);
    trial.cable_error_m = [0.0; CABLES_MAX];
    trial.turns(100);
    let target_rad = bits(&trial.target_rad);
    let reset = trial.ask(Request::Reset);
    assert_eq!(reset.answers[0].unwrap().outcome, Ok(()));
    trial.turns(100);
    assert_eq!(bits(&trial.target_rad), target_rad);
    trial.begin_tracking();
    assert!(matches!(trial.turns(100).mode, Mode::Tracking { .. }));
}

/// A driver that is started again during a motion obeys from its first position on: a reset is no step, either.
#[test]
fn after_a_wrong_measurement_the_set_point_of_a_new_driver_makes_no_step() {
    let mut trial = tracking();
    trial.inputs.drivers += 1;
    trial.turns(2);
    let mut trial = faulted(trial, WRONG_M);
    let stood_at = trial.target_rad.clone();
    trial.ask(Request::Reset);
    let first = trial.turn();
    assert!(first.way.is_some());
    assert!(apart(&trial.target_rad, &stood_at) < MOST_RAD_S2 * PERIOD_S * PERIOD_S * 1.01);
}

/// While the way waits for a source of obstacles, the robot comes back to its commanded position: nothing moves
/// any more.
#[test]
fn the_way_ends_where_the_robot_has_come_back() {
    let mut trial = faulted(tracking(), WRONG_M);
    trial.ask(Request::Reset);
    assert!(trial.turns(10).way.is_some());
    trial.inputs.obstacle_source_silent = true;
    assert!(trial.turns(20).way.is_none());
    let target_rad = bits(&trial.target_rad);
    for percent in (0..100).rev() {
        trial.cable_error_m[0] = WRONG_M * 0.01 * f64::from(percent);
        trial.turn();
    }
    trial.inputs.obstacle_source_silent = false;
    trial.turns(100);
    assert_eq!(bits(&trial.target_rad), target_rad);
    trial.begin_tracking();
}

/// A stop on the way ends it, and the next reset goes on from there.
#[test]
fn a_stop_ends_the_way_to_the_robot() {
    let mut trial = faulted(tracking(), WRONG_M);
    trial.ask(Request::Reset);
    trial.turns(20);
    trial.ask(Request::Stop);
    trial.turns(20);
    let target_rad = bits(&trial.target_rad);
    trial.turns(20);
    assert_eq!(bits(&trial.target_rad), target_rad);
    let before = trial.target_rad.clone();
    trial.ask(Request::Reset);
    trial.turn();
    assert!(apart(&trial.target_rad, &before) < MOST_RAD_S2 * PERIOD_S * PERIOD_S * 1.01);
}

/// Motors hold after torque was off and do not yet follow: their encoders, without noise, rest to the bit while
/// the commanded position moves to them. They count as frozen only when control has begun.
#[test]
fn encoders_at_rest_are_not_frozen_on_the_way_to_the_robot() {
    let mut trial = faulted(tracking_with(Flaws::default()), 4.0 * WRONG_M);
    trial.stands = true;
    let (stood_at, measured) = (trial.target_rad.clone(), trial.measured());
    trial.ask(Request::Reset);
    for _ in 0..600 {
        let mode = trial.turn().mode;
        assert!(matches!(mode, Mode::Holding { .. }), "{mode:?}");
    }
    assert!(apart(&trial.target_rad, &stood_at) > 0.9);
    assert!(apart(&trial.target_rad, measured.as_slice()) < 1e-6);
    trial.begin_tracking();
    let reason = trial.turns(600).mode.reason();
    assert_eq!(reason, Reason::MeasurementFrozen);
}
