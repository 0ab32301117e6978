//! Start, end, kill and restart of the daemon.

use std::path::PathBuf;

use cdcr_client::{ConnectError, Connection};
use cdcr_shared_types::codes::Mode;
use cdcr_tests::{Daemon, PATIENT, ROBOT, TIMEOUT, wait_status};
use rustix::process::Signal;

#[test]
fn a_late_joiner_sees_the_status_at_once() {
    let daemon = Daemon::start(&format!("{PATIENT}[robot]\ncable_speed_max_m_s = 0.25\n"));
    let early = daemon.connect();
    wait_status(&early, |status| status.cycles > 20);
    let late = daemon.connect();
    let status = late.status(TIMEOUT).unwrap();
    assert!(status.cycles > 20);
    assert_eq!(status.mode, Mode::Holding.code());
    assert_eq!(
        (status.robot.sections, status.robot.cable_speed_max_m_s),
        (3, 0.25)
    );
    assert_eq!(status.period_ns, 5_000_000);
    let statistics = status.since_reset;
    assert_eq!(statistics.cycles, status.cycles);
    assert_eq!(statistics.response.count, status.cycles);
    let wake = statistics.wake;
    assert!(wake.p50_ns <= wake.p99_ns && wake.p99_ns <= wake.max_ns);
}

#[test]
fn a_clean_end_leaves_nothing_behind() {
    for signal in [Signal::TERM, Signal::INT] {
        let mut daemon = Daemon::start(PATIENT);
        let connection = daemon.connect();
        wait_status(&connection, |status| status.cycles > 5);
        assert!(!daemon.place().memory_files().is_empty());
        drop(connection);
        daemon.signal(signal);
        let status = daemon.stop_after_signal();
        assert!(status.success(), "{status}: {}", daemon.log());
        assert_eq!(daemon.place().memory_files(), Vec::<PathBuf>::new());
        let root = daemon.place().location().root();
        let left: Vec<_> = walk(root)
            .into_iter()
            .filter(|path| path.is_file())
            .collect();
        assert!(left.is_empty(), "{left:?}");
    }
}

fn walk(folder: &std::path::Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries
        .flat_map(|entry| {
            let path = entry.path();
            let mut below = if path.is_dir() {
                walk(&path)
            } else {
                Vec::new()
            };
            below.push(path);
            below
        })
        .collect()
}

#[test]
fn a_dead_daemon_counts_as_none() {
    let mut daemon = Daemon::start(PATIENT);
    daemon.kill();
    let error = Connection::open(daemon.place().location(), ROBOT).expect_err("it is dead");
    assert!(
        matches!(error, ConnectError::DaemonNotRunning { .. }),
        "{error:?}"
    );
}
