//! The client against a daemon that plays by the wire contract: real shared memory, no controller.

mod fake_daemon;

use std::fs;
use std::ops::ControlFlow;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use cdcr_client::{
    ConnectError, Connection, FeedEnd, FeedError, FeedEvent, FeedOptions, FeedReport, LinkError,
    RequestError, Spiral, Trajectory,
};
use cdcr_shared_types::codes::{EventKind, Mode, Outcome, ReferenceState, RequestKind};
use cdcr_shared_types::{Location, Service};
use fake_daemon::{FakeDaemon, Place, ROBOT};
use iceoryx2::prelude::ipc;

const PATIENCE: Duration = Duration::from_secs(5);

fn connect(place: &Place) -> Connection {
    Connection::open_within(&place.location, ROBOT, PATIENCE).expect("the daemon runs")
}

fn spiral(duration_s: f64) -> Spiral {
    Spiral {
        duration_s,
        ..Spiral::for_sections(&[0.3])
    }
}

fn options() -> FeedOptions {
    FeedOptions {
        track: true,
        ..FeedOptions::default()
    }
}

fn feed(connection: &Connection, duration_s: f64) -> Result<FeedReport, FeedError> {
    let spiral = spiral(duration_s);
    connection
        .feed(&spiral, options())?
        .run(|_| ControlFlow::Continue(()))
}

#[test]
fn a_reference_is_fed_tracked_and_played_to_its_end() {
    let place = Place::new("feed");
    let daemon = FakeDaemon::start(&place.location, ROBOT);
    let connection = connect(&place);
    let spiral = spiral(2.0);
    let (mut start_ns, mut inside, mut error_max_m) = (0, 0, 0.0_f64);
    let report = connection
        .feed(&spiral, options())
        .expect("the lease is free")
        .run(|event| {
            match event {
                FeedEvent::Scheduled { start_ns: start } => start_ns = start,
                FeedEvent::Record(record)
                    if record.reference.state == ReferenceState::Inside.code() =>
                {
                    let exact = spiral.position_m((record.release_ns - start_ns) as f64 * 1e-9);
                    let error = (0..3).map(|i| (exact[i] - record.tip_position_m[i]).abs());
                    error_max_m = error_max_m.max(error.fold(0.0, f64::max));
                    inside += 1;
                }
                _ => {}
            }
            ControlFlow::Continue(())
        })
        .expect("fed");
    assert_eq!(
        (report.end, report.points, report.tracked),
        (FeedEnd::Played, 401, true)
    );
    assert_eq!(report.lost_records, 0);
    assert!(inside > 200, "{inside} records inside the reference");
    // Straight lines over 5 ms of a gentle curve.
    assert!(error_max_m < 1e-6, "{error_max_m}");
    assert!(
        daemon.orders.renewals.load(Ordering::Relaxed) > 10,
        "the lease was renewed"
    );
    let points_max = daemon.orders.points_max.load(Ordering::Relaxed);
    assert!(
        (200..=270).contains(&points_max),
        "{points_max} points ahead"
    );
    let status = connection.status(PATIENCE).expect("a status");
    assert_eq!(status.robot.sections, 1);
}

#[test]
fn one_client_at_a_time_has_the_lease_and_gets_it_after_the_other() {
    let place = Place::new("lease");
    let _daemon = FakeDaemon::start(&place.location, ROBOT);
    let (first, second) = (connect(&place), connect(&place));
    assert_ne!(first.sender_id(), second.sender_id());
    let lease = first.acquire_lease().expect("free");
    lease.renew().expect("held");
    let refused = second.acquire_lease().expect_err("held by the first");
    assert!(
        matches!(
            refused,
            RequestError::Refused {
                outcome: Outcome::LeaseHeld,
                ..
            }
        ),
        "{refused}"
    );
    drop(lease);
    let lease = second.acquire_lease().expect("released by drop");
    lease.release().expect("released");
}

