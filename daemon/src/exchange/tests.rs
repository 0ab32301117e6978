//! The exchange with real ports and a manual clock: the test decides who sends what and when.

mod measurements;
mod obstacles;
mod references;
mod requests;

use std::cell::Cell;

use cdcr_scratch::Scratch;
use cdcr_shared_types::codes::{Interface, MeasurementKind, ObstacleAction, Outcome, RequestKind};
use cdcr_shared_types::{
    Command, Header, Measurement, Obstacle, ObstacleUpdate, ReferenceChunk, Request, Response,
    Service, ipc,
};
use iceoryx2::pending_response::PendingResponse;
use iceoryx2::port::client::Client;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::{Node, ZeroCopySend};

use super::*;
use crate::config::Config;
use crate::convert;
use crate::cycle::Cycle;
use crate::handover::{
    ChangedSettings, CycleEnds, CycleInputs, CycleReport, CycleRequest, ReporterEnds,
    RuntimeSettings, channels,
};
use crate::link::CycleRobot;
use crate::rt::clock::ManualClock;
use crate::rt::schedule::Release;
use crate::services;

const MS: u64 = 1_000_000;
const PERIOD_NS: u64 = 5 * MS;
/// The origin of the grid.
const BEGIN_NS: u64 = 100_000 * MS;
/// The robot is lost after this time without a measurement \[ms\].
const TIMEOUT_MS: u64 = 50;

/// An exchange, a cycle, and the other ends of all ports.
struct Rig {
    exchange: Exchange,
    cycle: Cycle,
    ends: CycleEnds,
    reports: ReporterEnds,
    reloaded: rtrb::Producer<ChangedSettings>,
    shared: Shared,
    schedule: Schedule,
    clock: ManualClock,
    next_cycle: u64,
    sequence: Cell<u64>,
    measurements: Publisher<ipc::Variant, Measurement, ()>,
    obstacles: Publisher<ipc::Variant, ObstacleUpdate, ()>,
    references: Publisher<ipc::Variant, ReferenceChunk, ()>,
    commands: Subscriber<ipc::Variant, Command, ()>,
    control: Client<ipc::Variant, Request, (), Response, ()>,
    node: Node<ipc::Variant>,
    _root: Scratch,
}

impl Rig {
    fn new(configuration: &str) -> Self {
        let folder = Scratch::in_memory().unwrap();
        let root = folder.path().join("root");
        let text = format!(
            "{configuration}\n[link]\nkind = \"driver\"\nmeasurement_timeout_ms = {TIMEOUT_MS}.0\n\
             [transport]\nroot = \"{}\"\n",
            root.display()
        );
        let validated = Config::parse(&text, &folder.path().join("robot.toml")).unwrap();
        let node = services::node(&validated.location).unwrap();
        let robot = &validated.config.robot.name;
        let ports = Ports::create(&node, robot).unwrap();
        let ends = channels(RuntimeSettings::new(&validated.config));
        let control = node
            .service_builder(&Service::Control.name(robot).unwrap())
            .request_response::<Request, Response>()
            .open()
            .unwrap();
        let commands = node
            .service_builder(&Service::Command.name(robot).unwrap())
            .publish_subscribe::<Command>()
            .open()
            .unwrap();
        Self {
            measurements: services::publisher(&node, Service::Measurement, robot).unwrap(),
            obstacles: services::publisher(&node, Service::Obstacles, robot).unwrap(),
            references: services::publisher(&node, Service::Reference, robot).unwrap(),
            commands: commands.subscriber_builder().create().unwrap(),
            control: control.client_builder().create().unwrap(),
            exchange: Exchange::new(&validated, ports, ends.exchange, 7),
            cycle: Cycle::new(&validated, CycleRobot::Driver).unwrap(),
            ends: ends.cycle,
            reports: ends.reporter,
            reloaded: ends.reloaded,
            shared: Shared::default(),
            schedule: Schedule::new(BEGIN_NS, PERIOD_NS),
            clock: ManualClock::default(),
            next_cycle: 1,
            sequence: Cell::default(),
            node,
            _root: folder,
        }
    }

    fn now_ns(&self) -> u64 {
        self.clock.now_ns()
    }

    /// Gathers the inputs of the next cycle in time, and returns them.
    fn gather(&mut self) -> &CycleInputs {
        let now_ns = self.gather_ns();
        self.clock.sleep_until(now_ns);
        let (clock, shared) = (&self.clock, &self.shared);
        self.exchange
            .gather(&self.schedule, self.next_cycle, now_ns, clock, shared);
        self.next_cycle += 1;
        self.ends.inputs.read()
    }

