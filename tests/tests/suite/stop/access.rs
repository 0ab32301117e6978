//! Nothing prevents a stop: neither observers nor clients with requests, neither living nor dead ones.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use cdcr_client::{ConnectError, Connection, Driver, LinkError, monotonic_ns};
use cdcr_shared_types::codes::{Interface, MeasurementKind, Mode, RequestKind};
use cdcr_shared_types::{Location, Measurement, Service, ipc};
use cdcr_tests::{
    Daemon, EndWhenDropped, Place, Program, ROBOT, STALL_TOLERANT, TIMEOUT, ask_for, wait_mode,
    wait_record, wait_until,
};
use iceoryx2::prelude::Node;
use rustix::process::Signal;

use super::matrix::{TRIES, Timed, timed};
use crate::soak::nodes;

/// Every connection that a daemon accepts, including all status readers and all request clients.
pub(super) struct Crowd {
    pub(super) connections: Vec<Connection>,
    _statuses: Vec<cdcr_client::Stream<cdcr_shared_types::Status>>,
    pub(super) askers: usize,
}

impl Crowd {
    pub(super) fn connect(location: &Location) -> Self {
        let mut connections = Vec::new();
        loop {
            match Connection::open(location, ROBOT) {
                Ok(connection) => connections.push(connection),
                Err(ConnectError::Full { .. }) => break,
                Err(error) => panic!("{error}"),
            }
        }
        let readers = connections.iter().cycle().map(Connection::statuses);
        let statuses = readers.map_while(Result::ok).collect();
        let ready = |connection: &&Connection| connection.prepare_requests().is_ok();
        let askers = connections.iter().filter(ready).count();
        Self {
            connections,
            _statuses: statuses,
            askers,
        }
    }
}

#[test]
fn a_crowd_that_takes_every_place_does_not_keep_a_stop_out() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let mut telemetry = daemon.connect().telemetry().unwrap();
    wait_mode(&mut telemetry, Mode::Holding);
    let crowd = Crowd::connect(daemon.place().location());
    println!(
        "{} connections, {} ask",
        crowd.connections.len(),
        crowd.askers
    );
    assert!(crowd.connections.len() > 16);
    assert_eq!(
        crowd.askers,
        Service::CONTROL_CLIENTS - Service::CONTROL_KEPT
    );
    for _ in 0..3 {
        daemon.place().checked("cdcrctl stop", 0, &[]);
        wait_mode(&mut telemetry, Mode::Stopped);
        // Of the others, only clients with a place can send requests.
        let place = daemon.place();
        place.checked("cdcrctl reset", 1, &["close one of them"]);
        ask_for(&crowd.connections[0], RequestKind::Reset);
        wait_mode(&mut telemetry, Mode::Holding);
    }
}

#[test]
fn readers_leave_the_driver_and_the_daemon_their_places() {
    let mut daemon = Daemon::start("[link]\nkind = \"driver\"\n");
    let connection = daemon.connect();
    let commands = std::iter::repeat_with(|| connection.commands());
    let commands: Vec<_> = commands.map_while(Result::ok).collect();
    let references = std::iter::repeat_with(|| connection.references());
    let references: Vec<_> = references.map_while(Result::ok).collect();
    assert!(commands.len() >= Service::NODES, "{}", commands.len());
    assert!(!references.is_empty());
    let full = connection.commands().expect_err("all are taken");
    assert!(matches!(full, LinkError::Port { .. }), "{full:?}");
    // One driver, and the one that replaces it before it has gone.
    let first = connection.driver(Interface::Velocity).unwrap();
    let second = connection.driver(Interface::Velocity).unwrap();
    drop((first, second));
    // A restarted daemon needs readers of its own, too.
    daemon.kill();
    daemon.restart();
    drop((commands, references));
}

fn measure_straight(driver: &Driver) {
    let measurement = Measurement {
        measured_ns: monotonic_ns(),
        kind: MeasurementKind::Configuration.code(),
        sections: driver.robot().sections,
        ..Measurement::default()
    };
    driver.send(measurement).unwrap();
}

