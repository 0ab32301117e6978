//! Contact by the measured bends, which an estimate with a lag that is not configured hides.

mod lost_commands;
mod self_contact;

use cdcr_controller::estimator::Actuator;
use cdcr_controller::plant::Flaws;
use cdcr_controller::robot::Obstacle;
use cdcr_controller::safety::{Mode, Reason};
use nalgebra::Vector3;

use super::DIRECT;
use super::trial::{PERIOD_NS, Statements, Trial};
use crate::config::Interface;

/// A robot that tracks a circle through a ball, and the ball.
fn beside_a_ball(interface: Interface, actuator: Actuator, more: &str) -> (Trial, Obstacle) {
    let flaws = Flaws {
        actuator,
        noise_m: 3e-5,
        ..Flaws::default()
    };
    let mut trial = Trial::with(interface, flaws, &format!("{DIRECT}{more}"));
    trial.turns(3);
    let obstacle = trial.put_ball(Vector3::new(0.0, 0.2, 0.837), 0.03);
    trial.begin_tracking();
    (trial, obstacle)
}

/// Motors that obey speeds with a lag that nobody configured: the body meets the ball at half a metre per second, and the fault comes while
/// the estimate still keeps the safe distance.
#[test]
fn a_body_that_comes_near_beside_its_estimate_is_a_fault() {
    let actuator = Actuator {
        delay_s: 0.03,
        time_constant_s: 0.1,
        play_m: 0.0,
    };
    let (mut trial, ball) = beside_a_ball(Interface::Velocity, actuator, "");
    let mut turns = (0..2000).map(|_| trial.turn());
    let latched = turns.find(|record| record.mode.is_latched());
    let record = latched.expect("a fault");
    let plant = &trial.plant;
    let true_m = plant.truth().clearance_m(&plant.configuration(), &ball);
    let (estimated_m, measured_m) = (record.clearance_m, record.measured_clearance_m);
    println!("true clearance {true_m} m, estimated {estimated_m} m, measured {measured_m} m");
    assert_eq!(record.mode.reason(), Reason::ClearanceBroken);
    assert!(estimated_m > 8e-3 && measured_m < 5e-3, "{estimated_m} m");
    assert!(true_m > -8e-3, "{true_m} m");
}

/// Noise, and single measurements that are wrong, are not a contact.
#[test]
fn noise_beside_an_obstacle_is_no_contact() {
    let actuator = Actuator {
        delay_s: 0.0,
        time_constant_s: 0.02,
        play_m: 0.0,
    };
    let known = "[actuator]\ntime_constant_ms = 20.0\n";
    for interface in [Interface::Position, Interface::Velocity] {
        let (mut trial, _) = beside_a_ball(interface, actuator, known);
        let (mut near, mut measured_m) = (0, f64::INFINITY);
        for cycle in 0..2000 {
            trial.cable_error_m[0] = if cycle % 50 == 0 { 3e-3 } else { 0.0 };
            let record = trial.turn();
            let mode = record.mode;
            assert!(matches!(mode, Mode::Tracking { .. }), "{mode:?}");
            near += u32::from(record.clearance_m < 0.012);
            measured_m = measured_m.min(record.measured_clearance_m);
        }
        println!("{interface:?}: measured {measured_m} m, near in {near} cycles");
        assert!(near > 50 && measured_m > 5e-3, "{near} {measured_m}");
    }
}

/// Beside a ball, velocity-controlled motors with this time constant, as configured.
fn beside_a_ball_with_lag(lag_ms: f64) -> (Trial, Obstacle) {
    let actuator = Actuator {
        delay_s: 0.01,
        time_constant_s: lag_ms * 1e-3,
        play_m: 0.0,
    };
    let known = format!("[actuator]\ndelay_ms = 10.0\ntime_constant_ms = {lag_ms:?}\n");
    beside_a_ball(Interface::Velocity, actuator, &known)
}

/// The least true clearance \[m\] beside a ball, and the turn of a contact fault, behind a driver with `lag_ms` that in the last
/// `faulty` of `every` turns may not measure, or not get the commands: its velocity-controlled motors then rest when the last one has run out.
fn beside_a_ball_with_faults(
    [measures, obeys]: [bool; 2],
    (lag_ms, faulty, every): (f64, u32, u32),
    statements: Statements,
) -> (f64, Option<u32>) {
    let (mut trial, ball) = beside_a_ball_with_lag(lag_ms);
    trial.statements = statements;
    let (mut least_m, mut latched) = (f64::INFINITY, None);
    for turn in 0..2000 {
        let record = if turn % every < every - faulty {
            trial.turn()
        } else {
            trial.turn_of(measures, obeys)
        };
        let plant = &trial.plant;
        least_m = least_m.min(plant.truth().clearance_m(&plant.configuration(), &ball));
        if record.mode.is_latched() {
            assert_eq!(record.mode.reason(), Reason::ClearanceBroken);
            latched = Some(turn);
            break;
        }
    }
    println!(
        "measures {measures}, obeys {obeys}, {lag_ms} ms, {faulty} of {every}, {statements:?}: true clearance {least_m} m, fault {latched:?}"
    );
    (least_m, latched)
}

const FAULTS: [(f64, u32, u32); 4] = [(20.0, 6, 24), (20.0, 4, 17), (100.0, 6, 24), (20.0, 8, 60)];
const FALSE: [Statements; 3] = [
    Statements::AlwaysAtRest,
    Statements::Lately(PERIOD_NS),
    Statements::Lately(6 * PERIOD_NS),
];

/// A driver that stands still again and again. Its speeds end with the command; the estimate goes on until it
/// measures again, and then knows where the motors are, with and without a lag that outlasts the stall.
#[test]
fn a_driver_that_stalls_again_and_again_meets_nothing() {
    for faults in FAULTS {
        for statements in [Statements::None, Statements::True] {
            meets_nothing([false, false], faults, statements);
        }
    }
}

fn meets_nothing(driver: [bool; 2], faults: (f64, u32, u32), statements: Statements) {
    let (least_m, latched) = beside_a_ball_with_faults(driver, faults, statements);
    assert_eq!(latched, None, "{least_m} m");
    assert!(least_m > 5e-3, "{least_m} m");
}

/// One that measures while commands are lost must state that its motors rested.
#[test]
fn a_driver_that_loses_commands_and_states_so_meets_nothing() {
    let unstated = FAULTS.map(|faults| {
        meets_nothing([true, false], faults, Statements::True);
        beside_a_ball_with_faults([true, false], faults, Statements::None)
    });
    let has_met = |(least_m, latched): &(f64, Option<u32>)| *least_m < 5e-3 && latched.is_some();
    assert!(unstated.iter().any(has_met), "{unstated:?}");
}

/// Behind motors that obey, rest in silence or lose commands, with and without a sensor that drops out.
#[test]
fn false_statements_change_nothing() {
    for driver in [[true, true], [false, false], [true, false], [false, true]] {
        for faults in [FAULTS[0], FAULTS[2]] {
            let unstated = beside_a_ball_with_faults(driver, faults, Statements::None);
            for statements in FALSE {
                let stated = beside_a_ball_with_faults(driver, faults, statements);
                assert_eq!(stated, unstated);
            }
        }
    }
}