    /// Gathers for `duration_ms`.
    fn gather_for(&mut self, duration_ms: u64) {
        for _ in 0..duration_ms * MS / PERIOD_NS {
            self.gather();
        }
    }

    /// Runs `cycle` with the present inputs and a waiting request, or else `request`; returns its mode.
    fn run(
        &mut self,
        cycle: u64,
        request: Option<cdcr_controller::safety::Request>,
    ) -> cdcr_controller::safety::Mode {
        let release_ns = self.schedule.release_ns(cycle);
        self.clock.sleep_until(release_ns);
        let release = Release {
            cycle,
            release_ns,
            due_ns: release_ns,
            start_ns: release_ns,
            skipped: 0,
        };
        let untold = request.map(|request| CycleRequest {
            ticket: 0,
            request,
            asked_ns: release_ns,
            stops: 0,
        });
        let mut request = self.ends.requests.pop().ok().or(untold);
        let (inputs, clock) = (self.ends.inputs.read(), &self.clock);
        let record = self.cycle.run(release, inputs, || request.take(), clock);
        let mode = record.mode;
        self.ends.records.send(|memory| *memory = Some(record));
        mode
    }

    fn publish(&mut self) {
        self.exchange.publish(&self.clock, &self.shared);
    }

    /// The commands received by a driver since the last call.
    fn commands(&self) -> Vec<Command> {
        let received = std::iter::from_fn(|| self.commands.receive().unwrap());
        received.map(|sample| *sample).collect()
    }

    /// The cycles of the records reported since the last call.
    fn reported(&mut self) -> Vec<u64> {
        let ends = &mut self.reports;
        let reports = std::iter::from_fn(|| ends.reports.pop().ok());
        let cycle = |report: CycleReport| {
            let cycle = report.record.release.cycle;
            ends.used.recycle(report.record);
            cycle
        };
        reports.map(cycle).collect()
    }

    /// Start of the next gather \[ns\].
    fn gather_ns(&self) -> u64 {
        self.schedule.release_ns(self.next_cycle) - self.exchange.timing.gather_lead_ns
    }

    /// A driver reports this bend, measured `age_ms` before the next gather.
    fn measure(&self, sender_id: u64, bend_rad: f64, age_ms: u64) {
        self.measure_at(sender_id, bend_rad, self.gather_ns() - age_ms * MS);
    }

    fn measure_at(&self, sender_id: u64, bend_rad: f64, measured_ns: u64) {
        let mut message = Measurement {
            header: self.header(sender_id),
            measured_ns,
            kind: MeasurementKind::Configuration.code(),
            sections: 3,
            interface: Interface::Velocity.code(),
            ..Measurement::default()
        };
        message.bend_rad[0] = bend_rad;
        self.measurements.send_copy(message).unwrap();
    }

    fn header(&self, sender_id: u64) -> Header {
        self.sequence.set(self.sequence.get() + 1);
        Header {
            sender_id,
            sequence: self.sequence.get(),
            sent_ns: self.now_ns(),
        }
    }

    fn counted(&self, outcome: Outcome) -> u64 {
        self.exchange.events.outcomes()[outcome.code() as usize]
    }

    fn ask(
        &self,
        sender_id: u64,
        kind: RequestKind,
    ) -> PendingResponse<ipc::Variant, Request, (), Response, ()> {
        self.ask_at(sender_id, kind, self.now_ns())
    }

    fn ask_at(
        &self,
        sender_id: u64,
        kind: RequestKind,
        sent_ns: u64,
    ) -> PendingResponse<ipc::Variant, Request, (), Response, ()> {
        let header = self.header(sender_id);
        let request = Request {
            header: Header { sent_ns, ..header },
            kind: kind.code(),
            ..Request::default()
        };
        self.control.send_copy(request).unwrap()
    }

    /// Sends obstacles far from the robot that move away, measured at the next gather, or a clear.
    fn send_update(&self, sender_id: u64, action: ObstacleAction, lifetimes_ms: &[u64]) {
        let update = self.update(sender_id, action, lifetimes_ms);
        self.obstacles.send_copy(update).unwrap();
    }

