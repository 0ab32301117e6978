//! A real daemon, a client that sends invalid messages on every service, and a client that checks.

use cdcr_client::{Connection, Driver, TelemetryStream, monotonic_ns};
use cdcr_shared_types::codes::{Interface, MeasurementKind, Mode, RequestKind};
use cdcr_shared_types::{
    Header, Measurement, ObstacleUpdate, ReferenceChunk, Request, Response, Service, Status, ipc,
};
use cdcr_test_cases::cases_asked;
use cdcr_tests::{Daemon, Place, ROBOT, STALL_TOLERANT, TIMEOUT, wait_status, wait_until};
use iceoryx2::pending_response::PendingResponse;
use iceoryx2::port::client::Client;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::prelude::{BackpressureStrategy, Node, ZeroCopySend};
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::TestRunner;

use crate::chaos::limits;
use crate::fuzz::draft::{self, Draft, lay_out};
use crate::fuzz::fields::Fields;
use crate::fuzz::script::{Robot, Step};

/// Sender id of the invalid messages.
const STRANGER: u64 = 0xbad;
/// Messages of each kind that are sent at once: at most half of the queue of one writer.
const BURST: [(Kind, usize); 4] = [
    (Kind::Reference, 16),
    (Kind::Obstacles, 8),
    (Kind::Measurement, 8),
    (Kind::Request, 1),
];
/// Requests before the invalid messages, so that the robot moves. With them a client has its largest number
/// of requests.
const REQUESTS: [RequestKind; 3] = [
    RequestKind::AcquireLease,
    RequestKind::Reset,
    RequestKind::Track,
];
const _: () = assert!(REQUESTS.len() < Service::CONTROL_REQUESTS);

#[derive(Debug, Clone, Copy)]
enum Kind {
    Reference,
    Obstacles,
    Measurement,
    Request,
}

/// An invalid message of one kind: arbitrary bytes, or a nearly valid message at `now_ns`.
fn nonsense(kind: Kind, now_ns: u64) -> BoxedStrategy<Step> {
    fn any_bytes<T: Fields + Default + 'static>(to_step: fn(T) -> Step) -> BoxedStrategy<Step> {
        let bytes = draft::bytes(size_of::<T>());
        bytes
            .prop_map(move |bytes| to_step(T::from_bytes(&bytes)))
            .boxed()
    }
    fn near(drafts: impl Strategy<Value = Draft> + 'static, now_ns: u64) -> BoxedStrategy<Step> {
        let robot = Robot {
            sections: 3,
            driver: 1,
        };
        let lay_out = move |draft| lay_out(now_ns, robot, vec![draft]).0.remove(1);
        drafts.prop_map(lay_out).boxed()
    }
    let (any, near) = match kind {
        Kind::Reference => (any_bytes(Step::Chunk), near(draft::chunk(), now_ns)),
        Kind::Obstacles => (any_bytes(Step::Update), near(draft::update(), now_ns)),
        Kind::Measurement => (
            any_bytes(Step::Measurement),
            near(draft::measurement(), now_ns),
        ),
        Kind::Request => (any_bytes(Step::Request), near(draft::request(), now_ns)),
    };
    prop_oneof![1 => any, 4 => near].boxed()
}

/// A client that knows the services and violates their rules.
struct Stranger {
    runner: TestRunner,
    reference: Publisher<ipc::Variant, ReferenceChunk, ()>,
    obstacles: Publisher<ipc::Variant, ObstacleUpdate, ()>,
    measurement: Publisher<ipc::Variant, Measurement, ()>,
    control: Client<ipc::Variant, Request, (), Response, ()>,
    /// Requests without an answer; their answers are not read.
    pending: Vec<PendingResponse<ipc::Variant, Request, (), Response, ()>>,
    sequence: u64,
    sent: u64,
    _node: Node<ipc::Variant>,
}

