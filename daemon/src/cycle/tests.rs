//! Cycles of a robot that differs from its model.

mod approach;
mod bend_limit;
mod common_mode;
mod contact;
mod core_budget;
mod lead;
mod play;
mod rehearsal;
mod reset;
mod stall;
mod tip_frame;
mod tip_margin;
mod trial;
mod unsent;

use cdcr_controller::estimator::Actuator;
use cdcr_controller::plant::{Flaws, RobotPreset};
use cdcr_controller::safety::{Refusal, Request};
use nalgebra::Vector3;

use super::*;
use crate::config::Interface;
use crate::handover::{MeasurementUse, TipCause};
use trial::{PERIOD_S, TRACK, Trial};

/// A distant reference is followed at once.
const DIRECT: &str = "[motion]\napproach = \"direct\"\n";

/// The solver's cost ignores obstacles, so that the guard has to act.
const BLIND_DIRECT: &str = "[controller]\nobstacle_step_penalty = 0.0\nobstacle_slope_penalty = 0.0\n[motion]\napproach = \"direct\"\n";

fn is_at_rest(record: &CycleRecord) -> bool {
    record.rates.as_slice().iter().all(|rate| *rate == 0.0)
}

fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|value| value.to_bits()).collect()
}

/// The driver measures 0.1 mm beside its command, and the motors come to rest beside it. For a minute in each
/// mode of rest no command moves the robot, to the bit.
#[test]
fn a_resting_robot_with_offset_and_droop_does_not_creep() {
    for interface in [Interface::Position, Interface::Velocity] {
        for asked in [Request::Hold, Request::Stop] {
            let mut trial = Trial::new(interface);
            trial.turns(3);
            trial.begin_tracking();
            trial.turns(600);
            trial.ask(asked);
            assert!(is_at_rest(&trial.turns(100)));
            let target_rad = bits(&trial.target_rad);
            for _ in 0..12_000 {
                assert!(is_at_rest(&trial.turn()));
                assert_eq!(
                    bits(&trial.target_rad),
                    target_rad,
                    "{interface:?} {asked:?}"
                );
            }
            // The robot sags when the motors release it, and no command reacts: a fault.
            if interface == Interface::Position && asked == Request::Hold {
                trial.plant.set_flaws(Flaws {
                    offset_m: 0.01,
                    ..RobotPreset::Laboratory.flaws()
                });
                let faulted = trial.turns(10);
                assert!(
                    matches!(faulted.mode, Mode::Faulted { .. }),
                    "{:?}",
                    faulted.mode
                );
                for _ in 0..12_000 {
                    assert!(is_at_rest(&trial.turn()));
                    assert_eq!(bits(&trial.target_rad), target_rad);
                }
            }
        }
    }
}

/// Encoder noise, a fixed reference, and three of six rates that do not move the tip. With the default rate
/// weight of a driver's robot they rest, too. With the paper's cost, weight 0, the bends drift around the
/// tip.
#[test]
fn a_noisy_robot_that_rests_at_a_point_does_not_turn_about_its_tip() {
    let lag = "[actuator]\ntime_constant_ms = 20.0\n";
    for interface in [Interface::Position, Interface::Velocity] {
        let fastest_rad_s = [None, Some(0.0)].map(|rate_weight| {
            let flaws = RobotPreset::Laboratory.flaws();
            let mut trial = Trial::with(interface, flaws, &format!("{DIRECT}{lag}"));
            if let Some(rate_weight) = rate_weight {
                trial.inputs.settings.nmpc.rate_weight = rate_weight.into();
                trial.inputs.settings_revision += 1;
            }
            trial.turns(3);
            trial.feed_line([0.2, -0.1, 0.8], [0.0; 3], 0.0);
            trial.ask(TRACK);
            trial.turns(1600);
            let rates = (0..200).map(|_| trial.turn().rates);
            let largest = |rates: BendRates| {
                rates
                    .as_slice()
                    .iter()
                    .fold(0.0, |most: f64, rate| rate.abs().max(most))
            };
            rates.map(largest).fold(0.0, f64::max)
        });
        println!("{interface:?}: {fastest_rad_s:?} rad/s");
        assert!(fastest_rad_s[0] < 0.01 && fastest_rad_s[1] > 0.02);
    }
}

/// Motors with a lag that the configuration does not contain, with either interface: the loop is stable and
/// learns the offset. Without noise, which reverses small rates.
#[test]
fn tracking_with_lagging_motors_does_not_oscillate() {
    for (interface, lag_s) in [(Interface::Position, 0.03), (Interface::Velocity, 0.025)] {
        let flaws = Flaws {
            actuator: Actuator {
                time_constant_s: lag_s,
                ..Actuator::IDEAL
            },
            noise_m: 0.0,
            ..RobotPreset::Laboratory.flaws()
        };
        let (reversals, largest_m) = reversals(&mut Trial::with(interface, flaws, ""));
        println!("{interface:?}: {reversals} reversals, {largest_m} m");
        // Six components, a circle of 4.2 s: five turns reverse each component about five times.
        assert!(reversals < 100, "{reversals} reversals");
        assert!(largest_m < 0.01, "{largest_m} m");
    }
}