    fn update(
        &self,
        sender_id: u64,
        action: ObstacleAction,
        lifetimes_ms: &[u64],
    ) -> ObstacleUpdate {
        let at_ns = self.gather_ns();
        let mut update = ObstacleUpdate {
            header: Header {
                sent_ns: at_ns,
                ..self.header(sender_id)
            },
            action: action.code(),
            count: lifetimes_ms.len() as u32,
            ..ObstacleUpdate::default()
        };
        for (index, lifetime_ms) in lifetimes_ms.iter().enumerate() {
            update.obstacles[index] = Obstacle {
                id: index as u32,
                start_m: [1.0, 0.0, 0.5],
                velocity_m_s: [0.1, 0.0, 0.0],
                radius_m: 0.02,
                measured_ns: at_ns,
                lifetime_ns: lifetime_ms * MS,
                ..Obstacle::default()
            };
        }
        update
    }

    /// All allowed writers of a service except the first, which the rig has.
    fn crowd<T: ZeroCopySend + std::fmt::Debug + 'static>(
        &self,
        service: Service,
    ) -> Vec<Publisher<ipc::Variant, T, ()>> {
        let name = &Config::default().robot.name;
        let others = (1..service.queues().publishers)
            .map(|_| services::publisher(&self.node, service, name).unwrap());
        others.collect()
    }
}

/// Each of `crowd` fills its queue.
fn flood<T: ZeroCopySend + Copy + std::fmt::Debug + 'static>(
    crowd: &[Publisher<ipc::Variant, T, ()>],
    service: Service,
    mut message: impl FnMut() -> T,
) {
    for other in crowd {
        for _ in 0..service.queues().queue {
            other.send_copy(message()).unwrap();
        }
    }
}

fn moves_at_all(command: &Command) -> bool {
    command.bend_rate_rad_s.iter().any(|rate| *rate != 0.0)
}

/// A robot that is homing: its cycles command motion. Cycles 1 and 2 are over.
fn homing(configuration: &str) -> Rig {
    let mut rig = Rig::new(configuration);
    rig.measure(1, 1.5, 0);
    rig.gather();
    rig.run(1, None);
    rig.publish();
    rig.gather();
    rig.run(2, Some(cdcr_controller::safety::Request::Home));
    rig.publish();
    let cycles: Vec<_> = rig.commands().iter().map(|command| command.cycle).collect();
    assert_eq!(cycles, [1, 2]);
    assert_eq!(rig.reported(), [1, 2]);
    rig
}

#[test]
fn what_changed_in_the_configuration_is_in_the_next_inputs_and_what_clients_set_stays() {
    let mut rig = Rig::new("");
    let started = rig.gather().settings;
    let mut wanted = started;
    wanted.nmpc.safe_distance_m = 0.05;
    wanted.nmpc.horizon_steps = 9;
    let header = rig.header(1);
    let asked = rig.control.send_copy(Request {
        header,
        kind: RequestKind::Settings.code(),
        settings: convert::settings_to_wire(&wanted),
        ..Request::default()
    });
    let before = rig.gather().clone();
    assert_eq!(before.settings, wanted);
    let mut after = started;
    (after.nmpc.horizon_steps, after.budget_ns) = (7, 1_000_000);
    let changed = ChangedSettings {
        before: started,
        after,
    };
    rig.reloaded.push(changed).unwrap();
    let inputs = rig.gather();
    assert_ne!(inputs.settings_revision, before.settings_revision);
    (wanted.nmpc.horizon_steps, wanted.budget_ns) = (7, 1_000_000);
    assert_eq!(inputs.settings, wanted);
    drop(asked);
    // Seven blocks, set by a client, do not fit into five steps of the configuration. Only the configuration
    // applies, except the larger safe distance of the client.
    wanted.nmpc.control_blocks = 7;
    let outcome = rig
        .exchange
        .settings
        .change(&convert::settings_to_wire(&wanted));
    assert_eq!(outcome, Outcome::Accepted);
    let mut short = after;
    short.nmpc.horizon_steps = 5;
    let changed = ChangedSettings {
        before: after,
        after: short,
    };
    rig.reloaded.push(changed).unwrap();
    short.nmpc.safe_distance_m = 0.05;
    assert_eq!(rig.gather().settings, short);
}

