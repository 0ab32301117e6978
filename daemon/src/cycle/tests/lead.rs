//! Cycles of a robot whose motors lag behind their commands by a known time.

use cdcr_controller::estimator::Actuator;
use cdcr_controller::plant::Flaws;
use cdcr_controller::safety::{Refusal, Request};
use nalgebra::Vector3;

use super::super::*;
use super::is_at_rest;
use super::trial::{BEGIN_NS, PERIOD_NS, TRACK, Trial};
use crate::config::Interface;

const INTERFACES: [Interface; 2] = [Interface::Position, Interface::Velocity];

/// Motors with a lag of 0.15 s; `known` is the configuration of it.
fn lagging(interface: Interface, known: &str) -> Trial {
    let flaws = Flaws {
        actuator: Actuator {
            delay_s: 0.05,
            time_constant_s: 0.1,
            play_m: 0.0,
        },
        // Minimal noise, because a constant measurement counts as frozen.
        noise_m: 1e-9,
        ..Flaws::default()
    };
    Trial::with(interface, flaws, known)
}

const KNOWN: &str = "[actuator]\ndelay_ms = 50.0\ntime_constant_ms = 100.0\n";

fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |most, value| value.abs().max(most))
}

fn turns_until_latched(trial: &mut Trial) -> CycleRecord {
    loop {
        let record = trial.turn();
        if record.mode.is_latched() {
            return record;
        }
        assert!(record.release.cycle < 5000);
    }
}

/// A robot is held fast, reset and tracked before the end of its motors' motion: control begins at its
/// position. A commanded position moves there first.
#[test]
fn track_directly_after_a_reset_begins_where_the_robot_is() {
    for interface in INTERFACES {
        let mut trial = lagging(interface, KNOWN);
        trial.stands = true;
        trial.turns(3);
        trial.begin_tracking();
        let faulted = turns_until_latched(&mut trial);
        assert_eq!(faulted.mode.reason(), Reason::FollowingError);
        if interface == Interface::Position {
            assert!(largest(faulted.commanded.as_slice()) > 0.3);
        }
        let rest = trial.turns(60);
        let ends = rest.present.as_slice().iter();
        let mut ways = ends.zip(rest.configuration.as_slice());
        assert!(is_at_rest(&rest) && ways.any(|(here, end)| (end - here).abs() > 2e-3));
        let reset = trial.ask(Request::ResetAcceptingPose);
        assert_eq!(reset.answers[0].unwrap().outcome, Ok(()));
        trial.stands = false;
        if interface == Interface::Position {
            // Not before the commanded position has moved to the robot.
            let outcome = trial.ask(TRACK).answers[0].unwrap().outcome;
            assert_eq!(outcome, Err(Refusal::Waits));
            trial.turns(600);
        }
        trial.begin_tracking();
        let begun = trial.turn();
        let pairs = begun.commanded.as_slice().iter();
        let ends = pairs.zip(begun.configuration.as_slice());
        let apart: Vec<_> = ends.map(|(commanded, end)| commanded - end).collect();
        assert!(largest(&apart) < 0.05, "{interface:?}: {apart:?}");
        for _ in 0..600 {
            let record = trial.turn();
            let mode = record.mode;
            assert!(matches!(mode, Mode::Tracking { .. }), "{mode:?}");
        }
        let record = trial.turn();
        let error_m = (trial.tip_m - record.reference.position_m).norm();
        assert!(error_m < 0.01, "{interface:?}: {error_m} m");
    }
}

/// A known lag is not a following error; an unknown lag is.
#[test]
fn a_known_lag_is_no_following_error_and_an_unknown_one_is() {
    const SHORT: &str = "[safety]\nfollowing_lag_ms = 10.0\n";
    for interface in INTERFACES {
        let errors_rad = ["", KNOWN].map(|known| {
            let mut trial = lagging(interface, &format!("{known}{SHORT}"));
            trial.turns(3);
            trial.begin_tracking();
            let following = (0..1500).map(|_| trial.turn().following.largest_rad());
            following.fold(0.0, f64::max)
        });
        println!("{interface:?}: {errors_rad:?}");
        let rules = Trial::new(interface).turn().policy.following;
        assert!(errors_rad[1] < rules.warning_rad, "{errors_rad:?}");
        assert!(errors_rad[0] > rules.warning_rad, "{errors_rad:?}");
        // A robot that stands still is found all the same.
        let mut trial = lagging(interface, &format!("{KNOWN}{SHORT}"));
        trial.turns(3);
        trial.begin_tracking();
        trial.turns(400);
        trial.stands = true;
        let mode = turns_until_latched(&mut trial).mode;
        assert_eq!(mode.reason(), Reason::FollowingError, "{interface:?}");
    }
}

/// A ball hits the tracking robot. The reported clearance is that of the true robot and ball, 0.15 s before
/// the time at which the guard compares them. Contact is a fault in the next cycle. The ball is faster than the robot, which
/// moves out of its way.
#[test]
fn contact_is_a_fault_where_robot_and_obstacle_are() {
    const SPEED_M_S: f64 = 1.5;
    // As wide as the circle: it cannot miss the robot.
    const RADIUS_M: f64 = 0.25;
    for interface in INTERFACES {
        // The solver ignores the obstacle: otherwise it would avoid it.
        let blind = "[controller]\nobstacle_step_penalty = 0.0\nobstacle_slope_penalty = 0.0\n";
        let mut trial = lagging(interface, &format!("{KNOWN}{blind}"));
        trial.turns(3);
        trial.begin_tracking();
        trial.turns(600);
        let centre_m = Vector3::new(0.0, 0.0, trial.tip_m.z + RADIUS_M + 0.3);
        let down_m_s = Vector3::new(0.0, 0.0, -SPEED_M_S);
        let placed_ns = BEGIN_NS + trial.next() * PERIOD_NS;
        let ball = trial.put_moving_ball(centre_m, RADIUS_M, down_m_s);
        let robot = trial.plant.truth().clone();
        let (mut farthest_off_m, mut led_off_m) = (0.0_f64, 0.0_f64);
        let mut broken = false;
        loop {
            let record = trial.turn();
            // The fault follows in the cycle after the one that finds contact.
            assert_eq!(record.mode.is_latched(), broken, "{:?}", record.mode);
            if broken {
                assert_eq!(record.mode.reason(), Reason::ClearanceBroken);
                break;
            }
            let passed_s = (record.release.release_ns - placed_ns) as f64 * 1e-9;
            let true_m = robot.clearance_m(&trial.at_release, &ball.moved(passed_s));
            farthest_off_m = farthest_off_m.max((record.clearance_m - true_m).abs());
            let led = ball.moved(passed_s + 0.15);
            let led_m = robot.clearance_m(&record.configuration, &led);
            led_off_m = led_off_m.max((led_m - true_m).abs());
            broken = record.clearance_m < record.policy.clearance_fault_m;
            assert!(passed_s < 2.0, "{} m", record.clearance_m);
        }
        println!("{interface:?}: {farthest_off_m} m, led {led_off_m} m");
        assert!(farthest_off_m < 1e-3, "{interface:?}: {farthest_off_m} m");
        assert!(led_off_m > 0.05, "{interface:?}: {led_off_m} m");
    }
}
