use cdcr_controller::robot::{Robot, RobotParameters};
use cdcr_interchange::cdr::from_bytes;
use cdcr_interchange::standard::shape;
use cdcr_shared_types::Obstacle;
use cdcr_shared_types::codes::{Mode, ObstacleShape};
use serde::de::DeserializeOwned;

use super::*;

/// A record of the paper's robot with three sections, 0.2 m off its reference, near a sphere and a capsule.
fn record(cycle: u64) -> Telemetry {
    let robot = Robot::new(&RobotParameters::paper(3)).expect("the paper's");
    let mut record = Telemetry {
        cycle,
        release_ns: 1_000_000_000 + 5_000_000 * cycle,
        period_ns: 5_000_000,
        mode: Mode::Tracking.code(),
        tip_position_m: [0.0, 0.0, 0.9],
        tip_orientation: [0.0, 0.0, 0.0, 1.0],
        position_error_m: 0.2,
        clearance_m: 0.05,
        obstacle_count: 2,
        robot: (&robot).into(),
        ..Telemetry::default()
    };
    record.header.sender_id = 7;
    record.command.sections = 3;
    record.command.cable_length_m[8] = 0.9;
    record.reference.position_m = [0.0, 0.2, 0.9];
    record.settings.safe_distance_m = 0.1;
    let ball = Obstacle {
        start_m: [0.0, 0.15, 0.45],
        radius_m: 0.05,
        ..Obstacle::default()
    };
    let rod = Obstacle {
        shape: ObstacleShape::Capsule.code(),
        start_m: [1.0, -0.5, 0.0],
        end_m: [1.0, 0.5, 0.0],
        ..ball
    };
    record.obstacles[..2].copy_from_slice(&[ball, rod]);
    record
}

fn of<T: DeserializeOwned>(drawings: &[Drawing], channel: Drawn) -> Vec<T> {
    let these = drawings.iter().filter(|drawing| drawing.channel == channel);
    these
        .map(|drawing| from_bytes(&drawing.data).expect("such a message"))
        .collect()
}

#[test]
fn a_second_has_thirty_pictures_and_what_happens_once() {
    let mut drawings = Drawings::new("trunk", 5);
    let mut all = Vec::new();
    for cycle in 0..200 {
        all.extend(drawings.encode(&record(cycle)).expect("encoded"));
    }
    assert_eq!(of::<MarkerArray>(&all, Drawn::Scene).len(), 30);
    let log = of::<Log>(&all, Drawn::Log);
    assert_eq!(log.len(), 1);
    assert!(log[0].msg.starts_with("tracking"), "{log:?}");
    assert_eq!((log[0].stamp.sec, log[0].stamp.nanosec), (1, 5));
    let poses = of::<PoseStamped>(&all, Drawn::Reference);
    assert_eq!(poses[0].pose.position.y, 0.2);
    let cables = of::<JointState>(&all, Drawn::Cables);
    assert_eq!((cables[0].name.len(), cables[0].position[8]), (9, 0.9));
    assert_eq!(cables[0].name[8], "section_3_cable_3");
    let transforms = &of::<TfMessage>(&all, Drawn::Transforms)[0].transforms;
    let names: Vec<_> = transforms.iter().map(|t| &*t.child_frame_id).collect();
    assert_eq!(
        names,
        [
            "trunk/section_1",
            "trunk/section_2",
            "trunk/section_3",
            "trunk/tip"
        ]
    );
    assert_eq!(transforms[0].header.frame_id, "trunk/base");
}

#[test]
fn a_scene_shows_body_obstacles_and_the_gap_between() {
    let mut drawings = Drawings::new("trunk", 0);
    let mut all = Vec::new();
    for cycle in 0..20 {
        all.extend(drawings.encode(&record(cycle)).expect("encoded"));
    }
    let scenes = of::<MarkerArray>(&all, Drawn::Scene);
    let markers = &scenes.last().expect("a scene").markers;
    assert_eq!(markers[0].action, shape::DELETE_ALL);
    let named = |name: &str| -> Vec<_> { markers.iter().filter(|m| m.ns == name).collect() };
    let radius_m = RobotParameters::paper(3).sections[0].body_radius_m;
    assert_eq!(named("body").len(), 3);
    assert_eq!(named("body")[0].scale.x, 2.0 * radius_m);
    assert_eq!(named("discs").len(), 15);
    // The last disc is at the end of the straight robot.
    assert!((named("discs")[14].pose.position.z - 0.9).abs() < 1e-12);
    assert_eq!(named("tip way")[0].points.len(), 2);
    // The sphere is within the safe distance, the capsule is not: two ends and a cylinder.
    let obstacles = named("obstacles");
    assert_eq!(obstacles.len(), 4);
    assert!(obstacles[0].color.r > 0.8 && obstacles[1].color.r < 0.7);
    assert_eq!(
        (obstacles[3].kind, obstacles[3].scale.z),
        (shape::CYLINDER, 1.0)
    );
    let gap = &named("nearest")[0].points;
    assert!(
        (gap[1].y - 0.1).abs() < 1e-9 && gap[0].y.abs() < 1e-9,
        "{gap:?}"
    );
    assert!(named("text")[0].text.contains("error 200.00 mm"));
    let ids: Vec<_> = markers.iter().map(|marker| marker.id).collect();
    assert!(ids.is_sorted_by(|a, b| a < b));
}

#[test]
fn a_shape_that_is_no_number_is_not_drawn() {
    let mut drawings = Drawings::new("trunk", 0);
    let mut bad = record(0);
    bad.present_rad[1] = f64::NAN;
    bad.position_error_m = f64::NAN;
    let all = drawings.encode(&bad).expect("encoded");
    let channels: Vec<_> = all.iter().map(|drawing| drawing.channel).collect();
    assert_eq!(channels, [Drawn::Log, Drawn::Cables]);
}

#[test]
fn a_direction_has_its_shortest_turn() {
    use super::super::scene::upright_to;
    assert_eq!(upright_to([0.0, 0.0, 2.0].into()), [0.0, 0.0, 0.0, 1.0]);
    assert_eq!(upright_to([0.0, 0.0, -1.0].into()), [1.0, 0.0, 0.0, 0.0]);
    let [x, y, z, w] = upright_to([1.0, 0.0, 0.0].into());
    let half = 0.5_f64.sqrt();
    assert!((y - half).abs() < 1e-12 && (w - half).abs() < 1e-12 && (x, z) == (0.0, 0.0));
    assert_eq!(upright_to([0.0; 3].into()), [0.0, 0.0, 0.0, 1.0]);
}
