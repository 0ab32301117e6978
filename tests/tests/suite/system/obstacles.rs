//! Obstacles: when each one is known and where, and the clearance of the body in every mode.

use std::ops::ControlFlow;

use cdcr_client::{Connection, FeedEvent, Line, ObstacleSender, TelemetryStream, obstacles};
use cdcr_shared_types::codes::{EventKind, Mode, ObstacleShape, Outcome, RequestKind, guard};
use cdcr_shared_types::{Header, Obstacle, ObstacleUpdate, Service, Telemetry, ipc};
use cdcr_tests::{
    Daemon, PATIENT, ROBOT, TIMEOUT, ask_for, ball, tracked, wait_record, wait_status,
};
use iceoryx2::prelude::Node;

/// The safe distance of the default configuration.
const SAFE_DISTANCE_M: f64 = 0.01;

/// A client that sends obstacles and receives the outcomes.
struct Client {
    sender: ObstacleSender,
    telemetry: TelemetryStream,
}

impl Client {
    fn new(connection: &Connection) -> Self {
        Self {
            sender: connection.obstacle_sender().unwrap(),
            telemetry: connection.telemetry().unwrap(),
        }
    }

    /// The daemon's outcome of a message, and its detail.
    fn outcome_of(&mut self, header: &Header) -> (Outcome, u32) {
        let event = self
            .telemetry
            .event_on(EventKind::Obstacles, header, TIMEOUT)
            .unwrap();
        (Outcome::try_from(event.outcome).unwrap(), event.detail)
    }

    fn upsert(&mut self, obstacles: &[Obstacle]) -> (Outcome, u32) {
        let header = self.sender.upsert(obstacles).unwrap();
        self.outcome_of(&header)
    }

    /// Waits for a record with exactly these obstacles.
    fn wait_ids(&mut self, ids: &[u32]) -> Telemetry {
        wait_record(&mut self.telemetry, |record| {
            obstacles(record)
                .iter()
                .map(|o| o.id)
                .eq(ids.iter().copied())
        })
    }
}

#[test]
fn obstacles_of_all_clients_come_and_go_by_their_ids() {
    // Ideal, because clearances are compared exactly.
    let daemon = Daemon::ideal(PATIENT);
    let (connection, other) = (daemon.connect(), daemon.connect());
    let (mut client, mut second) = (Client::new(&connection), Client::new(&other));
    let record = client.wait_ids(&[]);
    assert_eq!(record.clearance_m, f64::INFINITY);

    let [one, two, three] = [1, 2, 3].map(|id| ball(id, [0.3, 0.0, 0.1 * f64::from(id)]));
    assert_eq!(client.upsert(&[one, two]), (Outcome::Accepted, 2));
    assert_eq!(second.upsert(&[three]), (Outcome::Accepted, 3));
    let record = client.wait_ids(&[1, 2, 3]);
    // 0.3 m to the axis of the straight robot, less both radii.
    assert!((record.clearance_m - 0.265).abs() < 1e-12);
    let status = wait_status(&connection, |status| status.obstacle_count == 3);
    assert_eq!(status.clearance_m, record.clearance_m);

    let nearer = ball(2, [0.2, 0.0, 0.2]);
    assert_eq!(second.upsert(&[nearer]), (Outcome::Accepted, 3));
    let record = wait_record(&mut client.telemetry, |r| r.clearance_m < 0.2);
    assert_eq!(obstacles(&record)[1].start_m, nearer.start_m);
    let header = second.sender.remove(&[1, 99]).unwrap();
    assert_eq!(second.outcome_of(&header), (Outcome::Accepted, 2));
    client.wait_ids(&[2, 3]);
    let header = client.sender.clear().unwrap();
    assert_eq!(client.outcome_of(&header), (Outcome::Accepted, 0));
    client.wait_ids(&[]);
    wait_status(&connection, |status| {
        status.obstacle_count == 0 && status.clearance_m == f64::INFINITY
    });
}

