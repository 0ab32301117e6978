//! A daemon that plays by the wire contract and controls nothing: its robot is always where the
//! reference is. It lets the client be tested on its own.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use cdcr_client::{Message, monotonic_ns};
use cdcr_shared_types::codes::{
    ChunkMode, EventKind, Mode, Outcome, Reason, ReferenceState, RequestKind,
};
use cdcr_shared_types::{
    Command, Header, InputEvent, Location, Measurement, ObstacleUpdate, ReferenceChunk,
    ReferencePoint, Request, Response, Service, Status, Telemetry,
};
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::server::Server;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::{Node, ipc};
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;

pub(crate) const ROBOT: &str = "fake";
const PERIOD: Duration = Duration::from_millis(5);

/// A place of its own for one test, cleaned up afterwards.
pub(crate) struct Place {
    _folder: tempfile::TempDir,
    pub(crate) location: Location,
}

impl Place {
    pub(crate) fn new(test: &str) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let prefix = format!("cdcr_{test}_{}_", std::process::id());
        let location = Location::new(&prefix, &folder.path().join("root")).expect("legal");
        Self {
            _folder: folder,
            location,
        }
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let Ok(files) = std::fs::read_dir(Path::new("/dev/shm")) else {
            return;
        };
        for file in files.flatten() {
            let name = file.file_name();
            if name.to_string_lossy().starts_with(self.location.prefix()) {
                let _ = std::fs::remove_file(file.path());
            }
        }
    }
}

/// What a test tells the daemon.
#[derive(Debug, Default)]
pub(crate) struct Orders {
    stop: AtomicBool,
    /// Publish nothing and answer nothing, like a stopped process.
    pub(crate) silent: AtomicBool,
    /// Judge reference chunks with this outcome.
    pub(crate) verdict: AtomicU32,
    /// Fault as soon as it tracks.
    pub(crate) fault: AtomicBool,
    /// How often the lease was acquired or renewed.
    pub(crate) renewals: AtomicU64,
    /// Largest number of points that were buffered ahead.
    pub(crate) points_max: AtomicU64,
}

/// The daemon, in a thread of its own.
pub(crate) struct FakeDaemon {
    pub(crate) orders: Arc<Orders>,
    thread: Option<JoinHandle<()>>,
}

impl FakeDaemon {
    pub(crate) fn start(location: &Location, robot: &str) -> Self {
        let orders = Arc::new(Orders::default());
        let (location, robot) = (location.clone(), robot.to_owned());
        let thread_orders = Arc::clone(&orders);
        let thread = thread::spawn(move || Loop::new(&location, &robot, thread_orders).run());
        Self {
            orders,
            thread: Some(thread),
        }
    }
}

