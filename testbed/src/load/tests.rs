use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use cdcr_client::Connection;
use cdcr_shared_types::codes::{EventKind, Outcome};
use cdcr_test_skip::{Need, skip};

use super::*;
use crate::subject::daemon::{Daemon, Launch};

const MOMENT: Duration = Duration::from_millis(500);
const TIMEOUT: Duration = Duration::from_secs(30);

fn daemon(cores: &Cores) -> Daemon {
    Daemon::start(&Launch::stall_tolerant(None).placed(cores, false), cores).unwrap()
}

/// Runs a load until each of its counts has risen: a moment, longer when the machine stalls.
fn prove(load: Load, cores: &Cores, target: Option<&Location>) -> Done {
    let mut moment = MOMENT;
    loop {
        let running = RunningLoad::start(load, cores, target).unwrap();
        thread::sleep(moment);
        assert!(running.failure().is_none(), "{:?}", running.failure());
        let stopped = running.stop();
        println!("{load:?} in {moment:?}: {stopped:?}");
        match stopped {
            Ok(done) => {
                assert!(done.seconds >= moment.as_secs_f64(), "{done:?}");
                return done;
            }
            Err(error) => assert!(moment < TIMEOUT, "{error:#}"),
        }
        moment *= 4;
    }
}

#[test]
fn loads_without_a_daemon_do_their_work_and_nothing_else() {
    let cores = Cores::find().unwrap();
    let done = prove(Load::None, &cores, None);
    let nothing = Done {
        seconds: done.seconds,
        ..Done::default()
    };
    assert_eq!(done, nothing);
    for load in [Load::Cpu, Load::Memory, Load::CpuEverywhere] {
        let done = prove(load, &cores, None);
        let rest = Done {
            seconds: 0.0,
            spins: 0,
            copied_bytes: 0,
            ..done
        };
        assert_eq!(rest, Done::default(), "{load:?}");
    }
    prove(Load::Io, &cores, None);
}

#[test]
fn loads_on_a_daemon_do_their_work_and_leave_nothing() {
    let cores = Cores::find().unwrap();
    let daemon = daemon(&cores);
    let before = files(&daemon);
    for load in [Load::Clients, Load::Flood, Load::All] {
        prove(load, &cores, Some(daemon.place.location()));
        nothing_new(&daemon, &before);
    }
    daemon.stop().unwrap();
}

/// Files that only the running daemon can remove go at its next check.
fn nothing_new(daemon: &Daemon, before: &BTreeSet<PathBuf>) {
    let deadline = Instant::now() + TIMEOUT;
    loop {
        let after = files(daemon);
        let left: Vec<_> = after.difference(before).collect();
        if left.is_empty() {
            return;
        }
        assert!(Instant::now() < deadline, "the load leaves {left:?}");
        thread::sleep(Duration::from_millis(10));
    }
}

/// All files of a daemon and its clients in shared memory and in their folder.
fn files(daemon: &Daemon) -> BTreeSet<PathBuf> {
    let mut files = BTreeSet::from_iter(daemon.place.memory_files());
    collect(daemon.place.location().root(), &mut files);
    files
}

fn collect(folder: &Path, files: &mut BTreeSet<PathBuf>) {
    // A file that vanishes during the listing is not left over.
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.is_dir() {
            collect(&path, files);
        }
        files.insert(path);
    }
}

#[test]
fn the_flood_is_refused_or_far_away_as_it_should_be() {
    let cores = Cores::find().unwrap();
    let daemon = daemon(&cores);
    let connection = daemon.connect().unwrap();
    let running = RunningLoad::start(Load::Flood, &cores, Some(daemon.place.location())).unwrap();
    let (mut refused, mut accepted) = (0, 0);
    watch(&connection, |kind, outcome| match (kind, outcome) {
        (EventKind::Reference, outcome) => {
            assert_ne!(outcome, Outcome::Accepted);
            refused += u32::from(outcome == Outcome::NoLease);
        }
        (EventKind::Obstacles, Outcome::Accepted) => accepted += 1,
        // After a stall longer than the lifetime of the obstacles.
        (EventKind::Obstacles, Outcome::InThePast) => {}
        other => panic!("{other:?}"),
    });
    running.stop().unwrap();
    assert!(refused > 0 && accepted > 0, "{refused} {accepted}");
}

/// Passes on the events in the daemon's records until it knows half of the obstacles.
fn watch(connection: &Connection, mut take: impl FnMut(EventKind, Outcome)) {
    let mut telemetry = connection.telemetry().unwrap();
    let deadline = Instant::now() + TIMEOUT;
    let mut records = 0;
    loop {
        assert!(
            Instant::now() < deadline,
            "the obstacles do not become known"
        );
        let record = telemetry.next_within(TIMEOUT).unwrap().unwrap();
        for event in cdcr_client::events(&record) {
            let (kind, outcome) = (event.kind.try_into(), event.outcome.try_into());
            take(kind.unwrap(), outcome.unwrap());
        }
        records += 1;
        if record.obstacle_count >= 2 && records >= 20 {
            return;
        }
    }
}

#[test]
fn a_daemon_that_is_not_there_is_a_failure_of_the_flood_alone() {
    let cores = Cores::find().unwrap();
    let place = cdcr_process::PrivatePlace::new().unwrap();
    let mut running = RunningLoad::start(Load::Clients, &cores, Some(place.location())).unwrap();
    thread::sleep(MOMENT);
    let done = running.end().unwrap();
    assert_eq!(done.clients, 0);
    assert!(done.failed_clients > 0);
    assert_eq!(done.missing(Load::Clients), ["clients"]);
    let error = running.stop().unwrap_err().to_string();
    assert!(error.contains("the load clients did nothing"), "{error}");
    let error = RunningLoad::start(Load::Flood, &cores, Some(place.location())).unwrap_err();
    assert!(
        error.to_string().contains("no daemon is running"),
        "{error:#}"
    );
}

#[test]
fn stress_ng_works_and_ends_with_the_load() {
    if let Err(missing) = Load::StressNg.is_available() {
        skip(Need::StressNg, missing);
        return;
    }
    let done = prove(Load::StressNg, &Cores::find().unwrap(), None);
    assert!(done.stress_operations > 0);
}

#[test]
fn a_dropped_load_ends() {
    let cores = Cores::find().unwrap();
    let running = RunningLoad::start(Load::Cpu, &cores, None).unwrap();
    let signals = Arc::clone(&running.signals);
    drop(running);
    // The only owner: the threads have ended.
    assert_eq!(Arc::strong_count(&signals), 1);
}
