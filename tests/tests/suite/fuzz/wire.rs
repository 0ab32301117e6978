//! Messages of clients and drivers: arbitrary bytes, nearly valid messages, and whole scripts of them.

use cdcr_controller::estimator::Estimator;
use cdcr_controller::reference::{
    Orientation, POINT_SPACING_MIN_NS, ReferencePoint, ReferenceState, ReferenceWindow, Trajectory,
};
use cdcr_controller::robot::{Configuration, Robot, RobotParameters, Shape};
use cdcr_daemon::convert::{
    measurement, mode_request, reference_points, settings_from_wire, settings_to_wire,
    updated_obstacles,
};
use cdcr_daemon::obstacles::ObstacleSet;
use cdcr_shared_types as message;
use cdcr_shared_types::codes::{Interface, RequestKind};
use cdcr_shared_types::limits::{OBSTACLES_MAX, REFERENCE_POINTS_MAX};
use cdcr_test_cases::{Tally, replay, try_cases};
use proptest::prelude::*;

use crate::fuzz::draft::{self, Draft, lay_out};
use crate::fuzz::fields::Fields;
use crate::fuzz::rig;
use crate::fuzz::script::{self, BEGIN_NS, PERIOD_NS, Script, Step};

fn robot(sections: u32) -> Robot {
    Robot::new(&RobotParameters::paper(sections as usize)).unwrap()
}

/// Checks a message at the begin of the script's clock; accepted messages must be usable. Returns whether it
/// was accepted.
fn evaluate(step: &Step, robot: &Robot) -> bool {
    match step {
        Step::Robot(_) | Step::Run(_) => true,
        Step::Chunk(chunk) => accepts_chunk(chunk, robot),
        Step::Update(update) => accepts_update(update),
        Step::Measurement(message) => accepts_measurement(message, robot),
        Step::Request(request) => accepts_request(request),
    }
}

fn accepts_chunk(chunk: &message::ReferenceChunk, robot: &Robot) -> bool {
    let points: Vec<ReferencePoint> = match reference_points(chunk, robot, BEGIN_NS) {
        Ok(points) => points.collect(),
        Err(refused) => {
            assert!(refused.detail <= chunk.count);
            return false;
        }
    };
    assert_eq!(points.len(), chunk.count as usize);
    for point in &points {
        assert!(point.time_ns > BEGIN_NS && point.position_m.norm() <= robot.reach_m() + 2e-6);
        let length = match point.orientation {
            Orientation::Free => 1.0,
            Orientation::Axis(axis) | Orientation::Preferred(axis) => axis.norm(),
            Orientation::Full(full) => full.norm(),
        };
        assert!((length - 1.0).abs() < 1e-12, "{:?}", point.orientation);
    }
    let mut trajectory = Trajectory::with_capacity(REFERENCE_POINTS_MAX, robot.reach_m());
    let apart = |pair: &[ReferencePoint]| pair[1].time_ns >= pair[0].time_ns + POINT_SPACING_MIN_NS;
    let taken = trajectory.replace(points.iter().copied()).is_ok();
    assert_eq!(taken, points.windows(2).all(apart));
    if !taken {
        return false;
    }
    let mut window = ReferenceWindow::default();
    for near in points.iter().take(4) {
        let cycle = near.time_ns.saturating_sub(BEGIN_NS) / PERIOD_NS;
        let release_ns = BEGIN_NS + cycle * PERIOD_NS;
        if release_ns < u64::MAX / 2 {
            window.fill(&trajectory, cycle, release_ns, PERIOD_NS, 50, 0);
            for sample in window.ahead(cycle, 50) {
                assert!(sample.state != ReferenceState::None);
                let within_m = robot.reach_m() + 2e-6;
                assert!(sample.position_m.norm() <= within_m, "{sample:?}");
                if let Orientation::Axis(axis) | Orientation::Preferred(axis) = sample.orientation {
                    assert!((axis.norm() - 1.0).abs() < 1e-12, "{sample:?}");
                }
            }
        }
    }
    true
}

fn accepts_update(update: &message::ObstacleUpdate) -> bool {
    let Ok(set) = updated_obstacles(update, &ObstacleSet::default(), BEGIN_NS) else {
        return false;
    };
    assert!(set.count() <= (update.count as usize).min(OBSTACLES_MAX));
    for later_ns in [0, PERIOD_NS, 1 << 40, 1 << 62] {
        for known in set.iter_at(BEGIN_NS + later_ns) {
            let ends = match *known.obstacle.shape() {
                Shape::Sphere { centre_m } => [centre_m; 2],
                Shape::Capsule { start_m, end_m } => [start_m, end_m],
            };
            let radius_m = known.obstacle.radius_m();
            let mut numbers = ends.iter().flatten().chain([&radius_m]);
            assert!(numbers.all(|x| x.abs() <= 1e6), "{known:?}");
        }
    }
    true
}

