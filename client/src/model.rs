//! Robot, obstacles and settings in messages as types of `cdcr_controller`, and what follows from them.

use cdcr_controller::nmpc::NmpcSettings;
use cdcr_controller::reference;
use cdcr_shared_types::codes::{Interface, Interpolation, OrientationKind};
pub use cdcr_shared_types::model::{obstacle_of, robot_of, settings_of};
use cdcr_shared_types::{ReferenceChunk, ReferencePoint, SolverSettings, Status, Telemetry, model};

use crate::Orientation;

/// The points of an accepted reference chunk. `None` for a chunk that no daemon accepts.
pub fn reference_points(chunk: &ReferenceChunk) -> Option<Vec<reference::ReferencePoint>> {
    let interpolation = Interpolation::try_from(chunk.interpolation).ok()?.into();
    let used = chunk.points.get(..chunk.count as usize)?;
    let point = |point: &ReferencePoint| {
        let kind = OrientationKind::try_from(point.orientation_kind).ok()?;
        Some(reference::ReferencePoint {
            time_ns: point.time_ns,
            position_m: point.position_m.into(),
            orientation: model::orientation_of(kind, point.orientation),
            interpolation,
        })
    };
    used.iter().map(point).collect()
}

/// Converts the orientation of a trajectory.
pub fn orientation_of(orientation: Orientation) -> reference::Orientation {
    let (kind, numbers) = orientation.to_wire();
    model::orientation_of(kind, numbers)
}

/// Time for which the command of a record moves the robot \[ns\]. A position command ends with its period.
pub fn moving_ns(record: &Telemetry) -> u64 {
    if record.command.interface == Interface::Position.code() {
        return record.period_ns;
    }
    let until_ns = record.command.valid_until_ns;
    until_ns.saturating_sub(record.release_ns)
}

/// The bound that refused settings break, beyond the ranges of the single ones: of the daemon's configuration, or of another
/// setting.
pub fn broken_bound(wanted: &SolverSettings, status: &Status) -> Option<String> {
    let least_m = status.safe_distance_min_m;
    if wanted.safe_distance_m < least_m {
        let wanted_m = wanted.safe_distance_m;
        return Some(format!(
            "safe_distance_m = {wanted_m} is below the configured {least_m}: use at least that"
        ));
    }
    if wanted.budget_ns > status.period_ns {
        let ms = |ns: u64| ns as f64 / 1e6;
        return Some(format!(
            "budget_ms = {} is longer than the period of the daemon: at most {}",
            ms(wanted.budget_ns),
            ms(status.period_ns)
        ));
    }
    let rules = NmpcSettings {
        horizon_steps: wanted.horizon_steps,
        control_blocks: wanted.control_blocks,
        obstacle_step_penalty: wanted.obstacle_step_penalty,
        obstacle_slope_penalty: wanted.obstacle_slope_penalty,
        obstacle_square_penalty: wanted.obstacle_square_penalty,
        ..NmpcSettings::default()
    };
    let broken = rules.validate().err();
    broken.map(|bound| format!("with the other settings unchanged, {bound}"))
}

/// What a safe distance that becomes longer than the present clearance does to the robot: to warn of before
/// [`Connection::change_settings`](crate::Connection::change_settings).
pub fn moves_away(
    before: &SolverSettings,
    after: &SolverSettings,
    status: &Status,
) -> Option<String> {
    let (is_m, was_m) = (after.safe_distance_m, before.safe_distance_m);
    (is_m > was_m && status.clearance_m < is_m).then(|| {
        format!(
            "safe_distance_m = {is_m} is more than the present clearance of {:.3} m: a tracking robot leaves its reference and moves away from the \
             obstacle, at up to the limits of its rates, and returns when the distance is lowered. In all other modes it does not move away; it just does not get closer",
            status.clearance_m
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_safe_distance_above_the_present_clearance_is_warned_of_with_both() {
        let with = |safe_distance_m| SolverSettings {
            safe_distance_m,
            ..SolverSettings::default()
        };
        let warned = |before_m, after_m, clearance_m| {
            let status = Status {
                clearance_m,
                ..Status::default()
            };
            moves_away(&with(before_m), &with(after_m), &status)
        };
        let text = warned(0.01, 0.2, 0.0741).expect("it moves away");
        for part in [
            "safe_distance_m = 0.2 is more than the present clearance of 0.074 m",
            "moves away from the obstacle",
        ] {
            assert!(text.contains(part), "{text}");
        }
        for (before_m, after_m, clearance_m) in [
            (0.01, 0.05, 0.0741),
            (0.2, 0.2, 0.0741),
            (0.2, 0.1, 0.0741),
            (0.01, 0.2, f64::INFINITY),
        ] {
            assert_eq!(warned(before_m, after_m, clearance_m), None);
        }
    }
}
