//! Notifications of `cdcrd run` to the service manager that started it.

use cdcr_tests::managed::{Managed, heard_by, listen};
use cdcr_tests::{Place, Program, Running, unread_pipe};
use rustix::process::Signal;

#[test]
fn the_service_manager_is_notified_from_ready_to_stopping() {
    let mut managed = Managed::start();
    let mut heard = Vec::new();
    for what in ["READY=1", "STATUS=", "WATCHDOG=1", "WATCHDOG=1"] {
        heard.extend(managed.hear_until(what));
    }
    managed.daemon.signal(Signal::TERM);
    heard.extend(managed.hear_until("STOPPING=1"));
    assert!(managed.daemon.wait(String::new).success());
    let at = |what: &str| {
        heard
            .iter()
            .position(|line| line.starts_with(what))
            .unwrap()
    };
    assert!(at("READY=1") < at("STOPPING=1"), "{heard:?}");
    let readies = heard.iter().filter(|line| *line == "READY=1").count();
    assert_eq!(readies, 1, "{heard:?}");
    let status = &heard[at("STATUS=")];
    for part in [" Hz, ", " miss", " skipped period"] {
        assert!(status.contains(part), "{status}");
    }
}

#[test]
fn a_daemon_that_cannot_start_is_never_ready() {
    let mut managed = Managed::start();
    managed.hear_until("READY=1");
    let manager = listen(managed.place.folder(), "second");
    // A second daemon for the same robot at the same location.
    let mut second = managed.place.command("cdcrd");
    let ended = Program::start(manager.manage(second.arg("run"))).output();
    assert_eq!(ended.status.code(), Some(69));
    let heard = heard_by(&manager);
    assert!(!heard.contains(&"READY=1".to_owned()), "{heard:?}");
    managed.end();
}

#[test]
fn a_log_that_nobody_reads_stops_neither_the_status_nor_the_end() {
    let (_reader, writer) = unread_pipe();
    let mut managed = Managed::start_onto(writer);
    managed.hear_until("READY=1");
    for _ in 0..3 {
        managed.hear_until("STATUS=");
        managed.hear_until("WATCHDOG=1");
    }
    managed.end();
}

#[test]
fn a_failure_whose_message_nobody_reads_ends_the_process_with_its_status() {
    let (_reader, writer) = unread_pipe();
    let place = Place::new();
    let mut command = place.command("cdcrd");
    command.args(["run", "--set", "cycle.period_ms=-1"]);
    let mut daemon = Running::start(command.stderr(writer));
    assert_eq!(daemon.wait(String::new).code(), Some(78));
}