fn accepts_measurement(message: &message::Measurement, robot: &Robot) -> bool {
    let Ok(timed) = measurement(message, robot, Interface::Velocity, BEGIN_NS) else {
        return false;
    };
    assert!(timed.measured_ns <= BEGIN_NS + 1_000_000);
    let age_s = (BEGIN_NS as f64 - timed.measured_ns as f64) * 1e-9;
    let mut estimator = Estimator::new(Configuration::straight(robot.section_count()));
    let estimate = estimator.correct(robot, &timed.measurement, age_s);
    assert_eq!(estimate.section_count(), robot.section_count());
    true
}

fn accepts_request(request: &message::Request) -> bool {
    let Ok(kind) = RequestKind::try_from(request.kind) else {
        return false;
    };
    if kind != RequestKind::Settings {
        let is_mode = matches!(
            kind,
            RequestKind::Track
                | RequestKind::Hold
                | RequestKind::Home
                | RequestKind::Stop
                | RequestKind::Reset
        );
        for accepts_pose in [false, true] {
            let request = mode_request(kind, accepts_pose, 0);
            assert_eq!(request.is_some(), is_mode, "{kind:?}");
        }
        return true;
    }
    let Ok(settings) = settings_from_wire(&request.settings, PERIOD_NS) else {
        return false;
    };
    let echo = message::SolverSettings {
        reserved: request.settings.reserved,
        ..settings_to_wire(&settings)
    };
    assert_eq!(echo, request.settings, "what is accepted is what was sent");
    true
}

fn try_bytes<T: Fields + Default + 'static>(to_step: impl Fn(T) -> Step) {
    let robot = robot(3);
    let bytes = draft::bytes(size_of::<T>());
    let steps = bytes.prop_map(|bytes| Script(vec![to_step(T::from_bytes(&bytes))]));
    try_cases(512, steps, |script| {
        evaluate(&script.0[0], &robot);
    });
}

#[test]
fn any_bytes_are_checked_without_a_panic() {
    try_bytes(Step::Chunk);
    try_bytes(Step::Update);
    try_bytes(Step::Measurement);
    try_bytes(Step::Request);
}

fn try_drafts(kind: &'static str, share: f64, drafts: impl Strategy<Value = Draft>) {
    let tally = Tally::default();
    let sections = prop_oneof![Just(1_u32), Just(3), Just(6)];
    let scripts = (sections, drafts).prop_map(|(sections, draft)| {
        let robot = script::Robot {
            sections,
            driver: 1,
        };
        lay_out(BEGIN_NS, robot, vec![draft])
    });
    try_cases(1024, scripts, |script| {
        let Step::Robot(script::Robot { sections, .. }) = script.0[0] else {
            panic!("a script begins with its robot");
        };
        tally.count(kind, evaluate(&script.0[1], &robot(sections)));
    });
    tally.both_at_least(kind, share);
}

#[test]
fn nearly_right_messages_are_taken_or_refused() {
    try_drafts("reference", 0.2, draft::chunk());
    try_drafts("obstacles", 0.15, draft::update());
    try_drafts("measurement", 0.2, draft::measurement());
    try_drafts("request", 0.15, draft::request());
}

#[test]
fn whatever_comes_the_commands_are_finite_and_inside_the_limits() {
    replay(
        concat!(env!("CARGO_MANIFEST_DIR"), "/corpus/wire"),
        |bytes| {
            let script = Script::parse(std::str::from_utf8(bytes).unwrap()).unwrap();
            for step in &script.0 {
                evaluate(step, &robot(3));
            }
            rig::play(&script, &Tally::default());
        },
    );
    let tally = Tally::default();
    try_cases(1024, draft::script(), |script| rig::play(&script, &tally));
    tally.both_at_least("played reference", 0.1);
    tally.both_at_least("played obstacles", 0.1);
    tally.both_at_least("played measurement", 0.1);
    tally.both_at_least("played request", 0.1);
    tally.happened("cycle that follows");
    tally.happened("cycle with a fault");
    tally.happened("cycle that is kept clear");
}
