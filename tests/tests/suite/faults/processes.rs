//! Daemons that do not start, end, or meet another version; and their exit statuses.

use std::fs::{File, OpenOptions, Permissions};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt, PermissionsExt, chown};
use std::panic::resume_unwind;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use cdcr_client::{ConnectError, Connection, LinkError, monotonic_ns};
use cdcr_daemon::app::run_until;
use cdcr_daemon::config::Config;
use cdcr_daemon::exit::ExitCause;
use cdcr_daemon::instance::is_in_memory;
use cdcr_scratch::Scratch;
use cdcr_shared_types::{Service, ipc};
use cdcr_test_skip::{Need, skip};
use cdcr_tests::{Daemon, Place, Program, ROBOT, TIMEOUT, assert_output, wait_status, wait_until};
use iceoryx2::prelude::Node;
use rustix::process::Signal;

use crate::faults::robot::Robot;

/// User and group `nobody`.
const NOBODY: u32 = 65_534;

/// Checks that `cdcrd run` with these options ends with this status and text, and leaves nothing in shared
/// memory.
fn assert_refused(place: &Place, options: &[&str], status: i32, parts: &[&str]) {
    let mut command = place.command("cdcrd");
    assert_output(
        &Program::start(command.arg("run").args(options)).output(),
        status,
        parts,
    );
    assert_eq!(place.memory_files(), Vec::<PathBuf>::new());
}

/// The same with this configuration.
fn assert_configuration_refused(text: &str, status: i32, parts: &[&str]) {
    let place = Place::new();
    let path = place.write("robot.toml", text);
    assert_refused(&place, &["--config", path.to_str().unwrap()], status, parts);
}

#[test]
fn a_second_daemon_ends_with_69_and_the_first_goes_on() {
    let mut daemon = Daemon::start("");
    let process = format!("process {}", daemon.id());
    let prefix = daemon.place().location().prefix();
    let parts = [
        "already running",
        &process,
        "kill",
        ROBOT,
        prefix,
        "--prefix",
    ];
    daemon.place().checked("cdcrd run", 69, &parts);
    let connection = daemon.connect();
    let before = connection.status(TIMEOUT).unwrap();
    let after = wait_status(&connection, |status| status.cycles > before.cycles + 10);
    assert_eq!((after.process_id, after.faults), (daemon.id(), 0));
    drop(connection);
    // A daemon that was asked to end.
    let ended = daemon.stop();
    assert_eq!(ended.code(), Some(0), "{}", daemon.log());
}

#[test]
fn a_killed_daemon_leaves_the_driver_a_command_that_runs_out() {
    let mut daemon = Daemon::start(
        "[link]\nkind = \"driver\"\nmeasurement_timeout_ms = 5000.0\ncommand_valid_ms = 80.0\n\
         [cycle]\nmiss_limit = 1000000\n",
    );
    let connection = daemon.connect();
    let (_, mut robot) = Robot::moving(&connection);
    daemon.kill();
    let killed_ns = monotonic_ns();
    wait_until("the last command runs out", || {
        robot.turn();
        let last = robot.last_command().unwrap();
        last.valid_until_ns < monotonic_ns()
    });
    let last = robot.last_command().unwrap();
    let valid_for_ns = last.valid_until_ns - last.release_ns;
    assert_eq!(valid_for_ns, 80_000_000);
    assert!(last.header.sent_ns <= killed_ns);
    let ran_out_ns = last.valid_until_ns.saturating_sub(killed_ns);
    println!(
        "daemon killed: the last command ran out {:.1} ms later",
        ran_out_ns as f64 * 1e-6
    );
    assert!(ran_out_ns <= valid_for_ns);
    // Its clients detect this after a second, and a new one works at once.
    wait_until("the status is stale", || {
        let status = connection.status(Duration::ZERO);
        matches!(status, Err(LinkError::Silent { .. }))
    });
    daemon.restart();
    let connection = daemon.connect();
    Robot::held(&connection, 0.9);
}

