use std::collections::VecDeque;
use std::fmt::Write as _;

use cdcr_controller::robot::{Configuration, Nearest, Robot, quaternion_xyzw};
use cdcr_interchange::standard::{ColorRgba, Header, Marker, Point, Pose, Vector3 as Size, shape};
use cdcr_shared_types::codes::{Mode, ObstacleShape};
use cdcr_shared_types::{Obstacle, Telemetry};
use nalgebra::{UnitQuaternion, Vector3};

use super::drawn::{point, pose};
use crate::model::{obstacle_of, robot_of};
use crate::{counted, obstacles, section_lengths_m};

/// Points on the backbone of a section; enough for a smooth bend of 0.7 rad.
const POINTS: usize = 16;
/// Discs per section, evenly spaced; the last one is at its end.
const DISCS: usize = 5;
/// Thickness of a disc as a share of the section length.
const DISC_SHARE: f64 = 0.01;
/// Time between two points of the paths of tip and reference \[ns\].
const PATH_INTERVAL_NS: u64 = 50_000_000;
/// Points of a path: 5 s.
const PATH_POINTS: usize = 100;
/// Width of a path as a share of the robot length.
const PATH_WIDTH_SHARE: f64 = 0.004;
/// Height of the text as a share of the robot length.
const TEXT_SHARE: f64 = 0.04;

const BODY: ColorRgba = color(0.35, 0.55, 0.85, 1.0);
const DISC: ColorRgba = color(0.2, 0.25, 0.35, 1.0);
const TIP_WAY: ColorRgba = color(0.2, 0.5, 1.0, 1.0);
const REFERENCE_WAY: ColorRgba = color(0.95, 0.65, 0.1, 1.0);
const FAR: ColorRgba = color(0.6, 0.6, 0.6, 0.7);
const NEAR: ColorRgba = color(0.9, 0.15, 0.15, 0.8);
const TEXT: ColorRgba = color(0.55, 0.55, 0.55, 1.0);

const fn color(r: f32, g: f32, b: f32, a: f32) -> ColorRgba {
    ColorRgba { r, g, b, a }
}

/// Drawing of the robot, with the paths of tip and reference over the last seconds.
#[derive(Debug)]
pub(super) struct DrawnScene {
    robot: Robot,
    length_m: f64,
    tip_path: VecDeque<[f64; 3]>,
    reference_path: VecDeque<[f64; 3]>,
    path_ns: u64,
}

impl DrawnScene {
    /// For the robot of a record; `None` when its description is invalid.
    pub(super) fn from_record(record: &Telemetry) -> Option<Self> {
        Some(Self {
            robot: robot_of(&record.robot).ok()?,
            length_m: section_lengths_m(&record.robot).iter().sum(),
            tip_path: VecDeque::with_capacity(PATH_POINTS),
            reference_path: VecDeque::with_capacity(PATH_POINTS),
            path_ns: 0,
        })
    }

    /// Adds the positions of tip and reference to their paths. Returns whether the robot can be drawn.
    pub(super) fn take(&mut self, record: &Telemetry) -> bool {
        if record.release_ns.saturating_sub(self.path_ns) >= PATH_INTERVAL_NS {
            self.path_ns = record.release_ns;
            keep(&mut self.tip_path, record.tip_position_m);
            if record.position_error_m.is_finite() {
                keep(&mut self.reference_path, record.reference.position_m);
            }
        }
        self.shape(record).is_some()
    }

    fn shape(&self, record: &Telemetry) -> Option<Configuration> {
        let bends = record.present_rad.get(..2 * self.robot.section_count())?;
        Configuration::from_slice(bends).filter(Configuration::is_finite)
    }

    /// The end of each section, base first.
    pub(super) fn section_ends(&self, record: &Telemetry) -> Vec<Pose> {
        let shape = self.shape(record);
        let end = |j| shape.map(|shape| self.pose_at(&shape, j, 1.0));
        (0..self.robot.section_count()).filter_map(end).collect()
    }

    fn pose_at(&self, shape: &Configuration, section: usize, share: f64) -> Pose {
        let at = self.robot.body_pose(shape, section, share);
        pose(at.position_m.into(), quaternion_xyzw(&at.rotation))
    }

    /// All markers. The first one deletes the previous markers.
    pub(super) fn markers(&self, record: &Telemetry, header: &Header) -> Vec<Marker> {
        let Some(at) = self.shape(record) else {
            return Vec::new();
        };
        let mut markers = vec![Marker {
            action: shape::DELETE_ALL,
            ..Marker::default()
        }];
        self.draw_body(&at, &mut markers);
        let ways = [
            ("tip way", &self.tip_path, TIP_WAY),
            ("reference way", &self.reference_path, REFERENCE_WAY),
        ];
        for (name, way, color) in ways.into_iter().filter(|(_, way, _)| way.len() > 1) {
            let points = way.iter().copied().map(point).collect();
            markers.push(line(name, points, PATH_WIDTH_SHARE * self.length_m, color));
        }
        let robot = self.robot.enlarged(&at, record.tip_margin_m);
        let body = robot.body(&at);
        let safe_m = record.settings.safe_distance_m;
        let mut nearest: Option<Nearest> = None;
        for obstacle in obstacles(record) {
            let Some(found) = obstacle_of(obstacle).map(|solid| body.nearest(&solid)) else {
                continue;
            };
            let color = if found.clearance_m < safe_m {
                NEAR
            } else {
                FAR
            };
            draw_obstacle(obstacle, &color, &mut markers);
            if nearest.is_none_or(|least| found.clearance_m < least.clearance_m) {
                nearest = Some(found);
            }
        }
        markers.extend(nearest.map(|nearest| {
            clearance_line(&robot, &nearest, safe_m, PATH_WIDTH_SHARE * self.length_m)
        }));
        markers.push(self.status_text(record));
        for (id, marker) in markers.iter_mut().enumerate() {
            marker.header = header.clone();
            marker.id = i32::try_from(id).unwrap_or(i32::MAX);
        }
        markers
    }