/// A motor lag in the configuration does not count as an error of the robot.
#[test]
fn motors_that_are_known_are_led_and_believed() {
    for interface in [Interface::Position, Interface::Velocity] {
        let flaws = Flaws {
            actuator: Actuator {
                delay_s: 0.015,
                time_constant_s: 0.03,
                play_m: 0.0,
            },
            ..Flaws::default()
        };
        let known = "[actuator]\ndelay_ms = 15.0\ntime_constant_ms = 30.0\n";
        let errors_m = ["", known].map(|more| {
            let (_, largest_m) = reversals(&mut Trial::with(interface, flaws, more));
            largest_m
        });
        println!("{interface:?}: {errors_m:?}");
        // The rest is half the square of the time constant times the acceleration.
        assert!(
            errors_m[1] < 3e-4 && errors_m[0] > 5.0 * errors_m[1],
            "{errors_m:?}"
        );
    }
}

/// Sections longer than their model, and a load: only a tip sensor brings the tip to its reference. Its jumps
/// are ignored, and a frozen sensor is no longer used; neither affects the command.
#[test]
fn a_tip_that_is_measured_beside_the_cables_is_where_it_shall_be() {
    let flaws = Flaws {
        length_error: 0.05,
        payload_rad: [0.015, 0.0],
        tip_noise_m: 3e-4,
        noise_m: 3e-5,
        ..Flaws::default()
    };
    let mut blind = Trial::with(Interface::Position, flaws, DIRECT);
    let (_, far_m) = reversals(&mut blind);
    let mut trial = Trial::with(Interface::Position, flaws, DIRECT);
    trial.measures_tip = true;
    // The bends equal their measurement from the first cycle on.
    let first = trial.turn();
    let bends = trial.measured();
    let pairs = first.configuration.as_slice().iter().zip(bends.as_slice());
    assert!(
        pairs.into_iter().all(|(a, b)| (a - b).abs() < 1e-9),
        "{bends:?}"
    );
    let (_, near_m) = reversals(&mut trial);
    println!("{far_m} m, {near_m} m");
    // On a circle of 0.2 m at 0.3 m/s the model error changes by 0.1 m/s.
    assert!(far_m > 0.05 && near_m < 0.004, "{far_m} {near_m}");
    assert_eq!(trial.turn().tip_use, MeasurementUse::Used);

    // A jump does not affect the command: it equals that with a silent sensor.
    trial.tip_error_m = Vector3::new(0.5, 0.0, 0.0);
    let jump = trial.turn();
    assert_eq!(jump.tip_unused, Some(TipCause::Jumps));
    let mut silent = Trial::with(Interface::Position, flaws, DIRECT);
    silent.measures_tip = true;
    silent.turn();
    reversals(&mut silent);
    silent.turn();
    silent.measures_tip = false;
    let rates = silent.turn().rates;
    assert_eq!(bits(jump.rates.as_slice()), bits(rates.as_slice()));
    trial.tip_error_m = Vector3::zeros();
    assert_eq!(trial.turn().tip_use, MeasurementUse::Used);
    // A silent sensor: the offset moves on for one and a half measurement intervals, then stays. The jump
    // made the last interval two cycles long.
    trial.measures_tip = false;
    let before_m = trial.turns(3).tip_offset_m;
    let after = trial.turns(200);
    assert_eq!(
        (after.tip_use, after.tip_offset_m),
        (MeasurementUse::Repeated, before_m)
    );
    assert!(matches!(after.mode, Mode::Tracking { .. }));
    // The sensor returns after a second in which the robot moved: the offset changes without a jump.
    trial.measures_tip = true;
    let back_m = trial.turn().tip_offset_m;
    assert!((back_m - before_m).norm() < 2.1e-3, "{back_m} {before_m}");
    trial.turns(100);
    // A frozen sensor while the robot moves: its measurements are ignored.
    let before_m = trial.turn().tip_offset_m;
    trial.frozen_tip_m = Some(trial.plant.tip_m());
    let frozen = trial.turns(200);
    assert_eq!(frozen.tip_unused, Some(TipCause::Frozen));
    assert!(
        (frozen.tip_offset_m - before_m).norm() < 2e-3,
        "{before_m} {}",
        frozen.tip_offset_m
    );
    trial.frozen_tip_m = None;
    // A permanent jump: not used until a reset, or another sensor, which continues from the present offset.
    trial.measures_tip = true;
    trial.tip_error_m = Vector3::new(1.5, 0.0, 0.0);
    trial.turns(5);
    trial.tip_error_m = Vector3::zeros();
    let wrong = trial.turns(5);
    assert_eq!(wrong.tip_unused, Some(TipCause::Jumped));
    trial.inputs.tip_sensors += 1;
    let other = trial.turn();
    assert_eq!(other.tip_use, MeasurementUse::Used);
    let stepped_m = (other.tip_offset_m - wrong.tip_offset_m).norm();
    assert!(stepped_m < 2e-3, "{stepped_m} m");
    trial.tip_error_m = Vector3::new(1.5, 0.0, 0.0);
    trial.turns(5);
    trial.tip_error_m = Vector3::zeros();
    assert_eq!(trial.turns(5).tip_use, MeasurementUse::Implausible);
    trial.ask(Request::Stop);
    trial.turns(100);
    trial.ask(Request::Reset);
    assert_eq!(trial.turns(5).tip_use, MeasurementUse::Used);
}

