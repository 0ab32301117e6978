//! Cycles after a stall of the daemon or of its exchange: the last command has run out, and the driver has
//! brought the robot to rest.

use cdcr_controller::plant::RobotPreset;
use cdcr_controller::robot::BendRates;
use cdcr_controller::safety::{Mode, Request};

use super::trial::{PERIOD_S, Trial};
use super::{DIRECT, MOST_RAD_S2, bits, is_at_rest};
use crate::config::Interface;

const BOTH: [Interface; 2] = [Interface::Position, Interface::Velocity];
/// Releases without a cycle: the next one is exactly when a command runs out, and long after.
const STALLS: [u32; 2] = [2, 10];

fn fastest(rates: &BendRates) -> f64 {
    let rates = rates.as_slice().iter();
    rates.fold(0.0, |most, rate| rate.abs().max(most))
}

/// A robot at its largest rates.
fn moving(interface: Interface) -> Trial {
    let mut trial = Trial::with(interface, RobotPreset::Laboratory.flaws(), DIRECT);
    trial.turns(3);
    trial.begin_tracking();
    assert!(fastest(&trial.turns(12).rates) > 1.5);
    trial
}

#[test]
fn rates_grow_from_rest() {
    for interface in BOTH {
        for stall in STALLS {
            let mut trial = moving(interface);
            // Within its validity, the last command continues.
            assert!(fastest(&trial.late_turn(1).rates) > 1.5);
            let record = trial.cycle(stall);
            assert!(matches!(record.mode, Mode::Tracking { .. }));
            assert_eq!(
                fastest(&record.previous_rates),
                0.0,
                "{interface:?}, {stall}"
            );
            assert!(fastest(&record.rates) <= MOST_RAD_S2 * PERIOD_S * (1.0 + 1e-12));
        }
    }
}

/// Positions stand at their target from the next release on, however long the command is valid.
#[test]
fn rates_of_positions_that_stood_grow_from_rest() {
    for stall in STALLS {
        let more = format!("command_valid_ms = 100.0\n{DIRECT}");
        let flaws = RobotPreset::Laboratory.flaws();
        let mut trial = Trial::with(Interface::Position, flaws, &more);
        trial.turns(3);
        trial.begin_tracking();
        assert!(fastest(&trial.turns(12).rates) > 1.5);
        assert!(fastest(&trial.late_turn(1).rates) > 1.5);
        let record = trial.cycle(stall);
        assert!(fastest(&record.rates) <= MOST_RAD_S2 * PERIOD_S * (1.0 + 1e-12));
    }
}

/// Whichever command leaves when the exchange continues.
#[test]
fn rates_grow_from_rest_while_the_exchange_is_held_up() {
    for interface in BOTH {
        for (cycles, skipped) in [(3, 0), (4, 0), (5, 0), (8, 0), (2, 1)] {
            let mut trial = moving(interface);
            trial.is_held_up = true;
            for _ in 0..cycles {
                trial.cycle(skipped);
            }
            let fastest = fastest(&trial.last().rates);
            assert!(
                fastest <= MOST_RAD_S2 * PERIOD_S * (1.0 + 1e-12),
                "{cycles}: {fastest}"
            );
        }
    }
}

#[test]
fn a_ramp_does_not_begin_again_while_the_exchange_is_held_up() {
    for interface in BOTH {
        for cycles in 3..6 {
            let mut trial = moving(interface);
            assert!(!is_at_rest(&trial.ask(Request::Stop)));
            let sent = trial.sent.unwrap();
            trial.is_held_up = true;
            for _ in 0..cycles {
                trial.cycle(0);
            }
            assert!(is_at_rest(&trial.last()));
            // The robot stands where the command that left led it.
            if cycles > 3 && interface == Interface::Position {
                let led_rad = &sent.bend_target_rad[..trial.target_rad.len()];
                assert_eq!(bits(&trial.target_rad), bits(led_rad));
            }
        }
    }
}

#[test]
fn a_ramp_does_not_begin_again() {
    for interface in BOTH {
        for stall in STALLS {
            let mut trial = moving(interface);
            assert!(!is_at_rest(&trial.ask(Request::Stop)));
            assert!(is_at_rest(&trial.cycle(stall)), "{interface:?}, {stall}");
        }
    }
}

/// Stalls inside a cycle: the time \[ms\] that each reading of the clock takes, and whether the last command has run
/// out before the solver begins.
const INSIDE: [(Interface, u64, bool); 4] = [
    (Interface::Position, 11, true),
    (Interface::Velocity, 11, true),
    (Interface::Position, 3, false),
    (Interface::Velocity, 6, false),
];

#[test]
fn rates_grow_from_rest_after_a_stall_inside_the_cycle() {
    for (interface, reading_ms, knows) in INSIDE {
        let mut trial = moving(interface);
        trial.clock.step_ns.set(reading_ms * 1_000_000);
        let record = trial.turn();
        assert!(matches!(record.mode, Mode::Tracking { .. }));
        // The solver began with the rates that were valid then.
        let reported = fastest(&record.previous_rates);
        assert_eq!(
            reported == 0.0,
            knows,
            "{interface:?}, {reading_ms}: {reported}"
        );
        assert!(fastest(&record.rates) <= MOST_RAD_S2 * PERIOD_S * (1.0 + 1e-12));
    }
}

#[test]
fn a_ramp_does_not_begin_again_after_a_stall_inside_the_cycle() {
    for (interface, reading_ms, knows) in INSIDE {
        let mut trial = moving(interface);
        assert!(!is_at_rest(&trial.ask(Request::Stop)));
        trial.clock.step_ns.set(reading_ms * 1_000_000);
        let record = trial.turn();
        let reported = fastest(&record.previous_rates);
        assert_eq!(
            reported == 0.0,
            knows,
            "{interface:?}, {reading_ms}: {reported}"
        );
        assert!(record.ran_out_in_solve);
        assert!(is_at_rest(&record), "{interface:?}, {reading_ms}");
    }
}

/// The first command after rest may not have left when the next one follows without a gather: whichever leaves, the
/// robot begins with one step.
#[test]
fn rates_begin_with_one_step_while_the_exchange_is_held_up() {
    for interface in BOTH {
        let mut trial = Trial::with(interface, RobotPreset::Laboratory.flaws(), DIRECT);
        trial.turns(3);
        trial.is_held_up = true;
        trial.begin_tracking();
        let mut most = 0.0_f64;
        for _ in 0..3 {
            let fastest = fastest(&trial.last().rates);
            most = most.max(fastest);
            assert!(
                fastest <= MOST_RAD_S2 * PERIOD_S * (1.0 + 1e-12),
                "{interface:?}: {fastest}"
            );
            trial.cycle(0);
        }
        assert!(most > 0.0, "{interface:?}: it begins to move");
    }
}