#[test]
fn a_refused_chunk_ends_the_feed_with_the_reason() {
    let place = Place::new("refuse");
    let daemon = FakeDaemon::start(&place.location, ROBOT);
    let connection = connect(&place);
    let verdict = Outcome::OutOfReach;
    daemon
        .orders
        .verdict
        .store(verdict.code(), Ordering::Relaxed);
    let error = feed(&connection, 1.0).expect_err("refused");
    assert!(
        matches!(error, FeedError::Refused { point: 0, .. }),
        "{error}"
    );
    assert!(error.to_string().contains("outside the reachable ball"));
    // The lease went back: the next feed works.
    daemon.orders.verdict.store(0, Ordering::Relaxed);
    assert!(feed(&connection, 0.2).expect("fed").tracked);
}

#[test]
fn a_fault_while_tracking_is_told() {
    let place = Place::new("fault");
    let daemon = FakeDaemon::start(&place.location, ROBOT);
    let connection = connect(&place);
    let spiral = spiral(1.0);
    let error = connection
        .feed(&spiral, options())
        .expect("the lease is free")
        .run(|event| {
            if let FeedEvent::Progress(progress) = event
                && progress.tracking
            {
                daemon.orders.fault.store(true, Ordering::Relaxed);
            }
            ControlFlow::Continue(())
        })
        .expect_err("faulted");
    assert!(
        error
            .to_string()
            .contains("faulted because the measurement is lost"),
        "{error}"
    );
}

#[test]
fn requests_are_answered_or_refused_with_a_remedy() {
    let place = Place::new("request");
    let _daemon = FakeDaemon::start(&place.location, ROBOT);
    let connection = connect(&place);
    let response = connection.request(RequestKind::Hold).expect("accepted");
    assert_eq!(response.mode, Mode::Holding.code());
    let refused = connection
        .request(RequestKind::Track)
        .expect_err("no reference");
    assert!(
        refused.to_string().contains("cdcrctl ref spiral --track"),
        "{refused}"
    );
}

#[test]
fn a_stopped_daemon_is_noticed_everywhere() {
    let place = Place::new("silent");
    let daemon = FakeDaemon::start(&place.location, ROBOT);
    let connection = connect(&place);
    let spiral = spiral(5.0);
    let error = connection
        .feed(&spiral, options())
        .expect("the lease is free")
        .run(|event| {
            if let FeedEvent::Progress(progress) = event
                && progress.tracking
            {
                daemon.orders.silent.store(true, Ordering::Relaxed);
            }
            ControlFlow::Continue(())
        })
        .expect_err("silent");
    assert!(
        matches!(
            error,
            FeedError::Request(RequestError::Timeout { .. })
                | FeedError::Link(LinkError::Silent { .. })
        ),
        "{error}"
    );
    let begin = Instant::now();
    std::thread::sleep(Duration::from_millis(500));
    let error = Connection::open(&place.location, ROBOT).expect_err("no fresh status");
    assert!(
        matches!(error, ConnectError::DaemonNotRunning { .. }),
        "{error}"
    );
    assert!(error.to_string().contains("was it killed?"));
    assert!(begin.elapsed() < Duration::from_secs(3));
}

#[test]
fn obstacles_are_judged() {
    let place = Place::new("obstacles");
    let _daemon = FakeDaemon::start(&place.location, ROBOT);
    let connection = connect(&place);
    let mut telemetry = connection.telemetry().expect("a stream");
    let sender = connection.obstacle_sender().expect("a port");
    assert!(sender.remove(&[0; 65]).is_err());
    let header = sender.clear().expect("sent");
    assert_eq!(header.sequence, 1);
    let verdict = telemetry.verdict_on(EventKind::Obstacles, &header, PATIENCE);
    assert_eq!(verdict, Ok(Outcome::Accepted));
}

