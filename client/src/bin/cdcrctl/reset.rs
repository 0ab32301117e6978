//! `cdcrctl reset`.

use std::time::Duration;

use cdcr_shared_types::Status;
use cdcr_shared_types::codes::RequestKind;

use crate::args::Target;
use crate::show_status::following_error_rad;
use crate::{Done, request};

/// Timeout for the status: the reset itself needs none.
const STATUS_TIMEOUT: Duration = Duration::from_millis(500);
/// A robot that was held by its motors is not measured farther from its command (rad).
const ELSEWHERE_RAD: f64 = 0.2;

pub(crate) fn run(target: &Target, wait: Option<Duration>) -> anyhow::Result<Done> {
    let status = target.connect().ok();
    let status = status.and_then(|connection| connection.status(STATUS_TIMEOUT).ok());
    if let Some(note) = status.as_ref().and_then(elsewhere) {
        tell!("{note}");
    }
    request::run(target, RequestKind::Reset, wait)
}

/// What to check before the robot moves, if it was measured far from its command before the reset.
fn elsewhere(status: &Status) -> Option<String> {
    let error_rad = following_error_rad(status);
    (error_rad > ELSEWHERE_RAD).then(|| {
        format!(
            "note: the robot is measured {error_rad:.2} rad from where its last command left it. If it was moved or its motors were off, \
             this is right. If not, the encoders have lost their zero: after the reset the daemon takes what they measure as true, \
             so check it before the robot moves (docs/drivers.md, Zero)"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_that_is_elsewhere_is_noted() {
        let mut status = Status::default();
        status.robot.sections = 2;
        status.following_error_rad[..3].copy_from_slice(&[0.05, 0.19, 3.0]);
        assert_eq!(elsewhere(&status), None);
        status.following_error_rad[1] = 1.19;
        let note = elsewhere(&status).unwrap();
        assert!(note.contains("1.19 rad") && note.contains("zero"), "{note}");
    }
}
