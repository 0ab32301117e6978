//! A camera that takes its time to evaluate a picture, beside encoders.

use cdcr_controller::plant::{Flaws, RobotPreset};

use super::DIRECT;
use super::trial::{PERIOD_S, TRACK, Trial};
use crate::config::Interface;
use crate::handover::MeasurementUse;

const SPEED_M_S: f64 = 0.15;

/// Largest distance of the true tip from a circle at [`SPEED_M_S`], once the tip offset is learnt \[m\].
fn error_m(interface: Interface, age_cycles: usize) -> f64 {
    let flaws = Flaws {
        length_error: 0.03,
        tip_noise_m: 3e-4,
        ..RobotPreset::Laboratory.flaws()
    };
    let mut trial = Trial::with(interface, flaws, DIRECT);
    trial.measures_tip = true;
    trial.tip_age_cycles = age_cycles;
    trial.turns(300);
    trial.feed_circle(SPEED_M_S / 1.5, 20.0);
    trial.ask(TRACK);
    trial.turns(1500);
    let mut largest_m = 0.0_f64;
    for _ in 0..2000 {
        let record = trial.turn();
        assert_eq!(record.tip_use, MeasurementUse::Used);
        let goal_m = record.reference.position_m;
        largest_m = largest_m.max((trial.tip_m - goal_m).norm());
    }
    println!("{interface:?}, {} ms: {largest_m} m", 5 * age_cycles);
    largest_m
}

#[test]
fn the_age_of_a_tip_is_compensated() {
    for interface in [Interface::Velocity, Interface::Position] {
        let fresh_m = error_m(interface, 0);
        for age_cycles in [12, 30, 60, 100] {
            let old_m = error_m(interface, age_cycles);
            // Of the way of the tip in this time.
            let way_m = SPEED_M_S * PERIOD_S * age_cycles as f64;
            assert!(old_m < fresh_m + 0.06 * way_m, "{old_m}, {fresh_m}");
        }
    }
}