/// Stops a client, and replaces its files by their unfinished state. Returns their paths.
fn stop_client_while_it_connects(daemon: &Daemon, topic: &str) -> (Vec<PathBuf>, Program) {
    let connections = || {
        let mut names = daemon.place().memory_files();
        names.retain(|path| path.extension().is_some_and(|end| end == "connection"));
        names
    };
    // The daemon releases the files of earlier clients at its next check.
    let before = connections();
    let news = || {
        let mut names = connections();
        names.retain(|name| !before.contains(name));
        names
    };
    let mut command = daemon.place().command("cdcrctl");
    let client = Program::start(command.args(["echo", topic]));
    // When it has printed its heading and the first message, it has created all of its files.
    wait_until("the client reads", || client.lines() >= 2);
    client.signal(Signal::STOP);
    let left = news();
    for path in &left {
        // The daemon keeps its own mapping of the old file.
        std::fs::remove_file(path).unwrap();
        let mut options = OpenOptions::new();
        options.write(true).create_new(true).mode(0o200);
        options.open(path).unwrap();
    }
    assert!(!left.is_empty());
    (left, client)
}

fn kill_client_while_it_connects(daemon: &Daemon, topic: &str) {
    let (_, mut client) = stop_client_while_it_connects(daemon, topic);
    client.signal(Signal::KILL);
    client.output();
}

#[test]
fn a_client_killed_while_it_connects_does_not_block_those_that_follow() {
    let mut daemon = Daemon::start("[cycle]\nmiss_limit = 1000000\n");
    let (left, mut client) = stop_client_while_it_connects(&daemon, "status");
    // A slow client keeps its files: the daemon has had time for two checks.
    std::thread::sleep(Duration::from_millis(2200));
    assert!(left.iter().all(|path| path.exists()), "{left:?}");
    client.signal(Signal::KILL);
    client.output();
    let begin = Instant::now();
    // Only the daemon removes it.
    wait_until("it is removed", || !left.iter().any(|path| path.exists()));
    let took = begin.elapsed();
    println!(
        "client killed while it connects: cleared after {:.1} s",
        took.as_secs_f64()
    );
    daemon.place().checked("cdcrctl status", 0, &[]);
    // A daemon that ends at once, and one that replaces a dead daemon, remove it themselves.
    kill_client_while_it_connects(&daemon, "telemetry");
    assert_eq!(daemon.stop().code(), Some(0), "{}", daemon.log());
    daemon.restart();
    kill_client_while_it_connects(&daemon, "command");
    daemon.kill();
    daemon.restart();
    assert_eq!(daemon.stop().code(), Some(0), "{}", daemon.log());
}

#[test]
fn a_wrong_configuration_ends_with_78() {
    let parts = ["robot.toml", "line 2", "0.1 to 100"];
    assert_configuration_refused("[cycle]\nperiod_ms = 0.01\n", 78, &parts);
}

#[test]
fn settings_into_which_no_cycle_fits_end_with_78() {
    let sections =
        "[[robot.sections]]\nlength_m = 0.15\ncable_radius_m = 0.0125\ncable_offset_rad = 0.0\n\
                    bend_max_rad = 2.8\nrate_max_rad_s = 2.0\nbody_radius_m = 0.015\n"
            .repeat(6);
    let configuration = format!(
        "[cycle]\nperiod_ms = 0.1\ngather_lead_ms = 0.05\n[realtime]\nspin_us = 50.0\n\
         [controller]\nhorizon_steps = 50\n{sections}"
    );
    let parts = [
        "sections: 6",
        "horizon_steps = 50",
        "0.050 ms before the release",
    ];
    assert_configuration_refused(&configuration, 78, &parts);
}

#[test]
fn real_time_that_is_not_granted_ends_with_77() {
    // No test machine has a core 1000.
    for configuration in [
        "[realtime]\nmode = \"require\"\ncore = 1000\n",
        // The default of a robot behind a driver.
        "[link]\nkind = \"driver\"\n[realtime]\ncore = 1000\n",
    ] {
        let parts = ["require", "core pinning", "prefer"];
        assert_configuration_refused(configuration, 77, &parts);
    }
}

