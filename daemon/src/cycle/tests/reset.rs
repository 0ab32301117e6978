//! Resets of a robot whose commanded position is not where it is measured.

use cdcr_controller::estimator::Measurement;
use cdcr_controller::plant::{Flaws, RobotPreset};
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
    tracking_with(RobotPreset::Laboratory.flaws())
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
            0 => (trial.ask(Request::Reset), Err(Refusal::PoseDiffers)),
            1 => (trial.ask(Request::ResetAcceptingPose), Ok(())),
            // Control has not begun.
            2 => (trial.ask(TRACK), Err(Refusal::Waits)),
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
        let is_refused = outcome == Err(Refusal::PoseDiffers);
        assert_eq!(
            matches!(mode, Mode::Holding { .. }),
            !is_refused,
            "{mode:?}"
        );
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

/// A driver that is started again during a motion obeys from its first position on: a reset is not a step, either.
#[test]
fn after_a_wrong_measurement_the_set_point_of_a_new_driver_makes_no_step() {
    let mut trial = tracking();
    trial.inputs.drivers += 1;
    trial.turns(2);
    let mut trial = faulted(trial, WRONG_M);
    let stood_at = trial.target_rad.clone();
    trial.ask(Request::ResetAcceptingPose);
    let first = trial.turn();
    assert!(first.way.is_some());
    assert!(apart(&trial.target_rad, &stood_at) < MOST_RAD_S2 * PERIOD_S * PERIOD_S * 1.01);
}

