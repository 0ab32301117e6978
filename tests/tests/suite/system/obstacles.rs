//! The clearance of the body from obstacles, in each mode that moves the robot.

use std::ops::ControlFlow;

use cdcr_client::{Connection, FeedEvent, Line, ObstacleSender, TelemetryStream};
use cdcr_shared_types::codes::{Mode, RequestKind, guard};
use cdcr_shared_types::{Obstacle, Telemetry};
use cdcr_tests::{
    Daemon, STALL_TOLERANT, ask_for, ball, tracked, wait_mode, wait_record, wait_status,
};

/// The safe distance of the default configuration.
const SAFE_DISTANCE_M: f64 = 0.01;

/// A client whose obstacle the daemon knows.
struct Client {
    sender: ObstacleSender,
    telemetry: TelemetryStream,
}

impl Client {
    fn with(connection: &Connection, obstacle: Obstacle) -> Self {
        let sender = connection.obstacle_sender().unwrap();
        let mut telemetry = connection.telemetry().unwrap();
        sender.upsert(&[obstacle]).unwrap();
        wait_record(&mut telemetry, |record| record.obstacle_count == 1);
        Self { sender, telemetry }
    }
}

/// Checks the clearance of the body from obstacles at rest, record by record.
#[derive(Default)]
struct Watch {
    before: Option<Telemetry>,
    skipped: bool,
    guarded: u64,
    least_m: Option<f64>,
}

impl Watch {
    fn look(&mut self, record: &Telemetry) {
        if record.obstacle_count == 0 {
            return;
        }
        self.guarded += u64::from(record.guard_flags & guard::CLEARANCE != 0);
        if let Some(before) = self.before.replace(*record) {
            // Rates that last longer than the period they were checked for may go too far.
            let one_period = record.cycle == before.cycle + 1;
            self.skipped |= !one_period;
            // A ramp to rest may end within the millimetre that the command before it was allowed.
            let is_ramp = ![Mode::Tracking, Mode::Homing]
                .map(Mode::code)
                .contains(&before.mode);
            let kept_m = SAFE_DISTANCE_M - if is_ramp { 1.001e-3 } else { 0.0 };
            let floor_m = before.clearance_m.min(kept_m);
            assert!(
                !one_period || record.clearance_m >= floor_m - 1e-9,
                "{} m after {} m in cycle {}",
                record.clearance_m,
                before.clearance_m,
                record.cycle
            );
        }
        if !self.skipped {
            let least_m = self.least_m.unwrap_or(f64::INFINITY);
            self.least_m = Some(least_m.min(record.clearance_m));
        }
    }
}

/// Feeds the paper's line and tracks it to its end.
fn track_line(connection: &Connection, watch: &mut Watch) {
    let mut cycles = 0;
    connection
        .feed(&Line::for_sections(&[0.3; 3]), tracked())
        .unwrap()
        .run(|event| {
            if let FeedEvent::Record(record) = event {
                cycles += u64::from(record.mode == Mode::Tracking.code());
                watch.look(record);
            }
            ControlFlow::Continue(())
        })
        .unwrap();
    assert!(cycles > 50, "{cycles}");
}

/// While the machine stalls, the rates are constant and may move the body into an obstacle. The records are
/// checked for that, and it must not end the test.
fn bearing_contact() -> String {
    format!("{STALL_TOLERANT}[safety]\nclearance_fault_m = -1.0\n")
}

/// Tracks towards an obstacle. Returns the number of interventions of the guard.
fn track_into_obstacle(configuration: &str) -> u64 {
    // Ideal, because the clearances of consecutive records are compared exactly.
    let daemon = Daemon::ideal(configuration);
    let connection = daemon.connect();
    // On the path of the tip.
    let _client = Client::with(&connection, ball(1, [0.07, 0.0, 0.88]));
    let mut watch = Watch::default();
    track_line(&connection, &mut watch);
    let least_m = watch.least_m.unwrap();
    assert!(least_m >= SAFE_DISTANCE_M - 1e-4, "{least_m}");
    assert!(watch.skipped || least_m < 0.02, "it came near: {least_m}");
    watch.guarded
}

#[test]
fn a_tracking_robot_keeps_the_safe_distance() {
    track_into_obstacle(&bearing_contact());
}

