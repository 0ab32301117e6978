//! The whole system: real processes over real shared memory, each test on a prefix of its own.

mod access;
mod bad_input;
mod bare;
mod demo;
mod driver;
mod driver_example;
mod ending;
mod feeding;
mod lease;
mod lifecycle;
mod modes;
mod obstacles;
mod program;
mod reconnect;
mod replay;
mod silence;
mod strangers;
mod timing;

use std::time::Duration;

use cdcr_tests::{Daemon, wait_until};
use rustix::process::Signal;

/// Makes a daemon stand still for at least this long.
fn freeze(daemon: &Daemon, duration: Duration) {
    let stat = format!("/proc/{}/stat", daemon.id());
    let stands = || {
        let stat = std::fs::read_to_string(&stat).unwrap();
        let state = stat.rsplit(')').next().unwrap();
        state.trim_start().starts_with('T')
    };
    daemon.signal(Signal::STOP);
    // On a machine that stalls, the signal may be taken late; one that is not taken yet is undone by the next one.
    wait_until("it stands still", stands);
    std::thread::sleep(duration);
    daemon.signal(Signal::CONT);
}

/// How far the tip may be from its reference when the cycles of this time were lost \[m\], where it is within `exact_m`
/// when none are: meanwhile it goes on with the rates that it had, and comes back as fast as it can.
fn error_max_m(exact_m: f64, lost_s: f64) -> f64 {
    /// All three sections of 0.3 m at 2 rad/s in both directions, and the reference in between.
    const APART_M_S: f64 = (0.9 + 0.6 + 0.3) * 2.0 * std::f64::consts::SQRT_2 + 0.5;
    exact_m + APART_M_S * lost_s
}
