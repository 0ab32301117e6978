//! Conversion of robot, obstacles and settings in messages to the types of `cdcr_controller`.

use cdcr_controller::nmpc::{Coordinates, NmpcSettings, SolverKind};
use cdcr_controller::optimizer::VelocityRule;
use cdcr_controller::reference;
use cdcr_controller::robot::{
    Obstacle, Robot, RobotError, RobotParameters, SectionParameters, Shape,
};
use cdcr_shared_types::codes::{self, ObstacleShape, OrientationKind, UnknownCode};
use cdcr_shared_types::{
    ReferenceChunk, ReferencePoint, RobotDescription, SectionDescription, SolverSettings, Status,
};
use nalgebra::{Quaternion, Unit, UnitQuaternion};

use crate::Orientation;

/// The robot of a description.
///
/// # Errors
/// When the description is invalid; a daemon publishes only valid ones.
pub fn robot_of(description: &RobotDescription) -> Result<Robot, RobotError> {
    let section = |section: &SectionDescription| SectionParameters {
        length_m: section.length_m,
        cable_radius_m: section.cable_radius_m,
        cable_offset_rad: section.cable_offset_rad,
        bend_max_rad: section.bend_max_rad,
        rate_max_rad_s: section.rate_max_rad_s,
        body_radius_m: section.body_radius_m,
    };
    let sections = description.section.iter();
    let used = sections.take(description.sections as usize);
    Robot::new(&RobotParameters {
        sections: used.map(section).collect(),
        cable_speed_max_m_s: description.cable_speed_max_m_s,
        cable_stroke_max_m: description.cable_stroke_max_m,
        tip_speed_max_m_s: description.tip_speed_max_m_s,
    })
}

/// An obstacle of a record, at its position at the release. `None` for an obstacle that a daemon would
/// refuse.
pub fn obstacle_of(obstacle: &cdcr_shared_types::Obstacle) -> Option<Obstacle> {
    let shape = match ObstacleShape::try_from(obstacle.shape).ok()? {
        ObstacleShape::Sphere => Shape::Sphere {
            centre_m: obstacle.start_m.into(),
        },
        ObstacleShape::Capsule => Shape::Capsule {
            start_m: obstacle.start_m.into(),
            end_m: obstacle.end_m.into(),
        },
    };
    Obstacle::new(shape, obstacle.radius_m, obstacle.velocity_m_s.into()).ok()
}

/// The solver settings without the budget. Each field has the same name on both sides, and a missing one does
/// not compile.
///
/// # Errors
/// When a code is unknown; no daemon publishes such settings.
pub fn settings_of(settings: &SolverSettings) -> Result<NmpcSettings, UnknownCode> {
    macro_rules! same_names {
        ({ $($choice:ident: $type:ident { $($variant:ident),+ },)+ } $($number:ident),+ $(,)?) => {{
            let SolverSettings { $($choice,)+ $($number,)+ budget_ns: _, reserved: _ } = *settings;
            NmpcSettings {
                $($choice: match codes::$type::try_from($choice)? {
                    $(codes::$type::$variant => $type::$variant,)+
                },)+
                $($number: $number.into(),)+
            }
        }};
    }
    Ok(cdcr_shared_types::solver_settings!(same_names))
}

/// The points of an accepted reference chunk. `None` for a chunk that no daemon accepts.
pub fn reference_points(chunk: &ReferenceChunk) -> Option<Vec<reference::ReferencePoint>> {
    let interpolation = match codes::Interpolation::try_from(chunk.interpolation).ok()? {
        codes::Interpolation::Linear => reference::Interpolation::Linear,
        codes::Interpolation::Cubic => reference::Interpolation::Cubic,
    };
    let used = chunk.points.get(..chunk.count as usize)?;
    let point = |point: &ReferencePoint| {
        let [x, y, z, _] = point.orientation;
        let orientation = match OrientationKind::try_from(point.orientation_kind).ok()? {
            OrientationKind::None => Orientation::Free,
            OrientationKind::Axis => Orientation::Axis([x, y, z]),
            OrientationKind::Preferred => Orientation::Preferred([x, y, z]),
            OrientationKind::Full => Orientation::Full(point.orientation),
        };
        Some(reference::ReferencePoint {
            time_ns: point.time_ns,
            position_m: point.position_m.into(),
            orientation: orientation_of(orientation),
            interpolation,
        })
    };
    used.iter().map(point).collect()
}

/// Converts the orientation of a trajectory.
pub fn orientation_of(orientation: Orientation) -> reference::Orientation {
    match orientation {
        Orientation::Free => reference::Orientation::Free,
        Orientation::Axis(axis) => reference::Orientation::Axis(Unit::new_normalize(axis.into())),
        Orientation::Preferred(axis) => {
            reference::Orientation::Preferred(Unit::new_normalize(axis.into()))
        }
        Orientation::Full([x, y, z, w]) => {
            let rotation = Quaternion::new(w, x, y, z);
            reference::Orientation::Full(UnitQuaternion::from_quaternion(rotation))
        }
    }
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
