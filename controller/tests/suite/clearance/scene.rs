//! Generated robots, shapes, and obstacles in special positions.

use core::f64::consts::PI;

use super::robot::{Configuration, Obstacle, Robot, RobotParameters, SECTIONS_MAX, Shape};
use nalgebra::Vector3;
use proptest::prelude::*;

fn still(shape: Shape, radius_m: f64) -> Obstacle {
    Obstacle::new(shape, radius_m, Vector3::zeros()).unwrap()
}

pub(crate) fn sphere(centre_m: Vector3<f64>, radius_m: f64) -> Obstacle {
    still(Shape::Sphere { centre_m }, radius_m)
}

pub(crate) fn capsule(start_m: Vector3<f64>, end_m: Vector3<f64>, radius_m: f64) -> Obstacle {
    still(Shape::Capsule { start_m, end_m }, radius_m)
}

/// Robots of 1 to 6 different sections: bent, strongly bent, half a circle and more, nearly straight,
/// straight.
pub(crate) fn robots_and_shapes() -> impl Strategy<Value = (Robot, Configuration)> {
    let bend_rad = prop_oneof![
        6 => 0.0..2.8_f64,
        2 => 2.8..PI,
        1 => Just(PI),
        1 => -12.0..-2.0_f64, // the exponent of ten
        1 => Just(0.0),
        // Beyond the limits of a robot.
        1 => PI..8.0,
    ];
    let bend_rad = bend_rad.prop_map(|x: f64| if x < 0.0 { 10_f64.powf(x) } else { x });
    let section = (0.05..0.5_f64, bend_rad, -3.2..3.2_f64, 0.0..0.03_f64);
    prop::collection::vec(section, 1..=SECTIONS_MAX).prop_map(|sections| {
        let mut parameters = RobotParameters::paper(sections.len());
        for (target, (length_m, _, _, body_radius_m)) in
            parameters.sections.iter_mut().zip(&sections)
        {
            target.length_m = *length_m;
            target.body_radius_m = *body_radius_m;
        }
        let angles: Vec<[f64; 2]> = sections
            .iter()
            .map(|section| [section.1, section.2])
            .collect();
        (
            Robot::new(&parameters).unwrap(),
            Configuration::from_bend_angles(&angles),
        )
    })
}

/// The largest bend of any section (rad).
pub(crate) fn bend_max_rad(shape: &Configuration) -> f64 {
    (0..shape.section_count())
        .map(|j| shape.bend_rad(j))
        .fold(0.0, f64::max)
}

pub(crate) fn vector(size: f64) -> impl Strategy<Value = Vector3<f64>> {
    prop::array::uniform3(-size..size).prop_map(Vector3::from)
}

/// Position of an obstacle relative to the robot, so that special positions occur.
#[derive(Debug, Clone, Copy)]
pub(crate) enum ObstaclePlace {
    /// Anywhere around the robot.
    Around(Vector3<f64>, Vector3<f64>),
    /// From near a point of the body to any point.
    AtBody(usize, f64, Vector3<f64>, Vector3<f64>),
    /// Through two points of the body.
    Through([usize; 2], [f64; 2]),
    /// Near the centre of a section's circle, along directions in that section's axes; flat means in its
    /// plane.
    AtCentre(usize, Vector3<f64>, Vector3<f64>, bool),
    /// Along the start of a section.
    Along(usize, Vector3<f64>),
}

pub(crate) fn places() -> impl Strategy<Value = ObstaclePlace> {
    let section = 0..SECTIONS_MAX;
    let share = 0.0..1.0_f64;
    let offset = prop_oneof![vector(0.1), vector(1e-4), Just(Vector3::zeros())];
    prop_oneof![
        (vector(1.0), vector(1.0)).prop_map(|(a, b)| ObstaclePlace::Around(a, b)),
        (section.clone(), share.clone(), offset.clone(), vector(0.6))
            .prop_map(|(j, s, a, b)| ObstaclePlace::AtBody(j, s, a, b)),
        ([section.clone(), section.clone()], [share.clone(), share])
            .prop_map(|(j, s)| ObstaclePlace::Through(j, s)),
        (section.clone(), offset.clone(), vector(0.3), any::<bool>())
            .prop_map(|(j, a, b, flat)| ObstaclePlace::AtCentre(j, a, b, flat)),
        (section, offset).prop_map(|(j, a)| ObstaclePlace::Along(j, a)),
    ]
}

/// The segment of a place; its start is the centre of a sphere.
pub(crate) fn segment(
    robot: &Robot,
    shape: &Configuration,
    place: ObstaclePlace,
) -> [Vector3<f64>; 2] {
    let n = robot.section_count();
    let frames = robot.section_frames(shape);
    match place {
        ObstaclePlace::Around(a, b) => [a, b],
        ObstaclePlace::AtBody(j, s, offset, b) => [robot.body_point(shape, j % n, s) + offset, b],
        ObstaclePlace::Through(j, s) => [0, 1].map(|i| robot.body_point(shape, j[i] % n, s[i])),
        ObstaclePlace::AtCentre(j, offset, direction, flat) => {
            let j = j % n;
            let (sin, cos) = shape.direction_rad(j).sin_cos();
            let radius_m = robot.sections()[j].length_m / shape.bend_rad(j).max(0.2);
            let across = Vector3::new(cos, sin, 0.0);
            let mut direction = across * direction.x
                + Vector3::new(-sin, cos, 0.0) * direction.y
                + Vector3::z() * direction.z;
            if flat {
                direction -=
                    Vector3::new(-sin, cos, 0.0) * direction.dot(&Vector3::new(-sin, cos, 0.0));
            }
            let centre_m = frames[j].position_m + frames[j].rotation * (across * radius_m) + offset;
            let direction = frames[j].rotation * direction;
            [centre_m - direction * 0.7, centre_m + direction]
        }
        ObstaclePlace::Along(j, offset) => {
            let (frame, length_m) = (frames[j % n], robot.sections()[j % n].length_m);
            let along = frame.rotation.column(2).into_owned();
            let start_m = frame.position_m + offset - along * (0.3 * length_m);
            [start_m, start_m + along * (1.1 * length_m)]
        }
    }
}
