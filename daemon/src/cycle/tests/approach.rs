//! A reference that begins away from the tip, or in motion, is reached within the limits of the approach.

mod held_back;

use cdcr_controller::plant::{Flaws, RobotPreset};
use cdcr_controller::safety::Refusal;
use nalgebra::Vector3;

use super::super::*;
use super::trial::{PERIOD_S, TRACK, Trial};
use crate::config::Interface;

/// Defaults of the configuration.
const APPROACH_M_S: f64 = 0.1;
const APPROACH_M_S2: f64 = 0.5;
/// Motors with a lag, an offset and a droop shift the estimate slightly.
const ROUNDING: f64 = 1.05;

/// The laboratory's robot without encoder noise, which would appear in commands and accelerations.
fn trial(approach: &str) -> Trial {
    let more = format!("[motion]\napproach = \"{approach}\"\n");
    let flaws = Flaws {
        noise_m: 0.0,
        ..RobotPreset::Laboratory.flaws()
    };
    let mut trial = Trial::with(Interface::Position, flaws, &more);
    trial.turns(100);
    trial
}

/// The commanded tip in `count` cycles \[m\].
fn tips_m(trial: &mut Trial, count: u32) -> Vec<Vector3<f64>> {
    let robot = trial.cycle.robot.clone();
    let next = || robot.tip_position(&trial.turn().commanded);
    core::iter::repeat_with(next).take(count as usize).collect()
}

/// Largest speed \[m/s\] and largest acceleration \[m/s²\].
fn fastest(tips_m: &[Vector3<f64>]) -> (f64, f64) {
    let velocities: Vec<_> = tips_m
        .windows(2)
        .map(|pair| (pair[1] - pair[0]) / PERIOD_S)
        .collect();
    let speeds = velocities.iter().map(Vector3::norm);
    let changes = velocities
        .windows(2)
        .map(|pair| (pair[1] - pair[0]).norm() / PERIOD_S);
    (speeds.fold(0.0, f64::max), changes.fold(0.0, f64::max))
}

/// 0.4 m beside the tip of the straight robot, and within its reach.
const BESIDE_M: [f64; 3] = [0.2, -0.3, 0.7];
const ALONG_M_S: [f64; 3] = [0.0, 0.05, 0.0];
const SPEED_M_S: f64 = 0.05;

fn is_gentle((speed_m_s, acceleration_m_s2): (f64, f64)) -> bool {
    println!("{speed_m_s} m/s, {acceleration_m_s2} m/s²");
    speed_m_s <= ROUNDING * (APPROACH_M_S + 1.52 * SPEED_M_S)
        && acceleration_m_s2 <= ROUNDING * APPROACH_M_S2
}

#[test]
fn a_reference_that_moves_elsewhere_is_reached_gently() {
    for (begins_in_s, approach) in [
        (0.0, "smooth"),
        (0.5, "smooth"),
        (0.0, "direct"),
        (0.5, "direct"),
    ] {
        let mut trial = trial(approach);
        trial.feed_line(BESIDE_M, ALONG_M_S, begins_in_s);
        trial.ask(TRACK);
        let tips_m = tips_m(&mut trial, 1750);
        let seen = fastest(&tips_m);
        assert_eq!(is_gentle(seen), approach == "smooth", "{seen:?}");
        let record = trial.turn();
        assert!(!record.approach.is_active(), "it is over");
        let error_m = (record.tip.position_m - record.reference.position_m).norm();
        assert!(error_m < 0.002, "{error_m}");
    }
}

#[test]
fn a_reference_that_is_replaced_by_another_one_is_left_gently() {
    let mut trial = trial("smooth");
    trial.feed_line(BESIDE_M, ALONG_M_S, 0.0);
    trial.ask(TRACK);
    let mut all_m = tips_m(&mut trial, 1000);
    trial.feed_line([-0.3, 0.1, 0.7], [0.05, 0.0, 0.0], 0.0);
    all_m.extend(tips_m(&mut trial, 1000));
    let seen = fastest(&all_m);
    assert!(is_gentle(seen), "{seen:?}");
}

#[test]
fn with_refuse_a_reference_that_is_far_is_not_tracked_and_a_near_one_is() {
    let mut trial = trial("refuse");
    trial.feed_line(BESIDE_M, ALONG_M_S, 0.1);
    let record = trial.ask(TRACK);
    assert_eq!(record.answers[0].unwrap().outcome, Err(Refusal::TooFar));
    assert!(matches!(record.mode, Mode::Holding { .. }));
    trial.feed_line([0.01, 0.0, 0.89], [0.0; 3], 0.1);
    let record = trial.ask(TRACK);
    assert_eq!(record.answers[0].unwrap().outcome, Ok(()));
    let seen = fastest(&tips_m(&mut trial, 400));
    assert!(is_gentle(seen), "{seen:?}");
    // The same for references that replace it.
    trial.feed_line([0.02, 0.0, 0.89], [0.0; 3], 0.0);
    let mode = trial.turn().mode;
    assert!(matches!(mode, Mode::Tracking { .. }), "{mode:?}");
    let seen = fastest(&tips_m(&mut trial, 400));
    assert!(is_gentle(seen), "{seen:?}");
    trial.feed_line(BESIDE_M, ALONG_M_S, 0.0);
    let held = trial.turn();
    let reason = Reason::ReferenceTooFar;
    assert_eq!(held.mode, Mode::Holding { reason });
    let tip_m = trial.tip_m;
    trial.turns(200);
    let moved_m = (trial.tip_m - tip_m).norm();
    assert!(moved_m < 1e-3, "{moved_m} m");
    let record = trial.ask(TRACK);
    assert_eq!(record.answers[0].unwrap().outcome, Err(Refusal::TooFar));
}
