//! The tip margin of a body that differs from its model, when control begins again.

use cdcr_controller::plant::Flaws;
use cdcr_controller::robot::{Obstacle, Shape};
use cdcr_controller::safety::{Mode, Reason, Refusal, Request};
use nalgebra::Vector3;

use super::trial::{TRACK, Trial};
use super::{BLIND_DIRECT, is_at_rest};
use crate::config::Interface;
use crate::handover::{FaultPlace, MeasurementUse};

const CONTACT: Mode = Mode::Faulted {
    reason: Reason::ClearanceBroken,
};
const BALL_RADIUS_M: f64 = 0.03;
const SAFE_M: f64 = 0.01;

/// Sections 5 % longer than their model, with a tip sensor that has measured the offset.
fn longer(interface: Interface) -> Trial {
    let flaws = Flaws {
        length_error: 0.05,
        noise_m: 3e-5,
        tip_noise_m: 3e-4,
        ..Flaws::default()
    };
    let mut trial = Trial::with(interface, flaws, BLIND_DIRECT);
    trial.measures_tip = true;
    let beside_m = trial.turns(300).tip_offset_m.norm();
    assert!((0.03..0.06).contains(&beside_m), "{beside_m}");
    trial
}

/// True clearance of the body \[m\].
fn clearance_m(trial: &Trial, ball: &Obstacle) -> f64 {
    let plant = &trial.plant;
    plant.truth().clearance_m(&plant.configuration(), ball)
}

/// A stop and a reset with a tip sensor that works, froze or is silent: the true body keeps the distance, and
/// the offset does not step.
#[test]
fn a_reset_keeps_what_is_known_of_the_body() {
    for interface in [Interface::Position, Interface::Velocity] {
        for sensor in ["measures", "froze", "is dead"] {
            let mut trial = longer(interface);
            let tip_m = trial.plant.tip_m();
            let ball = trial.put_ball(tip_m + Vector3::new(0.2, 0.0, -0.05), BALL_RADIUS_M);
            match sensor {
                "froze" => trial.frozen_tip_m = Some(tip_m),
                "is dead" => trial.measures_tip = false,
                _ => {}
            }
            let before_m = trial.turn().tip_offset_m;
            trial.ask(Request::Stop);
            assert!(is_at_rest(&trial.turns(50)));
            let reset = trial.ask(Request::Reset);
            assert_eq!(reset.answers[0].unwrap().outcome, Ok(()));
            let stepped_m = (trial.turn().tip_offset_m - before_m).norm();
            assert!(stepped_m < 2e-3, "{sensor}: {stepped_m} m");
            // Towards the ball, from above.
            let goal_m = Vector3::new(ball_centre(&ball).x, 0.0, tip_m.z - 0.07);
            trial.feed_line(goal_m.into(), [0.0; 3], 0.0);
            trial.ask(TRACK);
            let (mut nearest_m, mut guarded) = (f64::INFINITY, 0);
            for _ in 0..800 {
                let record = trial.turn();
                assert!(matches!(record.mode, Mode::Tracking { .. }), "{sensor}");
                guarded += u32::from(record.clearance_hit);
                nearest_m = nearest_m.min(clearance_m(&trial, &ball));
            }
            println!("{interface:?}, the sensor {sensor}: {nearest_m} m");
            assert!(guarded > 10, "{sensor}: {guarded}");
            assert!(nearest_m > SAFE_M - 1e-3, "{sensor}: {nearest_m} m");
        }
    }
}

fn ball_centre(ball: &Obstacle) -> Vector3<f64> {
    match ball.shape() {
        Shape::Sphere { centre_m } => *centre_m,
        other @ Shape::Capsule { .. } => unreachable!("{other:?}"),
    }
}

/// Sections 20 % longer than their model: the tip is measured too far from its bends to be followed. The true body
/// keeps the safe distance all the same, because it may be where the tip is measured.
#[test]
fn a_body_whose_tip_is_too_far_from_its_model_keeps_the_distance() {
    for interface in [Interface::Position, Interface::Velocity] {
        let flaws = Flaws {
            length_error: 0.2,
            noise_m: 3e-5,
            tip_noise_m: 3e-4,
            ..Flaws::default()
        };
        let mut trial = Trial::with(interface, flaws, BLIND_DIRECT);
        trial.measures_tip = true;
        // One measurement may be an error of the sensor.
        assert_eq!(trial.turn().tip_margin_m, 0.0);
        let rests = trial.turns(5);
        assert_eq!(rests.tip_use, MeasurementUse::Implausible);
        assert!(rests.tip_margin_m > 0.17, "{}", rests.tip_margin_m);
        // On the true path to the goal.
        let goal_m = Vector3::new(0.35, 0.0, 0.72);
        let ball = trial.put_ball(1.2 * goal_m, BALL_RADIUS_M);
        trial.feed_line(goal_m.into(), [0.0; 3], 0.0);
        trial.ask(TRACK);
        let (mut nearest_m, mut guarded) = (f64::INFINITY, 0);
        for _ in 0..800 {
            let record = trial.turn();
            assert!(matches!(record.mode, Mode::Tracking { .. }));
            guarded += u32::from(record.clearance_hit);
            nearest_m = nearest_m.min(clearance_m(&trial, &ball));
        }
        println!("{interface:?}: {nearest_m} m");
        assert!(guarded > 10, "{guarded}");
        assert!(nearest_m > SAFE_M - 1e-3, "{nearest_m} m");
    }
}

/// A possible contact counts as contact and blocks a reset, even with a silent sensor. A tip known to be
/// wrong must not block it: its offset is discarded once the robot rests.
#[test]
fn a_contact_by_the_margin_alone_stands_until_the_tip_is_known_to_be_wrong() {
    for is_wrong in [false, true] {
        let mut trial = longer(Interface::Velocity);
        let tip_m = trial.cycle.robot.tip_position(&trial.measured());
        // 20 mm beside the body of the model.
        let away_m = 0.015 + 0.02 + BALL_RADIUS_M;
        let ball = trial.put_ball(tip_m + Vector3::new(away_m, 0.0, 0.0), BALL_RADIUS_M);
        let model_m = trial.cycle.robot.clearance_m(&trial.measured(), &ball);
        assert!((0.015..0.03).contains(&model_m), "{model_m}");
        let faulted = trial.turns(3);
        assert_eq!(faulted.mode, CONTACT);
        assert!(faulted.clearance_m < 0.0 && faulted.tip_offset_m.norm() > 0.03);
        let place = FaultPlace::find(&trial.cycle.robot, &faulted).unwrap();
        let text = place.to_string();
        assert!(text.contains("a tip sensor that contradicts"), "{text}");
        if is_wrong {
            // The sensor fell off its mount.
            trial.tip_error_m = Vector3::new(1.5, 0.0, 0.0);
        } else {
            trial.measures_tip = false;
        }
        let rests = trial.turns(10);
        let reset = trial.ask(Request::Reset);
        let outcome = reset.answers[0].unwrap().outcome;
        if !is_wrong {
            assert_eq!(outcome, Err(Refusal::CauseStands));
            trial.inputs.obstacles.remove(1);
            trial.turns(2);
            let reset = trial.ask(Request::Reset);
            assert_eq!(reset.answers[0].unwrap().outcome, Ok(()));
            continue;
        }
        assert_eq!(rests.tip_use, MeasurementUse::Implausible);
        assert_eq!((outcome, rests.tip_offset_m), (Ok(()), Vector3::zeros()));
        assert!((rests.clearance_m - model_m).abs() < 1e-3);
        assert!(matches!(trial.turns(20).mode, Mode::Holding { .. }));
    }
}