/// Each simulated robot tracks with either interface, and rests when commands expire.
#[test]
fn every_simulated_robot_tracks_and_rests_without_commands() {
    for preset in RobotPreset::ALL {
        for interface in [Interface::Position, Interface::Velocity] {
            let mut trial = Trial::simulated(interface, preset, "");
            trial.turns(3);
            trial.begin_tracking();
            let tracked = trial.turns(1200);
            assert!(
                matches!(tracked.mode, Mode::Tracking { .. }),
                "{preset:?} {interface:?} {:?}",
                tracked.mode
            );
            let error_m = (tracked.tip.position_m - tracked.reference.position_m).norm();
            assert!(error_m < 0.02, "{preset:?} {interface:?}: {error_m} m");
            // Two seconds without commands: then the robot stands, whatever the last command was.
            let after = trial.cycle(400);
            let later = trial.cycle(1);
            let moved = after
                .present
                .as_slice()
                .iter()
                .zip(later.present.as_slice());
            let moved_rad = moved.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(
                moved_rad < 0.05,
                "{preset:?} {interface:?}: {moved_rad} rad"
            );
        }
    }
}

/// Reversals of the rates on a circle, and the largest distance to it \[m\].
fn reversals(trial: &mut Trial) -> (usize, f64) {
    trial.turns(3);
    trial.begin_tracking();
    trial.turns(1000);
    let (mut reversals, mut before, mut largest_m) = (0, BendRates::zero(3), 0.0_f64);
    for _ in 0..2000 {
        let record = trial.turn();
        assert!(
            matches!(record.mode, Mode::Tracking { .. }),
            "{:?}",
            record.mode
        );
        largest_m = largest_m.max((trial.tip_m - record.reference.position_m).norm());
        let pairs = record.rates.as_slice().iter().zip(before.as_slice());
        reversals += pairs.filter(|(now, before)| **now * **before < 0.0).count();
        before = record.rates;
    }
    (reversals, largest_m)
}

/// A robot that does not move is a fault with its cause; after a reset, control begins at its position.
#[test]
fn a_robot_that_does_not_follow_is_a_fault_and_a_reset_begins_where_it_is() {
    for interface in [Interface::Position, Interface::Velocity] {
        // Compared exactly; minimal noise, because a constant measurement counts as frozen.
        let flaws = Flaws {
            noise_m: 1e-9,
            ..Flaws::default()
        };
        let mut trial = Trial::with(interface, flaws, "");
        trial.stands = true;
        trial.turns(3);
        trial.begin_tracking();
        let mut record = trial.turn();
        while !record.mode.is_latched() {
            record = trial.turn();
            assert!(record.release.cycle < 5000);
        }
        assert_eq!(
            record.mode.reason(),
            Reason::FollowingError,
            "{interface:?}"
        );
        assert!(record.following.largest_rad() > record.policy.following.fault_rad);
        assert!(is_at_rest(&trial.turns(100)));
        let record = trial.ask(Request::ResetAcceptingPose);
        assert_eq!(record.answers[0].unwrap().outcome, Ok(()));
        assert_eq!(
            record.mode,
            Mode::Holding {
                reason: Reason::Request
            }
        );
        // The commanded position moves there.
        trial.turns(200);
        assert!(
            trial.target_rad.iter().all(|bend| bend.abs() < 1e-5),
            "{:?}",
            trial.target_rad
        );
        assert!(trial.turns(100).following.largest_rad() < 1e-3);
    }
}

