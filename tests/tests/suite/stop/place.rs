//! The files by which clients find a daemon are deleted while it runs: it makes them again or ends, no second one
//! starts beside it, and no stop is said to have succeeded that did not.

use std::fs;
use std::path::PathBuf;

use cdcr_shared_types::codes::Mode;
use cdcr_tests::{Daemon, PATIENT, Program, ROBOT, text, wait_mode, wait_until};
use rustix::fs::{FlockOperation, flock};
use rustix::process::Signal;

/// A second daemon at the same place is refused, and names the first.
fn assert_second_is_refused(daemon: &Daemon) {
    let output = daemon.place().command("cdcrd").arg("run").output().unwrap();
    let text = text(&output);
    assert_eq!(output.status.code(), Some(69), "{text}");
    assert!(text.contains(&format!("process {}", daemon.id())), "{text}");
}

#[test]
fn a_deleted_lock_file_is_made_again_and_lets_no_second_daemon_in() {
    let mut daemon = Daemon::start(PATIENT);
    let mut telemetry = daemon.connect().telemetry().unwrap();
    let lock = daemon.place().location().lock_file(ROBOT);
    for _ in 0..2 {
        fs::remove_file(&lock).unwrap();
        assert_second_is_refused(&daemon);
        wait_until("it is made again", || {
            let text = fs::read_to_string(&lock).unwrap_or_default();
            text.trim() == daemon.id().to_string()
        });
        assert_second_is_refused(&daemon);
    }
    let output = daemon.place().cdcrctl(&["stop"]);
    assert!(output.status.success(), "{}", text(&output));
    wait_mode(&mut telemetry, Mode::Stopped);
    assert!(daemon.stop().success(), "{}", daemon.log());
    assert!(!lock.exists(), "the end removes it");
}

/// A second daemon does not start while the first runs.
fn assert_none_starts_beside(daemon: &mut Daemon) {
    let mut second = Program::start(daemon.place().command("cdcrd").arg("run"));
    wait_until("one of them ends", || !second.runs() || !daemon.runs());
    if daemon.runs() {
        let output = second.output();
        assert_eq!(output.status.code(), Some(69), "{}", text(&output));
    } else if second.runs() {
        // The machine stalled for so long that the first had come to its end.
        second.signal(Signal::TERM);
        second.output();
    }
}

/// Deletes with `delete`; then the daemon ends with a number of its own, and nobody took its place meanwhile.
fn assert_ends_without_its_place(delete: impl FnOnce(&std::path::Path)) {
    let mut daemon = Daemon::start(PATIENT);
    let root = daemon.place().location().root().to_owned();
    delete(&root);
    assert_none_starts_beside(&mut daemon);
    let output = daemon.place().cdcrctl(&["stop"]);
    let said = text(&output);
    // The daemon may have ended meanwhile, where the machine stalls.
    assert!(!output.status.success(), "{said}");
    assert!(
        said.contains("not confirmed") || !daemon.runs(),
        "a stop that is not true: {said}"
    );
    if daemon.runs() && said.contains("not confirmed") {
        assert!(said.contains(&format!("process {}", daemon.id())), "{said}");
    }
    let ended = daemon.stop_after_signal();
    assert_eq!(ended.code(), Some(83), "{}", daemon.log());
    assert!(daemon.log().contains("was emptied or replaced"));
    // It left nothing, and its place is free.
    daemon.restart();
    assert!(daemon.place().cdcrctl(&["stop"]).status.success());
    assert!(daemon.stop().success(), "{}", daemon.log());
    let left = daemon.place().shared_memory_files();
    assert_eq!(left, Vec::<PathBuf>::new());
}

#[test]
fn an_emptied_root_folder_ends_the_daemon_at_rest() {
    assert_ends_without_its_place(|root| {
        for entry in fs::read_dir(root).unwrap().flatten() {
            let path = entry.path();
            if path.is_dir() {
                fs::remove_dir_all(path).unwrap();
            } else {
                fs::remove_file(path).unwrap();
            }
        }
    });
}

#[test]
fn a_replaced_root_folder_ends_the_daemon_at_rest() {
    assert_ends_without_its_place(|root| {
        fs::rename(root, root.with_extension("away")).unwrap();
        fs::create_dir(root).unwrap();
    });
}

#[test]
fn programs_that_delete_old_files_leave_the_root_folder_alone() {
    let daemon = Daemon::start(PATIENT);
    let root = fs::File::open(daemon.place().location().root()).unwrap();
    // systemd-tmpfiles takes this lock before it goes into a folder, and passes by one that is taken.
    wait_until("the folder is locked", || {
        let locked = flock(&root, FlockOperation::NonBlockingLockExclusive);
        if locked.is_ok() {
            flock(&root, FlockOperation::Unlock).unwrap();
        }
        locked.is_err()
    });
}
