//! The whole system: real processes over real shared memory, each test with its own prefix.

mod access;
mod around;
mod bare;
mod c;
mod calibration;
mod commands;
mod demo;
mod driver;
mod driver_example;
mod ending;
mod examples;
mod feeding;
mod lease;
mod lifecycle;
mod modes;
mod motions;
mod obstacles;
mod play;
mod program;
mod readme;
mod reconnect;
mod recording;
mod replay;
mod report;
mod scenes;
mod service_manager;
mod silence;
mod stalling_driver;
mod strangers;
mod timing;
mod top;
mod tutorial;
mod undetermined;
mod view;

use std::time::Duration;

use cdcr_shared_types::proc_stat::stat_field;
use cdcr_tests::{Daemon, wait_until};
use rustix::process::Signal;

/// Stops a daemon for at least this long.
fn freeze(daemon: &Daemon, duration: Duration) {
    let stat = format!("/proc/{}/stat", daemon.id());
    let stands = || {
        let stat = std::fs::read(&stat).unwrap();
        stat_field(&stat, 3) == Some('T')
    };
    daemon.signal(Signal::STOP);
    // On a stalled machine, the signal may be handled late; a pending one is cancelled by the next one.
    wait_until("it stands still", stands);
    std::thread::sleep(duration);
    daemon.signal(Signal::CONT);
}

/// Largest distance of the tip from its reference after `cycles` \[m\], if it is within `exact_m` without
/// lost cycles. For each cycle: the time of the lost cycles before it, and its period \[s\]. During a loss
/// the tip continues at its last rates, and returns afterwards.
fn error_max_m(exact_m: f64, cycles: impl IntoIterator<Item = (f64, f64)>) -> f64 {
    /// All three sections of 0.3 m at 2 rad/s about both axes, plus the motion of the reference.
    const APART_M_S: f64 = (0.9 + 0.6 + 0.3) * 2.0 * std::f64::consts::SQRT_2 + 0.5;
    /// A tenth of the speed of one section of 0.3 m at 2 rad/s.
    const BACK_M_S: f64 = 0.3 * 2.0 * 0.1;
    let apart_m = cycles.into_iter().fold(0.0, |apart_m, (lost_s, period_s)| {
        f64::max(apart_m - BACK_M_S * period_s, 0.0) + APART_M_S * lost_s
    });
    exact_m + apart_m
}