#[test]
fn a_safe_distance_that_a_client_set_wider_stays_when_that_of_the_configuration_changes() {
    let mut rig = Rig::new("[controller]\nsafe_distance_m = 0.02\n");
    let file = rig.gather().settings;
    let safe = |settings: RuntimeSettings, safe_distance_m| {
        let mut settings = settings;
        settings.nmpc.safe_distance_m = safe_distance_m;
        settings
    };
    let set = |rig: &mut Rig, settings: RuntimeSettings| {
        let settings = convert::settings_to_wire(&settings);
        let outcome = rig.exchange.settings.change(&settings);
        assert_eq!(outcome, Outcome::Accepted);
    };
    let reload = |rig: &mut Rig, before_m, after_m| {
        let changed = ChangedSettings {
            before: safe(file, before_m),
            after: safe(file, after_m),
        };
        rig.reloaded.push(changed).unwrap();
        rig.gather().settings.nmpc.safe_distance_m
    };
    // Without one of a client, the configured safe distance is in force.
    assert_eq!(reload(&mut rig, 0.02, 0.01), 0.01);
    assert_eq!(reload(&mut rig, 0.01, 0.02), 0.02);
    set(&mut rig, safe(file, 0.05));
    for (before_m, after_m, in_force_m) in [
        (0.02, 0.03, 0.05),
        (0.03, 0.08, 0.08),
        (0.08, 0.02, 0.05),
        (0.02, 0.04, 0.05),
    ] {
        assert_eq!(reload(&mut rig, before_m, after_m), in_force_m);
    }
    // A distance that a client reset, or only sent along, does not override the file.
    set(&mut rig, safe(file, 0.04));
    assert_eq!(reload(&mut rig, 0.04, 0.06), 0.06);
    // No client goes below the file that was read last, whatever the daemon started with.
    let nearer = convert::settings_to_wire(&safe(file, 0.05));
    let outcome = rig.exchange.settings.change(&nearer);
    assert_eq!(outcome, Outcome::OutOfRange);
    set(&mut rig, safe(file, 0.06));
    assert_eq!(reload(&mut rig, 0.06, 0.03), 0.03);
    set(&mut rig, safe(file, 0.03));
}

#[test]
fn of_several_commands_that_wait_only_the_newest_leaves() {
    let mut rig = homing("");
    for cycle in 3..=5 {
        rig.run(cycle, None);
    }
    rig.publish();
    let commands = rig.commands();
    assert_eq!(commands.len(), 1);
    let [command] = commands[..] else { panic!() };
    assert!(moves_at_all(&command));
    assert_eq!((command.cycle, command.header.sequence), (5, 3));
    assert!(rig.now_ns() < command.valid_until_ns);
    // Monitoring clients get every record.
    assert_eq!(rig.reported(), [3, 4, 5]);
    assert_eq!(rig.shared.dropped_records.get(), 0);
}

#[test]
fn a_full_ring_of_records_never_loses_the_newest() {
    let mut rig = homing("");
    let newest = 300;
    for cycle in 3..=newest {
        rig.run(cycle, None);
    }
    rig.publish();
    let cycles: Vec<_> = rig.commands().iter().map(|command| command.cycle).collect();
    assert_eq!(cycles, [newest]);
    let reported = rig.reported();
    assert_eq!(reported.last(), Some(&newest));
    assert!(reported.is_sorted() && reported[0] == 3);
    let made = newest - 2;
    assert_eq!(
        reported.len() as u64 + rig.shared.dropped_records.get(),
        made
    );
}

#[test]
fn a_command_that_has_run_out_leaves_only_if_it_is_rest() {
    let mut rig = homing("");
    rig.run(3, None);
    assert!(rig.shared.last_word_moves.is_set());
    // The command expires three periods after its release.
    rig.clock.sleep_until(rig.schedule.release_ns(6));
    rig.publish();
    assert_eq!(rig.commands().len(), 0);
    assert_eq!(rig.reported(), [3]);

    rig.run(7, Some(cdcr_controller::safety::Request::Stop));
    for cycle in 8..=20 {
        rig.run(cycle, None);
    }
    rig.clock.sleep_until(rig.schedule.release_ns(90));
    rig.publish();
    let commands = rig.commands();
    let [command] = commands[..] else {
        panic!("{}", commands.len())
    };
    assert_eq!((command.cycle, command.header.sequence), (20, 3));
    assert!(!moves_at_all(&command) && command.valid_until_ns < rig.now_ns());
    assert!(!rig.shared.last_word_moves.is_set());
}

#[test]
fn a_suspended_machine_is_reported_to_the_cycle_once() {
    let mut rig = Rig::new("");
    rig.clock.slept_ns.set(3_600_000 * MS);
    assert_eq!((rig.gather().suspends, rig.gather().suspends), (0, 0));
    rig.clock.slept_ns.set(3_600_500 * MS);
    assert_eq!((rig.gather().suspends, rig.gather().suspends), (1, 1));
}
