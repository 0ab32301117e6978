//! Cycles after a stall: the last command has run out, and the driver has brought the robot to rest.

use cdcr_controller::plant::Preset;
use cdcr_controller::robot::BendRates;
use cdcr_controller::safety::{Mode, Request};

use super::trial::{PERIOD_S, Trial};
use super::{DIRECT, MOST_RAD_S2, is_at_rest};
use crate::config::Interface;

const BOTH: [Interface; 2] = [Interface::Position, Interface::Velocity];
/// Releases without a cycle, longer than a command is valid.
const STALL: u32 = 10;

fn fastest(rates: &BendRates) -> f64 {
    let rates = rates.as_slice().iter();
    rates.fold(0.0, |most, rate| rate.abs().max(most))
}

/// A robot at its largest rates.
fn moving(interface: Interface) -> Trial {
    let mut trial = Trial::with(interface, Preset::Laboratory.flaws(), DIRECT);
    trial.turns(3);
    trial.begin_tracking();
    assert!(fastest(&trial.turns(12).rates) > 1.5);
    trial
}

#[test]
fn rates_grow_from_rest() {
    for interface in BOTH {
        let mut trial = moving(interface);
        // Within its validity, the last command continues.
        assert!(fastest(&trial.cycle(1).rates) > 1.5);
        let record = trial.cycle(STALL);
        assert!(matches!(record.mode, Mode::Tracking { .. }));
        assert_eq!(fastest(&record.previous_rates), 0.0);
        assert!(fastest(&record.rates) <= MOST_RAD_S2 * PERIOD_S * (1.0 + 1e-12));
    }
}

#[test]
fn a_ramp_does_not_begin_again() {
    for interface in BOTH {
        let mut trial = moving(interface);
        assert!(!is_at_rest(&trial.ask(Request::Stop)));
        assert!(is_at_rest(&trial.cycle(STALL)));
    }
}
