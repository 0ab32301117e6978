//! What messages say of robot and obstacles, as `cdcr_controller` computes with it.

use cdcr_controller::reference;
use cdcr_controller::robot::{
    Obstacle, Robot, RobotError, RobotParameters, SectionParameters, Shape,
};
use cdcr_shared_types::codes::ObstacleShape;
use cdcr_shared_types::{RobotDescription, SectionDescription};
use nalgebra::{Quaternion, Unit, UnitQuaternion};

use crate::Orientation;

/// The robot of a description.
///
/// # Errors
/// When it describes none: a daemon publishes only robots that are.
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
    })
}

/// An obstacle of a record, where it is at the release. None: no obstacle that a daemon would have taken.
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

/// An orientation of a trajectory.
pub fn orientation_of(orientation: Orientation) -> reference::Orientation {
    match orientation {
        Orientation::Free => reference::Orientation::Free,
        Orientation::Axis(axis) => reference::Orientation::Axis(Unit::new_normalize(axis.into())),
        Orientation::Full([x, y, z, w]) => {
            let rotation = Quaternion::new(w, x, y, z);
            reference::Orientation::Full(UnitQuaternion::from_quaternion(rotation))
        }
    }
}