#[test]
fn a_crowd_that_takes_every_place_does_not_keep_a_driver_out() {
    // Before the first measurement, a stalled machine could stop it for its misses.
    let daemon = Daemon::start(&format!(
        "{STALL_TOLERANT}[link]\nkind = \"driver\"\nmeasurement_timeout_ms = 10000.0\n"
    ));
    let location = daemon.place().location();
    let crowd = Crowd::connect(location);
    let mut telemetry = crowd.connections[0].telemetry().unwrap();
    let connect = || Driver::connect(location, ROBOT, Interface::Velocity);
    // A lost client, and the one that replaces it before it has gone.
    let first = connect().unwrap();
    let second = connect().unwrap();
    // A third one waits for a free place.
    let refused = connect().expect_err("all places are taken");
    assert!(matches!(refused, ConnectError::Full { .. }), "{refused:?}");
    let third = std::thread::scope(|scope| {
        let third = scope.spawn(|| {
            Driver::connect_within(location, ROBOT, Interface::Velocity, TIMEOUT).map(drop)
        });
        std::thread::sleep(Duration::from_millis(100));
        drop(first);
        third.join().unwrap()
    });
    third.unwrap();
    wait_record(&mut telemetry, |record| {
        measure_straight(&second);
        record.mode == Mode::Holding.code()
    });
    let full = Connection::open(location, ROBOT).expect_err("all places are taken");
    assert!(matches!(full, ConnectError::Full { .. }), "{full:?}");
}

/// A client that finds no place takes none that is reserved for a driver, not even for a moment.
#[test]
fn clients_that_try_to_connect_again_and_again_keep_no_driver_out() {
    let daemon = Daemon::start("[link]\nkind = \"driver\"\n");
    let location = daemon.place().location();
    let _crowd = Crowd::connect(location);
    let _first = Driver::connect(location, ROBOT, Interface::Velocity).unwrap();
    let ending = AtomicBool::new(false);
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                while !ending.load(Ordering::Relaxed) {
                    drop(Connection::open(location, ROBOT).expect_err("all places are taken"));
                }
            });
        }
        let _ends = EndWhenDropped(&ending);
        for _ in 0..30 {
            let second = Driver::connect(location, ROBOT, Interface::Velocity);
            let is_kept_out = matches!(
                second,
                Err(ConnectError::Full { .. } | ConnectError::Port(_))
            );
            assert!(!is_kept_out, "{second:?}");
        }
    });
}

/// Set for the process that creates nodes and is killed: prefix and root.
const VICTIM: &str = "CDCR_TEST_VICTIM";
/// Nodes of one process, each with an open file.
const NODES: usize = 300;
/// Number of killed processes.
const VICTIMS: usize = 4;
/// Dead nodes that a daemon removes in a second, with the checks that a test may meet.
const CLEARED_PER_S: u64 = 8;

/// Creates nodes until the process is killed.
pub(super) fn die() -> bool {
    let Ok(place) = std::env::var(VICTIM) else {
        return false;
    };
    let (prefix, root) = place.split_once(' ').unwrap();
    let location = Location::new(prefix, std::path::Path::new(root)).unwrap();
    let make = || location.client_node_builder().unwrap().create();
    let _nodes: Vec<Node<ipc::Variant>> = (0..NODES).map(|_| make().unwrap()).collect();
    println!("made");
    loop {
        std::thread::park();
    }
}

pub(super) fn kill_a_victim(place: &Place, test: &str) {
    let location = place.location();
    let mut command = std::process::Command::new(std::env::current_exe().unwrap());
    let given = format!("{} {}", location.prefix(), location.root().display());
    command
        .args(["--exact", test, "--nocapture"])
        .env(VICTIM, given);
    let mut victim = Program::start(&mut command);
    wait_until("it has made its nodes", || {
        assert!(victim.runs());
        victim.printed().contains("made")
    });
    victim.signal(Signal::KILL);
    victim.output();
}

#[test]
fn a_stop_does_not_wait_for_the_dead() {
    if die() {
        return;
    }
    let daemon = Daemon::start(STALL_TOLERANT);
    for _ in 0..VICTIMS {
        let test = "stop::access::a_stop_does_not_wait_for_the_dead";
        kill_a_victim(daemon.place(), test);
    }
    let place = daemon.place();
    let dead_nodes = || nodes(place)[1];
    let begin = Instant::now();
    let before = dead_nodes();
    assert!(before > (VICTIMS * NODES) as u64 / 2, "{before}");
    let stop = || drop(place.checked("cdcrctl stop", 0, &[]));
    let timed: Vec<_> = (0..TRIES).map(|_| timed(place, stop)).collect();
    assert!(!timed.iter().all(Timed::is_late), "{timed:?}");
    let took = timed[0].took;
    let after = dead_nodes();
    println!("beside {before} dead nodes: a stop took {took:?}, and {after} were left");
    // The client removed none; the daemon did.
    let looks = begin.elapsed().as_secs() + 2;
    assert!(
        after + CLEARED_PER_S * looks >= before,
        "{before} to {after} in {looks} s"
    );
    wait_until("the daemon clears some away", || {
        std::thread::sleep(Duration::from_millis(200));
        dead_nodes() < after.saturating_sub(CLEARED_PER_S)
    });
}