/// While the way waits for a source of obstacles, the robot comes back to its commanded position: nothing moves
/// any more.
#[test]
fn the_way_ends_where_the_robot_has_come_back() {
    let mut trial = faulted(tracking(), WRONG_M);
    trial.ask(Request::ResetAcceptingPose);
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
    trial.ask(Request::ResetAcceptingPose);
    trial.turns(20);
    trial.ask(Request::Stop);
    trial.turns(20);
    let target_rad = bits(&trial.target_rad);
    trial.turns(20);
    assert_eq!(bits(&trial.target_rad), target_rad);
    let before = trial.target_rad.clone();
    trial.ask(Request::ResetAcceptingPose);
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
    trial.ask(Request::ResetAcceptingPose);
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

/// Outcome of a reset of a robot that rests since its driver fell silent in a motion, and is measured `error_rad` elsewhere,
/// a quarter of a minute later.
fn reset_elsewhere(interface: Interface, error_rad: f64) -> (Trial, Result<(), Refusal>) {
    let mut trial = stopped_elsewhere(interface, error_rad, false);
    let outcome = trial.ask(Request::Reset).answers[0].unwrap().outcome;
    (trial, outcome)
}

fn stopped_elsewhere(interface: Interface, error_rad: f64, measures_tip: bool) -> Trial {
    let mut trial = Trial::with(interface, RobotPreset::Laboratory.flaws(), DIRECT);
    trial.measures_tip = measures_tip;
    trial.turns(3);
    trial.begin_tracking();
    trial.turns(400);
    // The motors stop at once; the daemon commands on until the timeout, and then its ramp.
    trial.stands = true;
    for _ in 0..100 {
        trial.turn_of(false, true);
    }
    assert_eq!(trial.last().mode.reason(), Reason::MeasurementLost);
    while trial.cable_error_m[0] < error_rad * 1.5 * 0.0125 {
        trial.cable_error_m[0] += 1e-5;
        trial.turn();
    }
    trial.turns(3000);
    trial
}

fn outcome(trial: &mut Trial, request: Request) -> Result<(), Refusal> {
    trial.ask(request).answers[0].unwrap().outcome
}

/// A robot may droop up to the limit of a fault: it rests there after a stop, too.
#[test]
fn a_droop_that_is_no_fault_needs_no_word_at_a_reset() {
    for interface in [Interface::Velocity, Interface::Position] {
        let mut trial = Trial::with(interface, RobotPreset::Laboratory.flaws(), DIRECT);
        trial.turns(3);
        while trial.cable_error_m[0] < WRONG_M {
            trial.cable_error_m[0] += 1e-5;
            trial.turn();
        }
        trial.ask(Request::Stop);
        trial.turns(200);
        assert_eq!(outcome(&mut trial, Request::Reset), Ok(()), "{interface:?}");
    }
}

/// The commanded position moves to the robot at a reset, and loaded motors stay. The robot has sunk once, when they took up its load.
#[test]
fn a_simulated_robot_that_droops_sinks_at_no_reset() {
    let droops = "simulated_flaws = { droop_m = 0.002 }\n";
    let mut trial = Trial::simulated(Interface::Position, RobotPreset::Laboratory, droops);
    trial.turns(400);
    let place = |trial: &Trial| match trial.last().measurement.map(|timed| timed.measurement) {
        Some(Measurement::CableLengths(lengths_m)) => lengths_m,
        other => unreachable!("{other:?}"),
    };
    let (stood_m, commanded) = (place(&trial), trial.target_rad.clone());
    for number in 1..=3 {
        trial.ask(Request::Stop);
        trial.turns(100);
        assert_eq!(outcome(&mut trial, Request::Reset), Ok(()));
        trial.turns(400);
        let moved_m = apart(&place(&trial), &stood_m);
        assert!(moved_m < 1e-4, "reset {number}: {moved_m} m");
        let error_rad = trial.last().following.largest_rad();
        assert!(error_rad < 0.02, "reset {number}: {error_rad} rad");
    }
    assert!(apart(&trial.target_rad, &commanded) > 0.05);
    // They follow from there.
    trial.begin_tracking();
    assert!(matches!(trial.turns(400).mode, Mode::Tracking { .. }));
    assert!(trial.last().following.largest_rad() < 0.05);
    assert!(apart(&place(&trial), &stood_m) > 1e-3);
}

/// The daemon before this one saw another pose, and this one does not know where the last command led.
#[test]
fn an_uncertain_pose_is_accepted_once() {
    let mut trial = Trial::new(Interface::Position);
    trial.cycle = trial
        .cycle
        .stopped_before(Reason::StoppedBefore)
        .uncertain_pose(true);
    trial.turns(3);
    let refused = outcome(&mut trial, Request::Reset);
    assert_eq!(refused, Err(Refusal::PoseDiffers));
    assert!(trial.last().seen.pose_differs);
    let accepted = outcome(&mut trial, Request::ResetAcceptingPose);
    assert_eq!(accepted, Ok(()));
    trial.turns(100);
    trial.ask(Request::Stop);
    trial.turns(100);
    assert_eq!(outcome(&mut trial, Request::Reset), Ok(()));
}

/// What the last measurement would have shown is not known.
#[test]
fn a_reset_waits_for_a_measurement_that_is_no_jump() {
    let mut trial = Trial::new(Interface::Position);
    trial.turns(100);
    trial.ask(Request::Stop);
    trial.cable_error_m[0] = WRONG_M;
    let refused = outcome(&mut trial, Request::ResetAcceptingPose);
    assert_eq!(refused, Err(Refusal::CauseStands));
    let refused_by = trial.last().seen.reset_refused_by();
    assert_eq!(refused_by, Some(Reason::MeasurementJump));
    trial.cable_error_m[0] = 0.0;
    assert_eq!(outcome(&mut trial, Request::Reset), Ok(()));
}

/// Speeds that are integrated would be forgotten in a second while in control; in a fault the place where the last command
/// left the robot is kept. A robot that rests on its last motion is not in another place.
#[test]
fn a_reset_asks_about_a_pose_that_differs_and_about_no_other() {
    for interface in [Interface::Velocity, Interface::Position] {
        for error_rad in [0.0, 0.12] {
            let (_, outcome) = reset_elsewhere(interface, error_rad);
            assert_eq!(outcome, Ok(()), "{interface:?} {error_rad} rad");
        }
        let (mut trial, outcome) = reset_elsewhere(interface, 0.35);
        assert_eq!(outcome, Err(Refusal::PoseDiffers), "{interface:?}");
        let refused_by = trial.last().seen.reset_refused_by();
        assert_eq!(refused_by, Some(Reason::PoseDiffers));
        let accepted = trial.ask(Request::ResetAcceptingPose);
        assert_eq!(accepted.answers[0].unwrap().outcome, Ok(()));
        // Once control has begun there, a stop and a reset need no such word.
        trial.turns(1000);
        trial.ask(Request::Stop);
        trial.turns(100);
        let reset = trial.ask(Request::Reset);
        assert_eq!(reset.answers[0].unwrap().outcome, Ok(()), "{interface:?}");
    }
}

/// The estimate of a robot with a load differs from its commanded position; a reset would move it by this difference
/// again and again.
#[test]
fn resets_move_no_robot_of_which_the_tip_alone_is_measured() {
    let mut trial = Trial::with(Interface::Position, RobotPreset::Laboratory.flaws(), DIRECT);
    trial.measures_tip_alone = true;
    trial.turns(200);
    trial.feed_line([0.1, 0.05, 0.85], [0.0; 3], 0.0);
    trial.ask(TRACK);
    trial.turns(400);
    trial.ask(Request::Hold);
    trial.turns(100);
    let tip_m = trial.tip_m;
    for _ in 0..4 {
        trial.ask(Request::Stop);
        // Its driver is started again.
        trial.inputs.drivers += 1;
        trial.turns(50);
        let reset = trial.ask(Request::Reset);
        assert_eq!(reset.answers[0].unwrap().outcome, Ok(()));
        trial.turns(300);
        let moved_m = (trial.tip_m - tip_m).norm();
        println!("{moved_m} m");
        assert!(moved_m < 1e-3, "{moved_m}");
    }
}

/// Encoders that lost their zero are not believed where a tip sensor measures the tip elsewhere: not with its bits unchanged at rest,
/// and not by a person who accepts the pose.
#[test]
fn a_pose_that_a_live_tip_contradicts_is_accepted_by_no_reset() {
    for interface in [Interface::Velocity, Interface::Position] {
        let stopped = |error_rad| stopped_elsewhere(interface, error_rad, true);
        let mut trial = stopped(0.35);
        for is_frozen in [false, true] {
            trial.frozen_tip_m = is_frozen.then(|| trial.plant.tip_m());
            trial.turns(3);
            for request in [Request::Reset, Request::ResetAcceptingPose] {
                let refused = outcome(&mut trial, request);
                assert_eq!(refused, Err(Refusal::TipElsewhere), "{interface:?}");
            }
            let record = trial.last();
            let refused_by = record.seen.reset_refused_by();
            assert_eq!(refused_by, Some(Reason::TipElsewhere));
            assert!(record.seen.tip_contradiction_m > 0.1 && record.mode.is_latched());
        }
        // The zero is found again.
        trial.cable_error_m = [0.0; CABLES_MAX];
        trial.turns(10);
        assert_eq!(outcome(&mut trial, Request::Reset), Ok(()));

        // A sensor that ended, and one that measures where no body is, contradict nothing.
        let mut ended = stopped(0.35);
        ended.measures_tip = false;
        ended.turns(150);
        let refused = outcome(&mut ended, Request::ResetAcceptingPose);
        assert_eq!(refused, Err(Refusal::TipElsewhere), "a pause");
        ended.turns(100);
        let mut nowhere = stopped(0.35);
        nowhere.tip_error_m.x = 2.0;
        nowhere.turns(30);
        for trial in [&mut ended, &mut nowhere] {
            let refused = outcome(trial, Request::Reset);
            assert_eq!(refused, Err(Refusal::PoseDiffers), "{interface:?}");
            let accepted = outcome(trial, Request::ResetAcceptingPose);
            assert_eq!(accepted, Ok(()), "{interface:?}");
        }

        // A stray tip is none, either.
        let mut stray = stopped(0.0);
        stray.tip_error_m.x = 0.3;
        stray.turn();
        assert_eq!(outcome(&mut stray, Request::Reset), Ok(()));
    }
}
