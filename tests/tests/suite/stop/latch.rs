//! A stop lasts until a reset, also across the end of the daemon, however it ends.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use cdcr_client::Connection;
use cdcr_shared_types::codes::{Mode, Outcome, Reason, RequestKind};
use cdcr_tests::record::largest;
use cdcr_tests::threads::Hung;
use cdcr_tests::{
    Daemon, ROBOT, STALL_TOLERANT, TIMEOUT, ask_for, refused, text, until_undisturbed, wait_status,
    wait_until,
};
use rustix::process::Signal;

use crate::faults::robot::Robot;
use crate::faults::trail::{Trail, is};
use crate::stop::place::empty;

/// Deadline misses of a stalled machine stop nothing here.
const CALM: &str = "[cycle]\nmiss_limit = 1000000\nwatchdog_ms = 60000.0\n";

fn latch_of(daemon: &Daemon) -> PathBuf {
    let lock = daemon.place().location().lock_file(ROBOT);
    lock.with_extension("latch")
}

/// For a simulated robot, which is measured at once.
fn mode_after_start(connection: &Connection) -> (u32, u32) {
    let status = wait_status(connection, |status| status.mode != Mode::Starting.code());
    (status.mode, status.reason)
}

/// Checks that the restarted daemon refuses to move the robot, gives the reason, and continues after a reset.
fn assert_waits_for_reset(daemon: &Daemon, before: &str) {
    let connection = daemon.connect();
    let stopped = (Mode::Stopped.code(), Reason::StoppedBefore.code());
    assert_eq!(mode_after_start(&connection), stopped);
    for kind in [RequestKind::Track, RequestKind::Home, RequestKind::Hold] {
        assert_eq!(refused(&connection, kind), Outcome::WrongMode);
    }
    let output = daemon.place().cdcrctl(&["home"]);
    assert!(!output.status.success());
    assert!(text(&output).contains("cdcrctl reset"), "{}", text(&output));
    daemon
        .place()
        .checked("cdcrctl status", 0, &["cdcrctl reset"]);
    let log = daemon.log();
    assert!(
        log.contains(before) && log.contains("until `cdcrctl reset`"),
        "{log}"
    );
    ask_for(&connection, RequestKind::Reset);
    ask_for(&connection, RequestKind::Home);
}

#[test]
fn a_stop_that_was_answered_holds_beyond_a_kill() {
    let mut daemon = Daemon::start(CALM);
    for _ in 0..10 {
        let connection = daemon.connect();
        ask_for(&connection, RequestKind::Home);
        ask_for(&connection, RequestKind::Stop);
        daemon.kill();
        // Twice: the stop that was found remains valid until a reset.
        for _ in 0..2 {
            daemon.restart();
            let connection = daemon.connect();
            assert_eq!(mode_after_start(&connection).0, Mode::Stopped.code());
            daemon.kill();
        }
        daemon.restart();
        assert_waits_for_reset(&daemon, "stopped (requested)");
        // An answered reset lasts, too.
        let connection = daemon.connect();
        ask_for(&connection, RequestKind::Stop);
        ask_for(&connection, RequestKind::Reset);
        daemon.kill();
        daemon.restart();
        let holding = (Mode::Holding.code(), Reason::Start.code());
        assert_eq!(mode_after_start(&daemon.connect()), holding);
    }
}

#[test]
fn a_stop_holds_beyond_an_orderly_end_and_an_end_alone_is_none() {
    let mut daemon = Daemon::start(CALM);
    assert!(daemon.stop().success(), "{}", daemon.log());
    assert!(!latch_of(&daemon).exists(), "nobody stopped the robot");
    let nothing = [
        "nothing was stopped: no daemon is running",
        "emergency stop",
    ];
    daemon.place().checked("cdcrctl stop", 1, &nothing);
    daemon.restart();
    let connection = daemon.connect();
    assert_eq!(mode_after_start(&connection).0, Mode::Holding.code());
    daemon.signal(Signal::USR1);
    wait_status(&connection, |status| status.mode == Mode::Stopped.code());
    assert!(daemon.stop().success(), "{}", daemon.log());
    daemon.restart();
    assert_waits_for_reset(&daemon, "stopped (requested)");
    assert!(daemon.stop().success(), "{}", daemon.log());
    assert!(!latch_of(&daemon).exists(), "it was reset");
}

#[test]
fn a_stop_while_the_daemon_ends_holds_for_the_next() {
    let mut daemon = Daemon::start(&format!(
        "{CALM}[link]\ninitial_bend_rad = [[0.8, 0.0], [0.0, 0.0], [0.0, 0.0]]\n\
         [motion]\nhome_rate_rad_s = 0.5\ndeceleration_rad_s2 = 0.1\n"
    ));
    for by_signal in [false, true] {
        until_undisturbed("a stop comes before the end", || {
            stop_while_it_ends(&mut daemon, by_signal)
        });
    }
}