impl Drop for FakeDaemon {
    fn drop(&mut self) {
        self.orders.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

type Channel<T> = PortFactory<ipc::Service, T, ()>;

struct Loop {
    orders: Arc<Orders>,
    telemetry: Publisher<ipc::Service, Telemetry, ()>,
    status: Publisher<ipc::Service, Status, ()>,
    reference: Subscriber<ipc::Service, ReferenceChunk, ()>,
    obstacles: Subscriber<ipc::Service, ObstacleUpdate, ()>,
    control: Server<ipc::Service, Request, (), Response, ()>,
    _idle: (Channel<Measurement>, Channel<Command>),
    points: Vec<ReferencePoint>,
    last_chunk: u64,
    mode: Mode,
    reason: Reason,
    holder: u64,
    cycle: u64,
}

fn create<T: Message>((node, robot): (&Node<ipc::Service>, &str)) -> Channel<T> {
    let queues = T::SERVICE.queues();
    node.service_builder(&T::SERVICE.name(robot).expect("legal"))
        .publish_subscribe::<T>()
        .enable_safe_overflow(true)
        .max_publishers(queues.publishers)
        .max_subscribers(queues.subscribers)
        .subscriber_max_buffer_size(queues.queue)
        .history_size(queues.history)
        .max_nodes(Service::NODES)
        .create()
        .expect("created")
}

impl Loop {
    fn new(location: &Location, robot: &str, orders: Arc<Orders>) -> Self {
        let node = location.node_builder().expect("legal");
        let node = node.create::<ipc::Service>().expect("a node");
        let control = node
            .service_builder(&Service::Control.name(robot).expect("legal"))
            .request_response::<Request, Response>()
            .max_clients(Service::CONTROL_CLIENTS)
            .max_active_requests_per_client(Service::CONTROL_REQUESTS)
            .max_nodes(Service::NODES)
            .create()
            .expect("created");
        let place = (&node, robot);
        let publisher = "a publisher";
        let subscriber = "a subscriber";
        Self {
            orders,
            telemetry: create(place).publisher_builder().create().expect(publisher),
            reference: create(place)
                .subscriber_builder()
                .create()
                .expect(subscriber),
            obstacles: create(place)
                .subscriber_builder()
                .create()
                .expect(subscriber),
            control: control.server_builder().create().expect("a server"),
            _idle: (create(place), create(place)),
            status: create(place).publisher_builder().create().expect(publisher),
            points: Vec::new(),
            last_chunk: 0,
            mode: Mode::Holding,
            reason: Reason::Start,
            holder: 0,
            cycle: 0,
        }
    }

    fn run(mut self) {
        while !self.orders.stop.load(Ordering::Relaxed) {
            thread::sleep(PERIOD);
            if !self.orders.silent.load(Ordering::Relaxed) {
                self.cycle();
            }
        }
    }

    fn cycle(&mut self) {
        self.cycle += 1;
        let now_ns = monotonic_ns();
        let events = self.gather(now_ns);
        self.answer();
        let reference = self.reference_at(now_ns);
        if self.mode == Mode::Tracking {
            if self.orders.fault.load(Ordering::Relaxed) {
                (self.mode, self.reason) = (Mode::Faulted, Reason::MeasurementLost);
            } else if reference.1 == ReferenceState::Ended {
                (self.mode, self.reason) = (Mode::Holding, Reason::ReferenceEnded);
            }
        }
        self.publish(now_ns, reference, &events);
    }

    fn header(&self, now_ns: u64) -> Header {
        Header {
            sender_id: 1,
            sequence: self.cycle,
            sent_ns: now_ns,
        }
    }

    fn gather(&mut self, now_ns: u64) -> Vec<InputEvent> {
        let mut events = Vec::new();
        while let Some(chunk) = self.reference.receive().expect("received") {
            let outcome = self.take(chunk.payload(), now_ns);
            events.push(event(EventKind::Reference, &chunk.header, outcome));
        }
        while let Some(update) = self.obstacles.receive().expect("received") {
            events.push(event(
                EventKind::Obstacles,
                &update.header,
                Outcome::Accepted,
            ));
        }
        events
    }

    fn take(&mut self, chunk: &ReferenceChunk, now_ns: u64) -> Outcome {
        let ordered = Outcome::try_from(self.orders.verdict.load(Ordering::Relaxed));
        let ordered = ordered.expect("an outcome");
        let points = &chunk.points[..chunk.count as usize];
        if ordered != Outcome::Accepted {
            return ordered;
        }
        if chunk.header.sender_id != self.holder {
            return Outcome::NoLease;
        }
        if chunk.mode == ChunkMode::Replace.code() {
            self.points.clear();
        } else if chunk.header.sequence != self.last_chunk + 1 {
            return Outcome::SequenceGap;
        }
        if points[0].time_ns < now_ns {
            return Outcome::InThePast;
        }
        self.last_chunk = chunk.header.sequence;
        self.points.extend(points);
        let ahead = self.points.iter().filter(|p| p.time_ns >= now_ns).count();
        self.orders
            .points_max
            .fetch_max(ahead as u64, Ordering::Relaxed);
        Outcome::Accepted
    }

    fn answer(&mut self) {
        while let Some(request) = self.control.receive().expect("received") {
            let (kind, header) = (request.kind, request.header);
            let outcome = self.judge(kind, header.sender_id);
            let response = Response {
                header: self.header(monotonic_ns()),
                request_sequence: header.sequence,
                cycle: self.cycle,
                outcome: outcome.code(),
                mode: self.mode.code(),
                lease_holder: self.holder,
                lease_left_ns: 0,
            };
            request.send_copy(response).expect("answered");
        }
    }

    fn judge(&mut self, kind: u32, sender_id: u64) -> Outcome {
        match RequestKind::try_from(kind) {
            Ok(RequestKind::AcquireLease) if self.holder == 0 || self.holder == sender_id => {
                self.orders.renewals.fetch_add(1, Ordering::Relaxed);
                self.holder = sender_id;
            }
            Ok(RequestKind::AcquireLease) => return Outcome::LeaseHeld,
            Ok(RequestKind::ReleaseLease) => self.holder = 0,
            Ok(RequestKind::Track) if self.points.is_empty() => return Outcome::NoReference,
            Ok(RequestKind::Track) => {
                (self.mode, self.reason) = (Mode::Tracking, Reason::Request);
            }
            Ok(RequestKind::Hold) => (self.mode, self.reason) = (Mode::Holding, Reason::Request),
            Ok(_) => return Outcome::Unsupported,
            Err(_) => return Outcome::UnknownCode,
        }
        Outcome::Accepted
    }

    /// Straight lines between the points: exact enough for a test.
    fn reference_at(&self, now_ns: u64) -> ([f64; 3], ReferenceState) {
        let after = self.points.partition_point(|p| p.time_ns <= now_ns);
        match (after, self.points.get(after)) {
            (_, None) => match self.points.last() {
                Some(last) => (last.position_m, ReferenceState::Ended),
                None => ([0.0; 3], ReferenceState::None),
            },
            (0, Some(first)) => (first.position_m, ReferenceState::Before),
            (_, Some(next)) => {
                let last = &self.points[after - 1];
                let share = (now_ns - last.time_ns) as f64 / (next.time_ns - last.time_ns) as f64;
                let between = |i: usize| {
                    last.position_m[i] + share * (next.position_m[i] - last.position_m[i])
                };
                (core::array::from_fn(between), ReferenceState::Inside)
            }
        }
    }

    fn publish(&self, now_ns: u64, reference: ([f64; 3], ReferenceState), events: &[InputEvent]) {
        let mut record = Telemetry {
            header: self.header(now_ns),
            cycle: self.cycle,
            release_ns: now_ns,
            start_ns: now_ns + 10_000,
            solve_start_ns: now_ns + 11_000,
            solve_end_ns: now_ns + 31_000,
            handed_over_ns: now_ns + 33_000,
            mode: self.mode.code(),
            reason: self.reason.code(),
            event_count: events.len() as u32,
            tip_position_m: reference.0,
            ..Telemetry::default()
        };
        record.events[..events.len()].copy_from_slice(events);
        record.reference.state = reference.1.code();
        self.telemetry.send_copy(record).expect("sent");
        if self.cycle % 20 == 1 {
            self.status.send_copy(self.snapshot(now_ns)).expect("sent");
        }
    }

    fn snapshot(&self, now_ns: u64) -> Status {
        let mut status = Status {
            header: self.header(now_ns),
            mode: self.mode.code(),
            reason: self.reason.code(),
            cycles: self.cycle,
            lease_holder: self.holder,
            ..Status::default()
        };
        status.robot_name[..ROBOT.len()].copy_from_slice(ROBOT.as_bytes());
        status.robot.sections = 1;
        status.robot.section[0].length_m = 0.3;
        status
    }
}

fn event(kind: EventKind, header: &Header, outcome: Outcome) -> InputEvent {
    InputEvent {
        sender_id: header.sender_id,
        sequence: header.sequence,
        kind: kind.code(),
        outcome: outcome.code(),
        ..InputEvent::default()
    }
}
