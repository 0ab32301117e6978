//! Start, end, kill and restart of the daemon.

use std::path::PathBuf;

use cdcr_client::{ConnectError, Connection};
use cdcr_tests::{Daemon, ROBOT, STALL_TOLERANT, wait_status};
use rustix::process::Signal;

use crate::soak::files_below;

#[test]
fn a_clean_end_leaves_nothing_behind() {
    for signal in [Signal::TERM, Signal::INT] {
        let mut daemon = Daemon::start(STALL_TOLERANT);
        let connection = daemon.connect();
        wait_status(&connection, |status| status.cycles > 5);
        assert!(!daemon.place().memory_files().is_empty());
        drop(connection);
        daemon.signal(signal);
        let status = daemon.stop_after_signal();
        assert!(status.success(), "{status}: {}", daemon.log());
        assert_eq!(daemon.place().memory_files(), Vec::<PathBuf>::new());
        assert_eq!(files_below(daemon.place().location().root()), 0);
    }
}

#[test]
fn a_dead_daemon_counts_as_none() {
    let mut daemon = Daemon::start(STALL_TOLERANT);
    daemon.kill();
    let error = Connection::open(daemon.place().location(), ROBOT).expect_err("it is dead");
    assert!(
        matches!(error, ConnectError::DaemonNotRunning { .. }),
        "{error:?}"
    );
}
