//! Clients that connect to a daemon and leave.

use std::time::Duration;

use cdcr_client::Connection;
use cdcr_shared_types::Location;

use super::Done;
use super::rate::every;
use super::task::Signals;
use crate::subject::ROBOT;

/// Threads that come and go. One alone comes ten times a second: to connect is to wait for a status.
pub(super) const COMERS: u32 = 5;
/// Of one thread; 30 clients a second in all.
const PERIOD: Duration = Duration::from_micros(COMERS as u64 * 33_333);

/// Comes and goes until the end; every other time it opens the telemetry. A machine that stalls may cost a
/// client its connection: that is counted, and no failure.
pub(super) fn come_and_go(target: &Location, signals: &Signals) -> Done {
    let mut done = Done::default();
    let mut turn = 0_u64;
    signals.works();
    // It never fails.
    let _ = every(
        PERIOD,
        || signals.is_ending(),
        || {
            turn += 1;
            let granted = visit(target, turn.is_multiple_of(2));
            done.clients += u64::from(granted);
            done.failed_clients += u64::from(!granted);
            Ok(())
        },
    );
    done
}

fn visit(target: &Location, with_telemetry: bool) -> bool {
    let Ok(connection) = Connection::open(target, ROBOT) else {
        return false;
    };
    !with_telemetry || connection.telemetry().is_ok()
}
