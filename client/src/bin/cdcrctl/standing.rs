//! Whether the robot rests at the start of a path that was computed for it.

use anyhow::bail;
use cdcr_client::{Connection, PoseDifference, RequestError, RequestName, STATUS_TIMEOUT};
use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::{Mode, Outcome, RequestKind};

use crate::dry_run::newest;

/// A tip farther than this from the start of its computed path has moved, whatever error is allowed \[m\].
pub(crate) const MOVED_M: f64 = 2e-3;

/// Fails when the robot does not rest at its position in `before`: another client that holds the lease moves it, or the
/// daemon does.
pub(crate) fn check_stands(connection: &Connection, before: &Telemetry) -> anyhow::Result<()> {
    if stands(before, &newest(connection)?) {
        return Ok(());
    }
    let status = connection.status(STATUS_TIMEOUT)?;
    if status.lease_holder != 0 {
        return Err(RequestError::Refused {
            asked: RequestName::Request(RequestKind::AcquireLease),
            outcome: Outcome::LeaseHeld,
            mode: Mode::try_from(status.mode)?,
            pose: PoseDifference::default(),
        }
        .into());
    }
    bail!(
        "the tip moves, or has moved while the path was computed; nothing was sent: try again when it is at rest"
    );
}

/// Whether the robot rests where it was before.
fn stands(before: &Telemetry, now: &Telemetry) -> bool {
    let moved_m = distance_m(now.tip_position_m, before.tip_position_m);
    moved_m <= MOVED_M && rests(before) && rests(now)
}

/// Whether the command is rest.
fn rests(record: &Telemetry) -> bool {
    record
        .command
        .bend_rate_rad_s
        .iter()
        .all(|rate| *rate == 0.0)
}

pub(crate) fn distance_m(a: [f64; 3], b: [f64; 3]) -> f64 {
    let squares = a.iter().zip(b).map(|(a, b)| (a - b).powi(2));
    squares.sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_stands_that_rests_where_it_rested() {
        let record = |x_m: f64, rate_rad_s: f64| {
            let mut record = Telemetry::default();
            record.tip_position_m[0] = x_m;
            record.command.bend_rate_rad_s[3] = rate_rad_s;
            record
        };
        for (before, now, is_standing) in [
            ((0.1, 0.0), (0.1, 0.0), true),
            ((0.1, 0.0), (0.1019, 0.0), true),
            // It has moved and rests again.
            ((0.1, 0.0), (0.1021, 0.0), false),
            ((0.1, 0.0), (f64::NAN, 0.0), false),
            // It begins to move, or just ended.
            ((0.1, 0.0), (0.1, -1e-6), false),
            ((0.1, 1e-6), (0.1, 0.0), false),
        ] {
            let [old, new] = [before, now].map(|(x_m, rate_rad_s)| record(x_m, rate_rad_s));
            assert_eq!(stands(&old, &new), is_standing, "{before:?} {now:?}");
        }
    }
}