#[test]
fn lifetimes_count_from_the_stamp_of_the_obstacle() {
    let daemon = Daemon::start(PATIENT);
    let connection = daemon.connect();
    let mut client = Client::new(&connection);
    let lasting = ball(1, [0.4, 0.0, 0.5]);
    let fleeting = Obstacle {
        lifetime_ns: 400_000_000,
        ..ball(2, [0.4, 0.0, 0.6])
    };
    let expires_ns = fleeting.measured_ns + fleeting.lifetime_ns;
    assert_eq!(client.upsert(&[lasting]), (Outcome::Accepted, 1));
    // On a stalled machine its lifetime may pass before it arrives: then it is rejected for that reason.
    let (outcome, _) = client.upsert(&[fleeting]);
    assert!(matches!(outcome, Outcome::Accepted | Outcome::InThePast));
    wait_record(&mut client.telemetry, |record| {
        let known = obstacles(record);
        if record.release_ns < expires_ns {
            let left = known.iter().find(|o| o.id == 2).map(|o| o.lifetime_ns);
            assert!(left.is_none_or(|left_ns| record.release_ns + left_ns == expires_ns));
            return false;
        }
        assert_eq!(known.len(), 1, "{} ns late", record.release_ns - expires_ns);
        assert_eq!((known[0].id, known[0].lifetime_ns), (1, 0));
        record.release_ns > expires_ns + 100_000_000
    });
    let past = Obstacle {
        measured_ns: fleeting.measured_ns,
        ..fleeting
    };
    assert_eq!(client.upsert(&[past]), (Outcome::InThePast, 0));
}

#[test]
fn moving_obstacles_are_predicted_to_each_release() {
    let daemon = Daemon::start(PATIENT);
    let connection = daemon.connect();
    let mut client = Client::new(&connection);
    let moving = Obstacle {
        shape: ObstacleShape::Capsule.code(),
        end_m: [0.5, 0.4, 0.0],
        velocity_m_s: [0.01, -0.02, 0.03],
        ..ball(5, [0.5, 0.0, 0.0])
    };
    assert_eq!(client.upsert(&[moving]), (Outcome::Accepted, 1));
    for _ in 0..20 {
        let record = wait_record(&mut client.telemetry, |record| record.obstacle_count == 1);
        let [used] = obstacles(&record) else {
            panic!("one obstacle");
        };
        assert_eq!(used.measured_ns, record.release_ns);
        let age_s = (record.release_ns as f64 - moving.measured_ns as f64) * 1e-9;
        for i in 0..3 {
            let by_m = moving.velocity_m_s[i] * age_s;
            assert!((used.start_m[i] - moving.start_m[i] - by_m).abs() < 1e-6);
            assert!((used.end_m[i] - moving.end_m[i] - by_m).abs() < 1e-6);
        }
    }
}

#[test]
fn a_bad_update_is_refused_whole_and_counted() {
    // Ideal, because clearances are compared exactly.
    let daemon = Daemon::ideal(PATIENT);
    let connection = daemon.connect();
    let mut client = Client::new(&connection);
    let good = ball(1, [0.3, 0.0, 0.3]);
    let nan = Obstacle {
        radius_m: f64::NAN,
        ..ball(2, [0.3, 0.0, 0.4])
    };
    assert_eq!(client.upsert(&[good, nan]), (Outcome::NotFinite, 1));
    let odd = Obstacle { shape: 9, ..good };
    assert_eq!(client.upsert(&[good, odd]), (Outcome::UnknownCode, 1));
    let all: Vec<_> = (0..64).map(|id| ball(id, [0.3, 0.0, 0.3])).collect();
    assert_eq!(client.upsert(&all), (Outcome::Accepted, 64));
    let nearer = ball(1, [0.1, 0.0, 0.3]);
    let one_more = ball(64, [0.3, 0.0, 0.3]);
    assert_eq!(client.upsert(&[nearer, one_more]), (Outcome::BufferFull, 1));
    // A message that the client library cannot send.
    let node: Node<ipc::Service> = daemon
        .place()
        .location()
        .node_builder()
        .unwrap()
        .create()
        .unwrap();
    let service = node
        .service_builder(&Service::Obstacles.name(ROBOT).unwrap())
        .publish_subscribe::<ObstacleUpdate>()
        .open()
        .unwrap();
    let publisher = service.publisher_builder().create().unwrap();
    for (action, count, outcome) in [
        (3, 0, Outcome::UnknownCode),
        (0, 65, Outcome::CountOutOfRange),
    ] {
        let header = Header {
            sender_id: 7,
            sequence: u64::from(action + count),
            sent_ns: 0,
        };
        let update = ObstacleUpdate {
            header,
            action,
            count,
            ..ObstacleUpdate::default()
        };
        publisher.send_copy(update).unwrap();
        assert_eq!(client.outcome_of(&header), (outcome, 0));
    }
    let status = wait_status(&connection, |status| status.obstacles_refused == 5);
    assert_eq!(status.outcomes[Outcome::UnknownCode.code() as usize], 2);
    let record = wait_record(&mut client.telemetry, |_| true);
    assert_eq!(record.obstacle_count, 64);
    assert!(
        (record.clearance_m - 0.265).abs() < 1e-12,
        "nothing of them counts"
    );
    let too_many = client.sender.remove(&[0; 65]).expect_err("65 ids");
    assert!(too_many.to_string().contains("at most 64"), "{too_many}");
}