/// A reset on the ramp: the commanded position continues along the ramp, and control begins at the robot's
/// position once it rests.
#[test]
fn a_reset_on_the_ramp_does_not_step_the_commanded_position() {
    let mut trial = Trial::with(Interface::Position, RobotPreset::Laboratory.flaws(), DIRECT);
    trial.turns(3);
    trial.begin_tracking();
    // In motion to the first point, which is far from the straight robot.
    let fastest = trial
        .turns(12)
        .rates
        .as_slice()
        .iter()
        .fold(0.0_f64, |most, rate| most.max(rate.abs()));
    assert!(fastest > 0.5, "{fastest} rad/s");
    trial.ask(Request::Stop);
    let mut before = trial.target_rad.clone();
    let mut record = trial.ask(Request::Reset);
    assert_eq!(record.answers[0].unwrap().outcome, Ok(()));
    let mut ramp = 0;
    while !is_at_rest(&record) {
        for (i, before) in before.iter().enumerate() {
            let moved = before + PERIOD_S * record.rates.as_slice()[i];
            assert_eq!(trial.target_rad[i].to_bits(), moved.to_bits());
        }
        before.clone_from(&trial.target_rad);
        record = trial.turn();
        ramp += 1;
    }
    assert!(ramp > 1, "{ramp}");
    // The remaining following error is adopted once.
    trial.turns(2);
    let target_rad = bits(&trial.target_rad);
    trial.turns(100);
    assert_eq!(bits(&trial.target_rad), target_rad);
    assert!(trial.turn().following.largest_rad() < 0.1);
}

/// Each message's position is that of the previous message plus its speeds times the period.
#[test]
fn positions_are_the_integral_of_the_speeds() {
    let mut trial = Trial::new(Interface::Position);
    trial.turns(3);
    trial.begin_tracking();
    for turn in 0..500_u32 {
        let before = trial.target_rad.clone();
        let record = if turn % 50 == 49 {
            trial.cycle(3)
        } else {
            trial.turn()
        };
        for (i, before) in before.iter().enumerate() {
            let moved = before + PERIOD_S * record.rates.as_slice()[i];
            assert_eq!(trial.target_rad[i].to_bits(), moved.to_bits());
        }
    }
}

#[test]
fn no_rate_grows_faster_than_the_acceleration() {
    let mut trial = Trial::with(Interface::Position, RobotPreset::Laboratory.flaws(), DIRECT);
    trial.turns(3);
    // The first point is far from the straight robot: without the limit its rates would jump to the maximum.
    // The plan contains the limit and uses it fully.
    trial.begin_tracking();
    let mut most_grown = 0.0_f64;
    for _ in 0..200 {
        let record = trial.turn();
        let most = MOST_RAD_S2 * PERIOD_S;
        for (rate, before) in record
            .rates
            .as_slice()
            .iter()
            .zip(record.previous_rates.as_slice())
        {
            let grown = if rate * before > 0.0 {
                rate.abs() - before.abs()
            } else {
                rate.abs()
            };
            assert!(grown <= most * (1.0 + 1e-12), "{before} → {rate}");
            most_grown = most_grown.max(grown / most);
        }
    }
    assert!(most_grown > 0.999, "{most_grown}");
}

/// Default of a robot behind a driver.
const MOST_RAD_S2: f64 = Policy::ACCELERATION_RAD_S2;

#[test]
fn what_the_inputs_say_makes_a_moving_robot_hold_or_stop() {
    let mut trial = Trial::new(Interface::Position);
    trial.turns(3);
    trial.begin_tracking();
    trial.turns(100);
    // No further gather: tracking continues while a command is valid.
    let modes: Vec<_> = (0..4).map(|_| trial.cycle(0).mode).collect();
    assert!(
        modes[..3]
            .iter()
            .all(|mode| matches!(mode, Mode::Tracking { .. })),
        "{modes:?}"
    );
    assert_eq!(
        modes[3],
        Mode::Holding {
            reason: Reason::InputsStale
        }
    );
    trial.turn();
    trial.begin_tracking();
    trial.inputs.obstacle_source_silent = true;
    assert_eq!(
        trial.turn().mode,
        Mode::Holding {
            reason: Reason::ObstacleSourceSilent
        }
    );
    let refused = trial.ask(TRACK).answers[0].unwrap().outcome;
    assert_eq!(refused, Err(Refusal::Waits));
    trial.inputs.obstacle_source_silent = false;
    trial.turn();
    trial.begin_tracking();
    trial.inputs.suspends += 1;
    assert_eq!(
        trial.turn().mode,
        Mode::Stopped {
            reason: Reason::Suspended
        }
    );
    assert_eq!(
        trial.ask(Request::Reset).mode,
        Mode::Holding {
            reason: Reason::Request
        }
    );
}

/// A stop arrives by the ring one cycle before the inputs that count it. A client that has its answer may
/// reset the robot.
#[test]
fn a_stop_that_was_carried_out_is_not_carried_out_again() {
    let mut trial = Trial::new(Interface::Velocity);
    trial.turn();
    assert!(trial.ask(Request::Stop).mode.is_latched());
    trial.inputs.stops += 1;
    assert!(!trial.ask(Request::Reset).mode.is_latched());
}
