//! The solver's share of a period.

use std::path::Path;

use super::trial::{Trial, clock};
use crate::config::{Config, Interface};
use crate::cycle::Cycle;
use crate::handover::CycleRecord;
use crate::link::CycleRobot;

#[test]
fn the_solver_leaves_what_the_rest_of_the_period_was_measured_to_take() {
    let mut trial = Trial::new(Interface::Position);
    trial.turns(20);
    trial.begin_tracking();
    let until_ns = |record: &CycleRecord| record.solve_until_ns - record.release.release_ns;
    assert_eq!(until_ns(&trial.turn()), 4_500_000, "a tenth by default");
    // A few long ones are stalls.
    for _ in 0..3 {
        trial.turn();
        trial.rest_after(3_000_000);
    }
    assert_eq!(until_ns(&trial.turn()), 4_500_000);
    for _ in 0..4 {
        trial.turn();
        trial.rest_after(280_000);
    }
    trial.inputs.exchange_ns = 150_000;
    let record = trial.turn();
    assert_eq!(record.costs.after_solve_ns, 280_100, "a look takes 100 ns");
    // 92.5 % of the period from the start, which is 0.02 ms late, minus the rehearsal.
    let spent_ns = 75_000 + 280_100 + 150_000;
    assert_eq!(until_ns(&record), 4_625_000 + 20_000 - spent_ns);
    assert!(record.solve_end_ns <= record.solve_until_ns);
    // Interruptions of the thread do not count, however many.
    for turn in 1..200 {
        trial.turn();
        trial.rest_after(if turn % 3 == 0 { 9_000_000 } else { 280_000 });
        trial.inputs.interruptions += u64::from(turn % 3 == 0);
    }
    assert_eq!(trial.turn().costs.after_solve_ns, 280_100);
    // Frequent costs are not stalls and count in full; half as much again is reserved.
    for _ in 0..200 {
        trial.turn();
        trial.rest_after(1_500_000);
    }
    assert_eq!(until_ns(&trial.turn()), 5_000_000 - 3 * 1_500_100 / 2);
}

#[test]
fn a_cycle_that_cannot_fit_is_refused_with_the_numbers() {
    let check = |text: &str| {
        let validated = Config::parse(text, Path::new("trial")).unwrap();
        let cycle = Cycle::new(&validated, CycleRobot::Driver).unwrap();
        // Each check of the clock takes 100 ns, and so does a cycle.
        cycle.with_kernel_share(0.9).check_that_it_fits(&clock())
    };
    assert_eq!(check(""), Ok(()));
    let short = "[cycle]\nperiod_ms = 0.1\ngather_lead_ms = 0.05\n";
    assert_eq!(check(short), Ok(()));
    let error = check(&format!("{short}[realtime]\nspin_us = 50.0\n")).unwrap_err();
    for word in [
        "cycle.period_ms = 0.1",
        "sections: 3",
        "0.050 ms before the release",
        "0.040 ms for the exchange",
    ] {
        assert!(error.contains(word), "{error}");
    }
}