fn publisher<T: ZeroCopySend + std::fmt::Debug + 'static>(
    node: &Node<ipc::Variant>,
    service: Service,
) -> Publisher<ipc::Variant, T, ()> {
    let name = service.name(ROBOT).unwrap();
    let topic = node.service_builder(&name).publish_subscribe::<T>();
    let opened = topic.open().unwrap();
    let publisher = opened.publisher_builder();
    publisher
        .backpressure_strategy(BackpressureStrategy::DiscardData)
        .create()
        .unwrap()
}

impl Stranger {
    fn arrive(place: &Place) -> Self {
        let node = place.location().node_builder().unwrap();
        let node = node.create::<ipc::Variant>().unwrap();
        let name = Service::Control.name(ROBOT).unwrap();
        let control = node.service_builder(&name);
        let control = control.request_response::<Request, Response>();
        let opened = control.open().unwrap();
        let control = opened.client_builder();
        let control = control.backpressure_strategy(BackpressureStrategy::DiscardData);
        Self {
            runner: TestRunner::deterministic(),
            reference: publisher(&node, Service::Reference),
            obstacles: publisher(&node, Service::Obstacles),
            measurement: publisher(&node, Service::Measurement),
            control: control.create().unwrap(),
            pending: Vec::new(),
            sequence: 0,
            sent: 0,
            _node: node,
        }
    }

    /// Some messages of every kind, each passed to `send` immediately.
    fn draw(&mut self, mut send: impl FnMut(&mut Self, Step)) {
        for kind in REQUESTS {
            let request = Request {
                kind: kind.code(),
                ..Request::default()
            };
            send(self, Step::Request(request));
        }
        for (kind, count) in BURST {
            for _ in 0..count {
                let tree = nonsense(kind, monotonic_ns()).new_tree(&mut self.runner);
                send(self, tree.unwrap().current());
            }
        }
    }

    fn burst(&mut self) {
        self.pending.clear();
        self.draw(|stranger, step| stranger.send(&step));
    }

    /// Bursts at the highest rate, because the messages are prepared before.
    fn flood(&mut self) {
        let mut steps = Vec::new();
        for _ in 0..10 {
            self.draw(|_, step| steps.push(step));
        }
        for _ in 0..10 {
            for step in &steps {
                if self.pending.len() == REQUESTS.len() + 1 {
                    self.pending.clear();
                }
                self.send(step);
            }
        }
    }

    /// Sends a message; one without a header gets one, so that it is not rejected for that alone.
    fn send(&mut self, step: &Step) {
        let header = self.next_header();
        let with = |given: Header| {
            if given == Header::default() {
                header
            } else {
                given
            }
        };
        match step {
            Step::Chunk(chunk) => {
                let header = with(chunk.header);
                let message = ReferenceChunk { header, ..*chunk };
                self.reference.send_copy(message).unwrap();
            }
            Step::Update(update) => {
                let header = with(update.header);
                let message = ObstacleUpdate { header, ..*update };
                self.obstacles.send_copy(message).unwrap();
            }
            Step::Measurement(measurement) => {
                let header = with(measurement.header);
                let message = Measurement {
                    header,
                    ..*measurement
                };
                self.measurement.send_copy(message).unwrap();
            }
            Step::Request(request) => {
                let header = with(request.header);
                let message = Request { header, ..*request };
                self.pending.push(self.control.send_copy(message).unwrap());
            }
            Step::Robot(_) | Step::Run(_) => panic!("no message"),
        }
        self.sent += 1;
    }

    fn next_header(&mut self) -> Header {
        self.sequence += 1;
        Header {
            sender_id: STRANGER,
            sequence: self.sequence,
            sent_ns: monotonic_ns(),
        }
    }
}

/// A correct client. It reads every record, and checks that all commands are finite.
struct Watcher {
    connection: Connection,
    telemetry: TelemetryStream,
    driver: Driver,
    records: u64,
    follows: bool,
}