/// `None` if a stall, in which the last command ran out, ended the ramp and the daemon before the stop.
fn stop_while_it_ends(daemon: &mut Daemon, by_signal: bool) -> Option<()> {
    let connection = daemon.connect();
    let mut trail = Trail::new(&connection);
    ask_for(&connection, RequestKind::Home);
    // Its ramp then takes 4 s.
    trail.until("at speed", |record| {
        largest(&record.command.bend_rate_rad_s) > 0.4
    });
    daemon.signal(Signal::TERM);
    trail.until("ending", is(Mode::Stopped));
    let answered = if by_signal {
        daemon.signal(Signal::USR1);
        true
    } else {
        let stopped = connection.request_within(RequestKind::Stop, Duration::from_secs(5));
        stopped.is_ok()
    };
    assert!(daemon.stop_after_signal().success(), "{}", daemon.log());
    drop((trail, connection));
    let is_latched = latch_of(daemon).exists();
    assert!(is_latched || by_signal || !answered, "{}", daemon.log());
    daemon.restart();
    if !is_latched {
        return None;
    }
    assert_waits_for_reset(daemon, "stopped (requested)");
    ask_for(&daemon.connect(), RequestKind::Hold);
    assert!(daemon.stop().success(), "{}", daemon.log());
    daemon.restart();
    Some(())
}

/// A hung cycle cannot execute the stop, but the next daemon must not move the robot.
#[test]
fn a_stop_that_finds_a_hung_cycle_holds_for_the_next_daemon() {
    for by_signal in [false, true] {
        let mut daemon = Daemon::start("[cycle]\nmiss_limit = 1000000\n");
        let Some(hung) = Hung::new(daemon.id(), "cdcr-cycle") else {
            return;
        };
        if by_signal {
            daemon.signal(Signal::USR1);
        } else {
            let output = daemon.place().cdcrctl(&["stop"]);
            println!("{}", text(&output));
        }
        wait_until("its watchdog ends it", || {
            hung.reap();
            !daemon.runs()
        });
        drop(hung);
        daemon.restart();
        assert_waits_for_reset(&daemon, "stopped (requested)");
    }
}

#[test]
fn a_fault_holds_beyond_a_kill_and_an_orderly_end() {
    let mut daemon = Daemon::start(&format!(
        "{STALL_TOLERANT}[link]\nkind = \"driver\"\nmeasurement_timeout_ms = 500.0\n"
    ));
    for is_killed in [true, false] {
        let connection = daemon.connect();
        let (mut trail, robot) = Robot::held(&connection, 1.0);
        // The driver falls silent.
        trail.until("faulted", is(Mode::Faulted));
        drop((robot, trail, connection));
        if is_killed {
            daemon.kill();
        } else {
            assert!(daemon.stop().success(), "{}", daemon.log());
        }
        daemon.restart();
        let connection = daemon.connect();
        let mut trail = Trail::new(&connection);
        // Before the first measurement.
        trail.until("starting", is(Mode::Starting));
        let mut robot = Robot::new(&connection, 1.0);
        let (before, stopped) = trail.until_while("stopped", || robot.turn(), is(Mode::Stopped));
        assert_eq!(before.mode, Mode::Starting.code());
        assert_eq!(stopped.reason, Reason::StoppedBefore.code());
        let wanted = "faulted (the measurement is lost)";
        assert!(daemon.log().contains(wanted), "{}", daemon.log());
        refused(&connection, RequestKind::Home);
        // If a stall causes another fault, the daemon waits for a measurement.
        wait_until("a reset", || {
            robot.turn();
            connection
                .request_within(RequestKind::Reset, TIMEOUT)
                .is_ok()
        });
        trail.until_while("holding", || robot.turn(), is(Mode::Holding));
    }
}

#[test]
fn a_stop_holds_where_the_latch_or_the_whole_folder_was_deleted() {
    let mut daemon = Daemon::start(CALM);
    ask_for(&daemon.connect(), RequestKind::Stop);
    fs::remove_file(latch_of(&daemon)).unwrap();
    assert!(daemon.stop().success(), "{}", daemon.log());
    daemon.restart();
    assert_waits_for_reset(&daemon, "stopped (requested)");
    let ways: [fn(&Path); 2] = [empty, |root| fs::remove_dir_all(root).unwrap()];
    for delete in ways {
        ask_for(&daemon.connect(), RequestKind::Stop);
        delete(daemon.place().location().root());
        let ended = daemon.stop_after_signal();
        assert_eq!(ended.code(), Some(83), "{}", daemon.log());
        daemon.restart();
        assert_waits_for_reset(&daemon, "stopped (requested)");
    }
}

#[test]
fn a_latch_that_is_not_the_daemons_is_not_used() {
    let mut daemon = Daemon::start(CALM);
    assert!(daemon.stop().success(), "{}", daemon.log());
    let elsewhere = daemon.place().folder().join("elsewhere");
    fs::write(&elsewhere, "theirs and long enough").unwrap();
    std::os::unix::fs::symlink(&elsewhere, latch_of(&daemon)).unwrap();
    daemon.place().checked(
        "cdcrd run",
        73,
        &[".latch", "it is a symbolic link\nremove it"],
    );
    assert_eq!(
        fs::read_to_string(&elsewhere).unwrap(),
        "theirs and long enough"
    );
}