/// Checks the clearance of the body from obstacles at rest, record by record.
#[derive(Default)]
struct Watch {
    before: Option<Telemetry>,
    skipped: bool,
    records: u64,
    guarded: u64,
    least_m: Option<f64>,
}

impl Watch {
    fn look(&mut self, record: &Telemetry) {
        if record.obstacle_count == 0 {
            return;
        }
        self.records += 1;
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
    format!("{PATIENT}[safety]\nclearance_fault_m = -1.0\n")
}

/// Tracks towards an obstacle. Returns the number of interventions of the guard.
fn track_into_obstacle(configuration: &str) -> u64 {
    // Ideal, because the clearances of consecutive records are compared exactly.
    let daemon = Daemon::ideal(configuration);
    let connection = daemon.connect();
    let mut client = Client::new(&connection);
    // On the path of the tip.
    let in_the_way = ball(1, [0.07, 0.0, 0.88]);
    assert_eq!(client.upsert(&[in_the_way]).0, Outcome::Accepted);
    client.wait_ids(&[1]);
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
fn an_obstacle_inside_the_safe_distance_is_never_approached() {
    // Ideal, because clearances are compared exactly.
    let daemon = Daemon::ideal(&bearing_contact());
    let connection = daemon.connect();
    let mut client = Client::new(&connection);
    // 5 mm beside the straight robot, in the direction of the line.
    let beside = ball(1, [0.04, 0.0, 0.85]);
    assert_eq!(client.upsert(&[beside]).0, Outcome::Accepted);
    let first = client.wait_ids(&[1]);
    assert!((first.clearance_m - 0.005).abs() < 1e-12);
    let mut watch = Watch::default();
    track_line(&connection, &mut watch);
    assert!(
        watch.least_m.unwrap() >= 0.005 - 1e-9,
        "{:?}",
        watch.least_m
    );
}

#[test]
fn the_way_home_is_guarded_too() {
    let bent = "[link]\ninitial_bend_rad = [[0.8, 0.0], [0.0, 0.0], [0.0, 0.0]]\n";
    // Ideal, because the clearances of consecutive records are compared exactly.
    let daemon = Daemon::ideal(&format!("{}{bent}", bearing_contact()));
    let connection = daemon.connect();
    let mut client = Client::new(&connection);
    // Between the bent robot and the straight one.
    let between = ball(1, [0.15, 0.0, 0.7]);
    assert_eq!(client.upsert(&[between]).0, Outcome::Accepted);
    client.wait_ids(&[1]);
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
    let header = client.sender.clear().unwrap();
    assert_eq!(client.outcome_of(&header).0, Outcome::Accepted);
    wait_record(&mut client.telemetry, |record| {
        record.mode == Mode::Holding.code()
    });
}
