//! Clients that connect to a daemon and leave.

use std::time::Duration;

use cdcr_client::Connection;
use cdcr_shared_types::Location;

use super::Done;
use super::rate::every;
use super::task::Signals;
use crate::subject::ROBOT;

/// Number of threads. One thread manages ten visits a second, because connecting waits for a status message.
pub const COMERS: u32 = 5;
/// Period of one thread; together 30 clients a second.
pub const PERIOD: Duration = Duration::from_micros(COMERS as u64 * 33_333);

/// Connects and disconnects until the load ends; every second visit opens the telemetry. A connection that
/// fails on a stalled machine is counted and is not an error.
pub(super) fn come_and_go(target: &Location, signals: &Signals) -> Done {
    let mut done = Done::default();
    let mut turn = 0_u64;
    signals.works();
    // The closure never fails.
    let _ = every(
        PERIOD,
        || signals.is_ending(),
        || {
            turn += 1;
            let granted = visit(target, ROBOT, turn.is_multiple_of(2));
            done.clients += u64::from(granted);
            done.failed_clients += u64::from(!granted);
            Ok(())
        },
    );
    done
}

/// Connects to a daemon and leaves. Returns whether it was granted.
pub fn visit(target: &Location, robot: &str, with_telemetry: bool) -> bool {
    let Ok(connection) = Connection::open(target, robot) else {
        return false;
    };
    !with_telemetry || connection.telemetry().is_ok()
}