#[test]
fn a_root_folder_of_another_user_ends_with_73() {
    let place = Place::new();
    let root = if rustix::process::geteuid().is_root() {
        let root = place.folder().join("foreign");
        std::fs::create_dir(&root).unwrap();
        if let Err(cause) = chown(&root, Some(NOBODY), Some(NOBODY)) {
            skip(
                Need::Root,
                format!("the system does not let us give a folder away: {cause}"),
            );
            return;
        }
        root
    } else {
        "/usr".into()
    };
    let options = ["--root", root.to_str().unwrap()];
    assert_refused(&place, &options, 73, &["belongs to user", "--root"]);
}

#[test]
fn a_root_folder_on_a_disk_ends_with_73() {
    // Neither in memory nor owned by another user: the folder of this build, otherwise one that survives a
    // reboot.
    let place = Place::new();
    let root = Scratch::on_disk().unwrap();
    if is_in_memory(root.path()).unwrap() {
        skip(
            Need::Disk,
            "nothing to refuse: the target folder is in memory",
        );
        return;
    }
    let options = ["--root", root.path().to_str().unwrap()];
    assert_refused(&place, &options, 73, &["on a disk", "/dev/shm", "--root"]);
    assert_eq!(std::fs::read_dir(root.path()).unwrap().count(), 0);
}

#[test]
fn a_root_folder_with_files_that_others_could_open_ends_with_73() {
    let place = Place::new();
    let root = place.location().root();
    std::fs::create_dir(root).unwrap();
    std::fs::write(root.join("left"), "by a killed daemon").unwrap();
    std::fs::set_permissions(root, Permissions::from_mode(0o711)).unwrap();
    assert_refused(&place, &[], 73, &["mode 0711", "empty it", "--root"]);
    std::fs::remove_file(root.join("left")).unwrap();
    let mut program = Program::start(place.command("cdcrd").arg("run"));
    wait_until("it is closed", || {
        std::fs::metadata(root).unwrap().mode() & 0o777 == 0o700
    });
    program.signal(Signal::TERM);
    assert!(program.output().status.success());
}

#[test]
fn a_root_folder_that_somebody_has_locked_ends_with_75() {
    let place = Place::new();
    let root = place.location().root();
    std::fs::create_dir(root).unwrap();
    let locked = File::open(root).unwrap();
    locked.lock().unwrap();
    let parts = ["another process has locked", "--root"];
    assert_refused(&place, &[], 75, &parts);
}

#[test]
fn a_wrong_command_line_ends_with_2() {
    let place = Place::new();
    let parts = ["--no-such-option", "--help"];
    assert_refused(&place, &["--no-such-option"], 2, &parts);
}

#[test]
fn a_thread_that_panics_ends_with_70() {
    let place = Place::new();
    let configuration = format!(
        "[transport]\nprefix = \"{}\"\nroot = \"{}\"\n",
        place.location().prefix(),
        place.location().root().display()
    );
    let validated = Config::parse(&configuration, &place.folder().join("robot.toml")).unwrap();
    // Without the hook, whose backtrace takes longer on a busy machine than a cycle may hang.
    let run = run_until(
        &validated,
        || false,
        |_| resume_unwind(Box::new("a test of panics")),
    );
    let error = run.unwrap_err();
    assert_eq!(ExitCause::from_error(&error), ExitCause::Panicked);
    assert!(error.to_string().contains("cdcr-cycle panicked"), "{error}");
    assert_eq!(place.memory_files(), Vec::<PathBuf>::new());
}

#[test]
fn a_service_of_another_version_keeps_the_daemon_out_with_71_and_the_client_too() {
    let place = Place::new();
    let node: Node<ipc::Variant> = place.location().node_builder().unwrap().create().unwrap();
    // The first file that a client opens.
    let other = node
        .service_builder(&Service::Reference.name(ROBOT).unwrap())
        .publish_subscribe::<u64>()
        .create()
        .unwrap();
    let service = format!("cdcr/{ROBOT}/reference");
    let parts = [&*service, "another version", "end the clients"];
    place.checked("cdcrd run", 71, &parts);
    let error = Connection::open(place.location(), ROBOT).expect_err("another version");
    let is_of_reference = matches!(
        error,
        ConnectError::VersionMismatch {
            service: "reference",
            ..
        }
    );
    assert!(is_of_reference, "{error:?}");
    let parts = [
        "another version of the reference service",
        "of the same version",
    ];
    place.checked("cdcrctl status", 1, &parts);
    drop(other);
    drop(node);
}
