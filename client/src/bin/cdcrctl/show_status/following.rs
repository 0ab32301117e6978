//! The following error, and what shows its cause.

use std::fmt::Write as _;

use cdcr_client::model::robot_of;
use cdcr_controller::safety::{FollowingCause, FollowingError};
use cdcr_shared_types::Status;
use cdcr_shared_types::codes::Interface;

/// The largest following error of a section (rad).
pub(crate) fn following_error_rad(status: &Status) -> f64 {
    let sections = (status.robot.sections as usize).min(status.following_error_rad.len());
    let errors_rad = status.following_error_rad[..sections].iter();
    errors_rad.copied().fold(0.0, f64::max)
}

/// The lines of the following error.
pub(super) fn write(out: &mut String, status: &Status) -> std::fmt::Result {
    let largest_rad = following_error_rad(status);
    let errors_m = status.following_error_m.iter();
    let largest_m = errors_m.fold(0.0_f64, |most, m| most.max(m.abs()));
    writeln!(
        out,
        "\nfollowing   {} interface, error {largest_rad:.4} rad, {:.2} mm of cable ({} cycles above the warning)",
        Interface::text_of(status.interface),
        1e3 * largest_m,
        status.following_warnings
    )?;
    let error = FollowingError {
        bend_rad: status.following_error_rad,
        cable_m: status.following_error_m,
    };
    let robot = robot_of(&status.robot).ok();
    if let Some(cause) = robot.and_then(|robot| FollowingCause::find(&robot, &error)) {
        writeln!(out, "            {cause}")?;
    }
    Ok(())
}