impl Watcher {
    fn arrive(daemon: &Daemon) -> Self {
        let connection = daemon.connect();
        Self {
            telemetry: connection.telemetry().unwrap(),
            driver: connection.driver(Interface::Velocity).unwrap(),
            connection,
            records: 0,
            follows: false,
        }
    }

    fn look(&mut self) -> Status {
        while let Some(record) = self.telemetry.try_next().unwrap() {
            limits::check_finite(&record.command).unwrap();
            self.records += 1;
            self.follows |= record.mode == Mode::Tracking.code();
        }
        self.connection.status(TIMEOUT).unwrap()
    }

    /// Number of counted messages, including those of the last moments.
    fn settled(&self) -> u64 {
        let begin_ns = monotonic_ns();
        let first = wait_status(&self.connection, |status| status.header.sent_ns > begin_ns);
        let then = wait_status(&self.connection, |status| status.cycles > first.cycles + 10);
        counted(&then)
    }

    /// Waits until the daemon has counted exactly `count` messages.
    fn wait_for(&mut self, count: u64) {
        wait_until("every message is counted", || {
            let status = self.look();
            assert!(counted(&status) <= count, "{:?}", status.outcomes);
            counted(&status) == count
        });
    }

    /// Removes the obstacles, measures a straight robot, and makes the daemon hold it.
    fn recover(&mut self) {
        let obstacles = self.connection.obstacle_sender().unwrap();
        wait_until("the daemon holds the robot", || {
            self.measure();
            obstacles.clear().unwrap();
            // Rejected while the daemon still uses the invalid measurements.
            let _ = self.connection.reset(true);
            let _ = self.connection.request(RequestKind::Hold);
            self.look().mode == Mode::Holding.code()
        });
    }

    fn measure(&self) {
        let message = Measurement {
            measured_ns: monotonic_ns(),
            kind: MeasurementKind::Configuration.code(),
            sections: 3,
            ..Measurement::default()
        };
        self.driver.send(message).unwrap();
    }
}

fn counted(status: &Status) -> u64 {
    status.outcomes.iter().sum()
}

/// Sends invalid messages to a daemon with this kind of robot, and waits after each burst until all are
/// counted.
fn outlives(link: &str, must_follow: bool) {
    let daemon = Daemon::start(&format!(
        "{STALL_TOLERANT}[link]\nkind = {link:?}\nmeasurement_timeout_ms = 10000.0\n"
    ));
    let mut watcher = Watcher::arrive(&daemon);
    watcher.recover();
    let before = watcher.settled();
    let mut stranger = Stranger::arrive(daemon.place());
    let least = cases_asked().unwrap_or(0).max(15);
    for burst in 0.. {
        stranger.burst();
        watcher.wait_for(before + stranger.sent);
        if burst >= least && (watcher.follows || !must_follow) {
            break;
        }
        assert!(burst < least + 100, "the robot never followed a reference");
    }
    let outcomes = watcher.look().outcomes;
    let (accepted, all) = (outcomes[0], outcomes.iter().sum::<u64>());
    println!(
        "{link}: {accepted} of {all} accepted, {} records",
        watcher.records
    );
    assert!(
        accepted * 20 > all && accepted * 4 < all * 3,
        "{outcomes:?}"
    );

    // Messages beyond the queues are lost, without an effect on the daemon.
    stranger.flood();
    drop(stranger);
    watcher.recover();
    let (records, cycles) = (watcher.records, watcher.look().cycles);
    wait_until("the loop goes on", || {
        watcher.measure();
        let status = watcher.look();
        watcher.records > records + 20 && status.cycles > cycles + 20
    });
}

#[test]
fn a_daemon_with_a_driver_outlives_a_client_that_sends_nonsense() {
    outlives("driver", false);
}

#[test]
fn a_daemon_with_a_simulated_robot_outlives_a_client_that_sends_nonsense() {
    outlives("simulated", true);
}