fn cdcrctl(place: &Place) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_cdcrctl"));
    command
        .args([
            "--prefix",
            place.location.prefix(),
            "--robot",
            ROBOT,
            "--root",
        ])
        .arg(place.location.root())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command
}

fn text(output: &Output) -> String {
    let (out, err) = (&output.stdout, &output.stderr);
    format!(
        "{}{}",
        String::from_utf8_lossy(out),
        String::from_utf8_lossy(err)
    )
}

#[test]
fn the_program_feeds_shows_and_echoes() {
    let place = Place::new("program");
    let _daemon = FakeDaemon::start(&place.location, ROBOT);
    let _connection = connect(&place);
    let run = |arguments: &[&str]| cdcrctl(&place).args(arguments).output().expect("runs");
    let fed = run(&["ref", "spiral", "--duration", "300ms", "--track"]);
    assert!(fed.status.success(), "{}", text(&fed));
    assert!(text(&fed).contains("61 points"), "{}", text(&fed));
    let status = run(&["status", "--format", "json"]);
    let status: serde_json::Value = serde_json::from_slice(&status.stdout).expect("JSON");
    assert_eq!(status["robot_name"], ROBOT);
    assert_eq!(status["reason"], "the reference ended");
    let echo = run(&["echo", "telemetry", "--count", "3", "--format", "json"]);
    let lines = String::from_utf8(echo.stdout).expect("UTF-8");
    assert_eq!(lines.lines().count(), 3);
    for line in lines.lines() {
        let record: serde_json::Value = serde_json::from_str(line).expect("JSON");
        assert_eq!(record["mode"], "holding");
    }
    let added = run(&[
        "obstacle",
        "add",
        "--id",
        "1",
        "--at",
        "0,-0.2,0.2",
        "--radius",
        "0.02",
    ]);
    assert!(added.status.success(), "{}", text(&added));
    let refused = run(&["reset"]);
    assert_eq!(refused.status.code(), Some(1), "{}", text(&refused));
}