    /// Backbone with the thickness of the body, and discs.
    fn draw_body(&self, at: &Configuration, markers: &mut Vec<Marker>) {
        for (j, section) in self.robot.sections().iter().enumerate() {
            let share = |i: usize, of: usize| i as f64 / of as f64;
            let place = |i| self.robot.body_point(at, j, share(i, POINTS)).into();
            let points = (0..=POINTS).map(place).map(point).collect();
            markers.push(line("body", points, 2.0 * section.body_radius_m, BODY));
            let across_m = 2.0 * section.cable_radius_m.max(section.body_radius_m);
            for i in 1..=DISCS {
                markers.push(Marker {
                    ns: "discs".to_owned(),
                    kind: shape::CYLINDER,
                    pose: self.pose_at(at, j, share(i, DISCS)),
                    scale: Size {
                        x: across_m,
                        y: across_m,
                        z: DISC_SHARE * section.length_m,
                    },
                    color: DISC,
                    ..Marker::default()
                });
            }
        }
    }

    /// Text above the robot: mode, misses and clearance.
    fn status_text(&self, record: &Telemetry) -> Marker {
        let mut text = Mode::text_of(record.mode).to_owned();
        let _ = write!(
            text,
            ", {}",
            counted(record.deadline_misses_total, "deadline miss")
        );
        if record.position_error_m.is_finite() {
            let _ = write!(text, ", error {:.2} mm", 1e3 * record.position_error_m);
        }
        if record.clearance_m.is_finite() {
            let _ = write!(text, ", clearance {:.1} mm", 1e3 * record.clearance_m);
        }
        Marker {
            ns: "text".to_owned(),
            kind: shape::TEXT_VIEW_FACING,
            pose: pose([0.0, 0.0, 1.1 * self.length_m], [0.0, 0.0, 0.0, 1.0]),
            scale: Size {
                z: TEXT_SHARE * self.length_m,
                ..Size::default()
            },
            color: TEXT,
            text,
            ..Marker::default()
        }
    }
}

/// Line from the backbone to the surface of the obstacle nearest to the body.
fn clearance_line(robot: &Robot, nearest: &Nearest, safe_m: f64, width_m: f64) -> Marker {
    let section = robot.sections().get(nearest.section);
    let radius_m = section.map_or(0.0, |section| section.body_radius_m);
    let away_m = nearest.clearance_m.max(0.0) + radius_m;
    let end_m = nearest.point_m - away_m * nearest.direction;
    let points = [nearest.point_m, end_m].map(|place| point(place.into()));
    let color = if nearest.clearance_m < safe_m {
        NEAR
    } else {
        FAR
    };
    line("nearest", points.into(), width_m, color)
}

fn keep(way: &mut VecDeque<[f64; 3]>, place: [f64; 3]) {
    if way.len() == PATH_POINTS {
        way.pop_front();
    }
    way.push_back(place);
}

/// A line in the base frame.
fn line(name: &str, points: Vec<Point>, width_m: f64, color: ColorRgba) -> Marker {
    Marker {
        ns: name.to_owned(),
        kind: shape::LINE_STRIP,
        pose: pose([0.0; 3], [0.0, 0.0, 0.0, 1.0]),
        scale: Size {
            x: width_m,
            ..Size::default()
        },
        color,
        points,
        ..Marker::default()
    }
}

/// A sphere, or a cylinder with a sphere at each end.
fn draw_obstacle(obstacle: &Obstacle, color: &ColorRgba, markers: &mut Vec<Marker>) {
    let across_m = 2.0 * obstacle.radius_m;
    let solid = |kind, at, z| Marker {
        ns: "obstacles".to_owned(),
        kind,
        pose: at,
        scale: Size {
            x: across_m,
            y: across_m,
            z,
        },
        color: color.clone(),
        ..Marker::default()
    };
    let ball = |centre_m| {
        let at = pose(centre_m, [0.0, 0.0, 0.0, 1.0]);
        solid(shape::SPHERE, at, across_m)
    };
    markers.push(ball(obstacle.start_m));
    if obstacle.shape == ObstacleShape::Capsule.code() {
        let [start_m, end_m] = [obstacle.start_m, obstacle.end_m].map(Vector3::from);
        let axis_m = end_m - start_m;
        let middle_m = start_m + 0.5 * axis_m;
        markers.push(ball(obstacle.end_m));
        let at = pose(middle_m.into(), upright_to(axis_m));
        markers.push(solid(shape::CYLINDER, at, axis_m.norm()));
    }
}

/// The shortest rotation (x, y, z, w) from the z axis to this direction; identity for a zero vector.
pub(super) fn upright_to(direction: Vector3<f64>) -> [f64; 4] {
    let turn = UnitQuaternion::rotation_between(&Vector3::z(), &direction);
    // Straight down: half a turn about any horizontal axis.
    let turn = turn.map_or([1.0, 0.0, 0.0, 0.0], |turn| turn.coords.into());
    if direction.norm() > 0.0 {
        turn
    } else {
        [0.0, 0.0, 0.0, 1.0]
    }
}
