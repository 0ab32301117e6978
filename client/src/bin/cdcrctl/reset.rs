//! `cdcrctl reset`.

use cdcr_client::{Requester, STATUS_TIMEOUT};
use cdcr_shared_types::Status;
use cdcr_shared_types::codes::{Interface, RequestKind};
use cdcr_shared_types::limits::BEND_TOLERANCE_RAD;

use crate::args::{ResetOptions, Target};
use crate::done::Done;
use crate::show_status::following_error_rad;
use crate::wait;

/// Sensor noise and play leave less between command and measurement \[rad\].
const SEEN_RAD: f64 = 0.02;

pub(crate) fn run(target: &Target, options: &ResetOptions) -> anyhow::Result<Done> {
    let (kind, accept_pose) = (RequestKind::Reset, options.accept_pose);
    let connection = target.connect().ok();
    let before = connection.and_then(|connection| connection.status(STATUS_TIMEOUT).ok());
    let note = before.as_ref().and_then(motion);
    let tell_note = || {
        if let Some(note) = &note {
            tell!("{note}");
        }
    };
    if let Some(limit) = options.wait.wait {
        return wait::run_by(target, kind, limit, |connection| {
            let response = connection.reset(accept_pose)?;
            tell_note();
            Ok(response)
        });
    }
    let (location, robot) = target.location()?;
    let response = Requester::open(&location, robot)?.reset(accept_pose)?;
    wait::print_outcome(kind, &response)?;
    tell_note();
    Ok(Done::Good)
}

/// How far motors that follow positions may move the robot after the reset.
fn motion(before: &Status) -> Option<String> {
    let away_rad = following_error_rad(before);
    let may_move = before.interface == Interface::Position.code() && away_rad > SEEN_RAD;
    may_move.then(|| {
        format!(
            "note: a section was measured {away_rad:.3} rad from its command. If this is more than {BEND_TOLERANCE_RAD} rad, the commanded position moves to the measured one. \
             The motors follow it, and the robot moves by that much, unless a load explains the distance (docs/drivers.md, After a hang); --wait waits for rest"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motors_that_follow_positions_may_move_after_a_reset() {
        for (interface, away_rad, is_said) in [
            (Interface::Position, 0.1, true),
            (Interface::Position, 0.01, false),
            (Interface::Velocity, 0.1, false),
        ] {
            let mut status = Status {
                interface: interface.code(),
                ..Status::default()
            };
            status.robot.sections = 1;
            status.following_error_rad[0] = away_rad;
            assert_eq!(motion(&status).is_some(), is_said, "{away_rad}");
        }
    }
}