#[test]
fn sigint_during_a_feed_holds_and_exits_with_130() {
    let place = Place::new("sigint");
    let _daemon = FakeDaemon::start(&place.location, ROBOT);
    let connection = connect(&place);
    let mut command = cdcrctl(&place);
    let child = command
        .args(["ref", "spiral", "--track"])
        .spawn()
        .expect("runs");
    let deadline = Instant::now() + PATIENCE;
    while connection.status(PATIENCE).expect("a status").mode != Mode::Tracking.code() {
        assert!(Instant::now() < deadline, "it never tracked");
        std::thread::sleep(Duration::from_millis(20));
    }
    let pid = rustix::process::Pid::from_child(&child);
    rustix::process::kill_process(pid, rustix::process::Signal::INT).expect("signalled");
    let output = child.wait_with_output().expect("ended");
    assert_eq!(output.status.code(), Some(130), "{}", text(&output));
    let deadline = Instant::now() + PATIENCE;
    loop {
        let status = connection.status(PATIENCE).expect("a status");
        if status.mode == Mode::Holding.code() && status.lease_holder == 0 {
            break;
        }
        assert!(Instant::now() < deadline, "it never held");
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn services_of_another_version_are_refused_and_not_misread() {
    let place = Place::new("version");
    let node = place.location.node_builder().expect("legal");
    let node = node.create::<ipc::Service>().expect("a node");
    let _other = node
        .service_builder(&Service::Status.name(ROBOT).expect("legal"))
        .publish_subscribe::<u64>()
        .create()
        .expect("created");
    let error = Connection::open(&place.location, ROBOT).expect_err("another type");
    assert!(
        matches!(
            error,
            ConnectError::VersionMismatch {
                service: "status",
                ..
            }
        ),
        "{error}"
    );
}

/// Not a test: what `a_demo_reports_and_leaves_nothing` starts in place of `cdcrd`.
#[test]
#[ignore = "runs only as the daemon of a demo"]
fn be_the_daemon_of_a_demo() {
    let variables = ("FAKE_PREFIX", "FAKE_ROOT");
    let (Ok(prefix), Ok(root)) = (std::env::var(variables.0), std::env::var(variables.1)) else {
        return;
    };
    let location = Location::new(&prefix, Path::new(&root)).expect("legal");
    let _daemon = FakeDaemon::start(&location, "demo");
    std::thread::sleep(Duration::from_secs(60));
}

/// A folder with cdcrctl and a `cdcrd` that obeys the demo's command line.
fn demo_folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    let program = folder.path().join("cdcrctl");
    fs::copy(env!("CARGO_BIN_EXE_cdcrctl"), program).expect("copied");
    fs::create_dir(folder.path().join("tmp")).expect("made");
    let ourselves = std::env::current_exe().expect("known");
    // cdcrd run --config FILE --robot demo --prefix P --root DIR
    let script = format!(
        "#!/bin/sh\n\
         test \"$1 $2 $4 $5 $6 $8\" = 'run --config --robot demo --prefix --root' || exit 9\n\
         FAKE_PREFIX=\"$7\" FAKE_ROOT=\"$9\" \\\n\
         exec {} --ignored --exact be_the_daemon_of_a_demo\n",
        ourselves.display()
    );
    let daemon = folder.path().join("cdcrd");
    fs::write(&daemon, script).expect("written");
    fs::set_permissions(&daemon, fs::Permissions::from_mode(0o755)).expect("executable");
    folder
}

fn demo(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(folder.join("cdcrctl"));
    command
        .arg("demo")
        .args(arguments)
        .env("TMPDIR", folder.join("tmp"))
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command
}

/// Nothing of the demo that was process `id` is left, though its daemon was killed by SIGTERM.
fn assert_nothing_left(folder: &Path, id: u32) {
    let left = fs::read_dir(folder.join("tmp")).expect("there").count();
    assert_eq!(left, 0, "files are left in the temporary folder");
    let prefix = format!("cdcr-demo-{id}-");
    for file in fs::read_dir("/dev/shm").expect("Linux").flatten() {
        let name = file.file_name().to_string_lossy().into_owned();
        assert!(
            !name.starts_with(&prefix),
            "{name} is left in shared memory"
        );
    }
}

#[test]
fn a_demo_reports_and_leaves_nothing() {
    let folder = demo_folder();
    let out = folder.path().join("out");
    let arguments = [
        "--sections",
        "2",
        "--duration",
        "500ms",
        "--format",
        "json",
        "--out",
    ];
    let mut command = demo(folder.path(), &arguments);
    let child = command.arg(&out).spawn().expect("runs");
    let id = child.id();
    let output = child.wait_with_output().expect("ended");
    assert!(output.status.success(), "{}", text(&output));
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one object");
    assert_eq!(report["sections"], 2);
    assert!(
        report["mean_error_mm"].as_f64().is_some_and(|e| e < 1e-3),
        "{report}"
    );
    assert!(
        report["cycles"].as_u64().is_some_and(|n| n > 50),
        "{report}"
    );
    assert_eq!(report["solve_us"]["p50"], 20.0);
    for file in ["telemetry.csv", "path.svg", "error.svg", "timing.svg"] {
        assert!(
            out.join(file).metadata().is_ok_and(|m| m.len() > 1000),
            "{file}"
        );
    }
    assert_nothing_left(folder.path(), id);
}

#[test]
fn an_interrupted_demo_leaves_nothing() {
    let folder = demo_folder();
    let child = demo(folder.path(), &[]).spawn().expect("runs");
    let id = child.id();
    std::thread::sleep(Duration::from_millis(1500));
    let pid = rustix::process::Pid::from_child(&child);
    rustix::process::kill_process(pid, rustix::process::Signal::INT).expect("signalled");
    let output = child.wait_with_output().expect("ended");
    assert_eq!(output.status.code(), Some(130), "{}", text(&output));
    assert_nothing_left(folder.path(), id);
}