#[test]
fn the_guard_alone_keeps_the_safe_distance() {
    // The solver's cost ignores obstacles, so that the guard has to act.
    let blind = "[controller]\nobstacle_step_penalty = 0.0\nobstacle_slope_penalty = 0.0\n";
    let guarded = track_into_obstacle(&format!("{}{blind}", bearing_contact()));
    assert!(guarded > 10, "{guarded}");
}

#[test]
fn the_way_home_is_guarded_too() {
    let bent = "[link]\ninitial_bend_rad = [[0.8, 0.0], [0.0, 0.0], [0.0, 0.0]]\n";
    // Ideal, because the clearances of consecutive records are compared exactly.
    let daemon = Daemon::ideal(&format!("{}{bent}", bearing_contact()));
    let connection = daemon.connect();
    // Between the bent robot and the straight one.
    let mut client = Client::with(&connection, ball(1, [0.15, 0.0, 0.7]));
    ask_for(&connection, RequestKind::Home);
    let mut watch = Watch::default();
    wait_record(&mut client.telemetry, |record| {
        watch.look(record);
        watch.guarded > 100
    });
    let least_m = watch.least_m.unwrap();
    assert!(least_m >= SAFE_DISTANCE_M - 1e-4, "{least_m}");
    wait_status(&connection, |status| status.clearance_guarded > 100);
    // It continues when the path is clear.
    client.sender.clear().unwrap();
    wait_mode(&mut client.telemetry, Mode::Holding);
}

/// Speed of the tip over the time between the records \[m/s\].
fn tip_speed_m_s(before: &Telemetry, after: &Telemetry) -> f64 {
    let moved_m: f64 = (before.tip_position_m.iter().zip(after.tip_position_m))
        .map(|(before_m, after_m)| (after_m - before_m).powi(2))
        .sum();
    moved_m.sqrt() / ((after.release_ns - before.release_ns) as f64 * 1e-9)
}

#[test]
fn a_tip_that_an_obstacle_held_returns_at_its_pace_when_it_is_gone() {
    const AWAY_M: f64 = 0.06;
    let daemon = Daemon::start(&bearing_contact());
    let connection = daemon.connect();
    let sender = connection.obstacle_sender().unwrap();
    let line = Line {
        start_m: [0.1, 0.0, 0.8],
        velocity_m_s: [0.032, 0.0, -0.015],
        duration_s: 11.0,
        tip_axis: None,
    };
    let speed_m_s = line.velocity_m_s[0].hypot(line.velocity_m_s[2]);
    let mut hand = Obstacle {
        radius_m: 0.2,
        ..ball(1, [0.5, 0.0, 0.7])
    };
    // The approach to the line takes 3 s of it.
    let (mut comes_ns, mut is_gone) = (u64::MAX, false);
    let (mut fastest_m_s, mut errors) = (0.0_f64, Vec::new());
    let mut begin: Option<Telemetry> = None;
    let feeder = connection.feed(&line, tracked()).unwrap();
    let run = feeder.run(|event| {
        match event {
            FeedEvent::Scheduled { start_ns } => comes_ns = start_ns + 4_000_000_000,
            FeedEvent::Record(record) if record.release_ns > comes_ns => {
                if hand.measured_ns != 0 {
                    sender.upsert(&[hand]).unwrap();
                    hand.measured_ns = 0;
                }
                if !is_gone && record.position_error_m > AWAY_M {
                    sender.clear().unwrap();
                    is_gone = true;
                }
                let before = begin.get_or_insert(*record);
                if record.release_ns >= before.release_ns + 50_000_000 {
                    if is_gone {
                        fastest_m_s = fastest_m_s.max(tip_speed_m_s(before, record));
                    }
                    begin = Some(*record);
                }
                errors.push((record.release_ns, record.position_error_m));
            }
            _ => {}
        }
        ControlFlow::Continue(())
    });
    run.unwrap();
    assert!(is_gone, "{errors:?}");
    // The largest speed of the approach is 0.1 m/s by default; noise of the encoders.
    let gentle_m_s = 1.1 * (0.1 + speed_m_s);
    assert!(fastest_m_s < gentle_m_s, "{fastest_m_s}");
    // The last record may be that of a cycle after a stall.
    let end_ns = errors.last().map_or(0, |(release_ns, _)| *release_ns);
    let last = errors
        .iter()
        .filter(|(release_ns, _)| release_ns + 1_000_000_000 > end_ns);
    let error_m = last
        .map(|(_, error_m)| *error_m)
        .fold(f64::INFINITY, f64::min);
    assert!(error_m < 1e-3, "{error_m}");
}
