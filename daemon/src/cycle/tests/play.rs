//! Cycles of a robot whose cables have play.

use cdcr_controller::estimator::Actuator;
use cdcr_controller::plant::Flaws;
use cdcr_controller::robot::Configuration;
use cdcr_controller::safety::Request;
use nalgebra::Vector3;

use super::super::*;
use super::trial::{TRACK, Trial};
use super::{BLIND_DIRECT, is_at_rest};
use crate::config::Interface;

const INTERFACES: [Interface; 2] = [Interface::Position, Interface::Velocity];
const PLAY_M: f64 = 1.5e-3;
/// Largest bend caused by half of the play \[rad\]: two thirds of twice half the play, over the cables'
/// distance from the backbone.
const SLACK_RAD: f64 = 2.0 / 3.0 * PLAY_M / 0.0125;

/// A robot with play, of which the configuration contains `known_m`.
fn with_play(interface: Interface, known_m: f64, more: &str) -> Trial {
    let flaws = Flaws {
        actuator: Actuator {
            play_m: PLAY_M,
            ..Actuator::IDEAL
        },
        // Minimal noise, because a constant measurement counts as frozen.
        noise_m: 1e-9,
        ..Flaws::default()
    };
    let known = format!("[actuator]\nplay_m = {known_m}\n{more}");
    Trial::with(interface, flaws, &known)
}

fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
    values
        .into_iter()
        .fold(0.0, |most, value| value.abs().max(most))
}

fn apart(a: &Configuration, b: &Configuration) -> f64 {
    largest(a.as_slice().iter().zip(b.as_slice()).map(|(a, b)| a - b))
}

#[test]
fn home_is_where_the_cables_are_straight_not_the_motors() {
    for interface in INTERFACES {
        // Homing may end as soon as the bends stay within its tolerance, here at up to 3e-3 rad.
        let known_rad = 0.05 * SLACK_RAD;
        for (known_m, within_rad) in [(PLAY_M, known_rad), (0.8 * PLAY_M, 0.01 + 0.2 * SLACK_RAD)] {
            let mut trial = with_play(interface, known_m, "");
            trial.turns(3);
            trial.begin_tracking();
            trial.turns(900);
            assert!(largest(trial.at_release.as_slice().iter().copied()) > 0.2);
            trial.ask(Request::Hold);
            trial.turns(20);
            trial.ask(Request::Home);
            let home = trial.turns(400);
            assert!(matches!(home.mode, Mode::Holding { .. }), "{:?}", home.mode);
            assert!(is_at_rest(&home));
            let left_rad = largest(trial.at_release.as_slice().iter().copied());
            println!("{interface:?}, {known_m} m known: {left_rad} rad");
            assert!(left_rad < within_rad, "{left_rad}");
        }
    }
}

/// After a stop in motion and a reset the cables are at their estimated position, and no command moves them.
#[test]
fn a_stop_and_a_reset_move_no_cable() {
    for interface in INTERFACES {
        let mut trial = with_play(interface, PLAY_M, "");
        trial.turns(3);
        trial.begin_tracking();
        trial.turns(700);
        trial.ask(Request::Stop);
        trial.turns(50);
        let rest = trial.at_release;
        let reset = trial.ask(Request::Reset);
        assert_eq!(reset.answers[0].unwrap().outcome, Ok(()));
        let held = trial.turns(20);
        assert!(matches!(held.mode, Mode::Holding { .. }));
        assert!(apart(&trial.at_release, &rest) < 1e-6);
        let off_rad = apart(&held.present, &rest);
        assert!(off_rad < 1e-4, "{interface:?}: {off_rad}");
        // Tracking continues from there.
        trial.begin_tracking();
        let error_m = |trial: &mut Trial| {
            let record = trial.turn();
            assert!(matches!(record.mode, Mode::Tracking { .. }));
            (trial.tip_m - record.reference.position_m).norm()
        };
        trial.turns(900);
        let errors_m = (0..800).map(|_| error_m(&mut trial));
        let mean_m = errors_m.sum::<f64>() / 800.0;
        println!("{interface:?}: {mean_m} m");
        assert!(mean_m < 1e-3, "{interface:?}: {mean_m}");
    }
}

/// Motors that follow cause no following error, even with play; motors that stand still do.
#[test]
fn play_is_no_following_error_and_motors_that_stand_are_one() {
    for interface in INTERFACES {
        let mut trial = with_play(interface, PLAY_M, "");
        trial.turns(3);
        trial.begin_tracking();
        let following = (0..1500).map(|_| trial.turn().following.largest_rad());
        let most_rad = following.fold(0.0, f64::max);
        println!("{interface:?}: {most_rad} rad");
        assert!(most_rad < 0.5 * SLACK_RAD, "{most_rad}");
        trial.stands = true;
        let latched = core::iter::repeat_with(|| trial.turn()).take(1000);
        let mut latched = latched.filter(|record| record.mode.is_latched());
        let mode = latched.next().expect("a fault").mode;
        assert_eq!(mode.reason(), Reason::FollowingError);
    }
}

