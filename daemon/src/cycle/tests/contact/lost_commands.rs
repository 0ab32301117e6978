//! A driver of speeds that goes on measuring and loses commands at any time of its approach to an obstacle, in lockstep.

use super::super::trial::losing::{LosingDriver, Losses};
use super::beside_a_ball_with_lag;

/// Turns until the tip has passed the ball, which it does 5.3 s after the beginning.
const TURNS: u32 = 1200;
/// Of a safe distance of 10 mm. Believed at once, true statements left 7.8 mm: the daemon does not know how late commands are taken, and what was lost
/// since the newest measurement. Shown by measurements first, they left 7.3 mm and more.
const LEAST_M: f64 = 5e-3;

/// The least true clearance \[m\] of motors with this time constant behind a driver that takes commands this late \[ms\], and the turn of a contact fault.
fn beside_a_ball_with_losses(losses: Losses, late_ms: u64, lag_ms: f64) -> (f64, Option<u32>) {
    let (mut trial, ball) = beside_a_ball_with_lag(lag_ms);
    let mut driver = LosingDriver::new(losses, late_ms);
    let mut turns = 0..TURNS;
    let latched = turns.find(|_| trial.turn_losing(&mut driver, &ball).mode.is_latched());
    (driver.least_m, latched)
}

/// [`beside_a_ball_with_losses`] for all these.
fn meet_nothing(losses: impl Iterator<Item = Losses>, lates_ms: &[u64], lag_ms: f64) {
    let (mut runs, mut latched_runs, mut least_m) = (0, 0, f64::INFINITY);
    for losses in losses {
        for late_ms in lates_ms {
            let (true_m, latched) = beside_a_ball_with_losses(losses, *late_ms, lag_ms);
            if true_m < LEAST_M || latched.is_some() {
                println!("{losses:?}, {late_ms} ms late: {true_m} m, fault {latched:?}");
            }
            runs += 1;
            latched_runs += u32::from(latched.is_some());
            least_m = least_m.min(true_m);
        }
    }
    println!("{runs} runs, {lag_ms} ms: true clearance {least_m} m, {latched_runs} faults");
    assert_eq!(latched_runs, 0);
    assert!(least_m > LEAST_M, "{least_m} m");
}

/// As in `system/stalling_driver`: 30 to 44 ms in every 150 ms.
#[test]
fn a_driver_that_loses_commands_at_any_time_meets_nothing() {
    let at_any_time = |step_ms| {
        (0..450).step_by(step_ms).map(|phase_ms| Losses {
            every_ms: 150,
            phase_ms,
            lasts_ms: [30, 37, 44],
        })
    };
    meet_nothing(at_any_time(19), &[1, 2, 3, 4], 20.0);
    meet_nothing(at_any_time(63), &[1, 4], 100.0);
}

/// Most of them shorter than what noise hides, or most of them longer than the motors' delay and lag.
#[test]
fn losses_of_any_length_meet_nothing() {
    let losses = (20..=80).step_by(12).flat_map(|lasts_ms| {
        (0..4).map(move |part| Losses {
            every_ms: 180,
            phase_ms: 45 * part + lasts_ms / 10,
            lasts_ms: [lasts_ms; 3],
        })
    });
    meet_nothing(losses, &[2], 20.0);
}
