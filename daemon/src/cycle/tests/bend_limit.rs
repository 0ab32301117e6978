//! A robot at the limit of its bends whose encoders have noise.

use cdcr_controller::plant::Flaws;
use cdcr_controller::safety::{Mode, Reason, Refusal, Request};

use super::trial::{TRACK, Trial};
use super::{DIRECT, is_at_rest};
use crate::config::Interface;

const BEND_MAX_RAD: f64 = 1.2;
/// Distance of the cables from the backbone \[m\].
const RADIUS_M: f64 = 0.004;
/// Noise of the encoders \[m\]: 0.13 and 0.02 rad in the second section at most.
const NOISY_M: f64 = 2e-4;
const QUIET_M: f64 = 3e-5;

/// Two thin sections, at their limits.
fn at_limit(interface: Interface, noise_m: f64) -> Trial {
    let section = format!(
        "[[robot.sections]]\nlength_m = 0.3\ncable_radius_m = {RADIUS_M}\ncable_offset_rad = 0.0\nbend_max_rad = {BEND_MAX_RAD}\nrate_max_rad_s = 2.0\nbody_radius_m = 0.006\n"
    );
    let flaws = Flaws {
        noise_m,
        offset_m: 2e-5,
        droop_m: 2e-5,
        ..Flaws::default()
    };
    let mut trial = Trial::with(interface, flaws, &format!("{DIRECT}{section}{section}"));
    trial.turns(3);
    // Out of reach.
    trial.feed_line([0.05, 0.0, 0.05], [0.0; 3], 0.0);
    trial.ask(TRACK);
    trial.turns(600);
    let bends = trial.plant.configuration();
    let most_rad = bends.bend_rad(0).max(bends.bend_rad(1));
    assert!(most_rad > BEND_MAX_RAD - 0.03, "{bends:?}");
    trial
}

/// Bends one section by hand.
fn bend(trial: &mut Trial, section: usize, [u, v]: [f64; 2]) {
    // The cables of later sections pass it.
    let cables = trial.cable_error_m.iter_mut().enumerate();
    for (cable, error_m) in cables.skip(3 * section) {
        let angle_rad = (cable % 3) as f64 * core::f64::consts::TAU / 3.0;
        *error_m = -RADIUS_M * (u * angle_rad.cos() + v * angle_rad.sin());
    }
}

#[test]
fn noise_at_the_limit_of_a_bend_is_no_fault_and_a_reset_is_granted() {
    for interface in [Interface::Position, Interface::Velocity] {
        let mut trial = at_limit(interface, NOISY_M);
        let mut farthest_rad = 0.0_f64;
        for _ in 0..1000 {
            let mode = trial.turn().mode;
            assert!(
                matches!(mode, Mode::Tracking { .. }),
                "{interface:?} {mode:?}"
            );
            let measured = trial.measured();
            farthest_rad = farthest_rad
                .max(measured.bend_rad(0))
                .max(measured.bend_rad(1));
        }
        // The noise is what it is called.
        assert!(farthest_rad > BEND_MAX_RAD + 0.05, "{farthest_rad}");
        for _ in 0..20 {
            trial.ask(Request::Stop);
            assert!(is_at_rest(&trial.turns(60)));
            let reset = trial.ask(Request::Reset);
            assert_eq!(reset.answers[0].unwrap().outcome, Ok(()), "{interface:?}");
            trial.turns(10);
        }
    }
}

#[test]
fn a_robot_bent_beyond_its_limit_is_a_fault_and_a_reset_is_refused() {
    for interface in [Interface::Position, Interface::Velocity] {
        for (beyond_rad, turns) in [(0.12, 60), (0.2, 4)] {
            let mut trial = at_limit(interface, QUIET_M);
            trial.ask(Request::Hold);
            trial.turns(60);
            let bends = trial.plant.configuration();
            let section = usize::from(bends.bend_rad(1) > bends.bend_rad(0));
            let outwards = bends
                .section(section)
                .map(|part| part / bends.bend_rad(section));
            let mut faulted = trial.last();
            for turn in 1..=20 + turns {
                let bent_rad = beyond_rad * f64::from(turn.min(20)) / 20.0;
                bend(&mut trial, section, outwards.map(|part| part * bent_rad));
                faulted = trial.turn();
            }
            let reason = Reason::LimitBroken;
            assert_eq!(
                faulted.mode,
                Mode::Faulted { reason },
                "{interface:?} {beyond_rad}"
            );
            trial.turns(60);
            for _ in 0..20 {
                let outcome = trial.ask(Request::Reset).answers[0].unwrap().outcome;
                assert_eq!(outcome, Err(Refusal::CauseStands));
            }
        }
    }
}