/// The reference is out of reach, so that bends and cables reach their limits. The motors reach them, too,
/// but do not exceed them, and no fault follows.
#[test]
fn motors_keep_their_limits_where_cables_reach_theirs() {
    const BEND_MAX_RAD: f64 = 0.4;
    let section = format!(
        "[[robot.sections]]\nlength_m = 0.3\ncable_radius_m = 0.0125\ncable_offset_rad = 0.0\nbend_max_rad = {BEND_MAX_RAD}\nrate_max_rad_s = 2.0\nbody_radius_m = 0.015\n"
    );
    for interface in INTERFACES {
        for (stroke, stroke_max_m) in [("", 0.25), ("cable_stroke_max_m = 0.004\n", 0.004)] {
            let more = format!("[motion]\napproach = \"direct\"\n[robot]\n{stroke}{section}");
            let mut trial = with_play(interface, PLAY_M, &more);
            trial.turns(3);
            for goal_m in [[0.29, 0.05, 0.1], [-0.29, -0.05, 0.1]] {
                trial.feed_line(goal_m, [0.0; 3], 0.0);
                trial.ask(TRACK);
                for _ in 0..400 {
                    let record = trial.turn();
                    let mode = record.mode;
                    assert!(matches!(mode, Mode::Tracking { .. }), "{mode:?}");
                    let motors = trial.measured();
                    assert!(
                        motors.bend_rad(0) < BEND_MAX_RAD + 1e-6,
                        "{interface:?}: {motors:?}"
                    );
                    let strokes_m = trial.plant.truth().cable_strokes(&motors);
                    let most_m = largest(strokes_m);
                    assert!(most_m < stroke_max_m + 1e-7, "{interface:?}: {most_m} m");
                }
                let rest = trial.turn();
                assert!(apart(&trial.measured(), &rest.configuration) > 0.3 * SLACK_RAD);
            }
        }
    }
}

/// A ball in the way, ignored by the solver. The guard keeps the body clear with the known play and without
/// any play: it checks the motor positions, too.
#[test]
fn a_body_whose_cables_may_have_play_keeps_clear() {
    for interface in INTERFACES {
        for true_m in [PLAY_M, 0.0] {
            let mut trial = with_play(interface, PLAY_M, BLIND_DIRECT);
            let mut flaws = Flaws {
                noise_m: 1e-9,
                ..Flaws::default()
            };
            flaws.actuator.play_m = true_m;
            trial.plant.set_flaws(flaws);
            trial.turns(3);
            let ball = trial.put_ball(Vector3::new(0.2, 0.0, 0.8), 0.05);
            trial.feed_line([0.25, 0.0, 0.78], [0.0; 3], 0.0);
            trial.ask(TRACK);
            let robot = trial.plant.truth().clone();
            let (mut nearest_m, mut was_hit) = (f64::INFINITY, false);
            for _ in 0..600 {
                was_hit |= trial.turn().clearance_hit;
                nearest_m = nearest_m.min(robot.clearance_m(&trial.at_release, &ball));
            }
            println!("{interface:?}, {true_m} m: {nearest_m} m");
            assert!(
                was_hit && nearest_m > 0.0099,
                "{interface:?}, {true_m}: {nearest_m} m"
            );
        }
    }
}

/// The tip follows a circle and slides along a ball: a stop there slows down as evenly as a stop in free
/// space.
#[test]
fn a_stop_beside_a_ball_slows_down_evenly() {
    const LOSS_RAD_S: f64 = 10.0 * 0.005;
    let slow = format!("{BLIND_DIRECT}deceleration_rad_s2 = 10.0\n");
    for interface in INTERFACES {
        let (mut beside, mut longest) = (0, 0);
        for before in (540..720).step_by(10) {
            let mut trial = with_play(interface, PLAY_M, &slow);
            trial.turns(3);
            let ball = trial.put_ball(Vector3::new(0.0, -0.265, 0.837), 0.05);
            trial.begin_tracking();
            let moving = trial.turns(before);
            let mut rate_rad_s = largest(moving.rates.as_slice().iter().copied());
            beside += u32::from(moving.clearance_hit && rate_rad_s > 2.0 * LOSS_RAD_S);
            let mut stopping = trial.ask(Request::Stop);
            for turn in 1.. {
                let left_rad_s = largest(stopping.rates.as_slice().iter().copied());
                let lost_rad_s = rate_rad_s - left_rad_s;
                assert!(
                    lost_rad_s < LOSS_RAD_S + 1e-9,
                    "{interface:?} after {before}: {lost_rad_s} rad/s"
                );
                let clearance_m = trial.plant.truth().clearance_m(&trial.at_release, &ball);
                assert!(clearance_m > 0.0079, "{clearance_m} m");
                if left_rad_s == 0.0 {
                    longest = longest.max(turn);
                    break;
                }
                rate_rad_s = left_rad_s;
                stopping = trial.turn();
            }
        }
        println!("{interface:?}: {beside} beside the ball, {longest} periods");
        assert!(beside > 2 && longest > 4);
    }
}
