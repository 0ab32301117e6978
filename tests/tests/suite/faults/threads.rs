//! Hanging threads: the test stops a single thread as a debugger does.

use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use cdcr_client::{ConnectError, Connection, FeedEnd, FeedEvent, LinkError, monotonic_ns};
use cdcr_shared_types::codes::{Mode, RequestKind};
use cdcr_tests::managed::Managed;
use cdcr_tests::threads::Hung;
use cdcr_tests::{Daemon, ROBOT, TIMEOUT, ask_for, paper_line, tracked, wait_status, wait_until};
use rustix::process::Signal;

use crate::faults::robot::Robot;
use crate::faults::trail::{Trail, is, rests};

/// Longer than a machine keeps a thread from running beside others.
const WATCHDOG: Duration = Duration::from_millis(500);
/// The watchdog checks every 50 ms: the hang may be up to two checks shorter than the counted time.
const LOOKS: Duration = Duration::from_millis(100);
/// The supervisor publishes its status every 100 ms. At most three status messages are not counted in the
/// watchdog's time. They are that of the check under way, that of the check that ends the process, and one of
/// a supervisor delayed between publishing and counting.
const STATUSES_MAX: u64 = WATCHDOG.as_millis() as u64 / 100 + 3;
/// Message about the end of a hung thread.
const NO_PROGRESS: &str = "made no progress for 500 ms";
pub(crate) const VALID_FOR_NS: u64 = 100_000_000;

fn with_driver() -> Daemon {
    Daemon::start(&format!(
        "[link]\nkind = \"driver\"\nmeasurement_timeout_ms = 5000.0\ncommand_valid_ms = 100.0\n\
         [motion]\nhome_rate_rad_s = 0.1\n\
         [cycle]\nmiss_limit = 1000000\nwatchdog_ms = {}.0\n",
        WATCHDOG.as_millis()
    ))
}

/// Runs the driver until a daemon with a hung thread has ended.
fn drive_until_end(daemon: &mut Daemon, robot: &mut Robot, hung: &Hung) {
    let begin = Instant::now();
    while daemon.runs() {
        hung.reap();
        robot.turn();
        std::thread::sleep(Duration::from_millis(1));
        assert!(
            begin.elapsed() < TIMEOUT,
            "it does not end:\n{}",
            daemon.log()
        );
    }
}

/// Checks a thread that hangs while the robot moves: the process ends with `status`, and the driver knows how
/// long the last rates are valid. Then a new daemon works at once.
fn assert_ends_when_hung(thread: &str, sentence: &str, status: i32) {
    let mut daemon = with_driver();
    let connection = daemon.connect();
    let (mut trail, mut robot) = Robot::held(&connection, 1.0);
    let mut statuses = connection.statuses().unwrap();
    ask_for(&connection, RequestKind::Home);
    trail.until_while("moving", || robot.turn(), |record| !rests(record));

    let Some(hung) = Hung::new(daemon.id(), thread) else {
        return;
    };
    let hung_ns = monotonic_ns();
    drive_until_end(&mut daemon, &mut robot, &hung);
    let end_ns = monotonic_ns();
    let ended = daemon.stop_after_signal();
    assert_eq!(ended.code(), Some(status), "{}", daemon.log());
    assert!(daemon.log().contains(sentence), "{}", daemon.log());
    let mut counted = 0;
    while let Some(status) = statuses.try_next().unwrap() {
        counted += u64::from(status.header.sent_ns > hung_ns);
    }
    assert!(counted <= STATUSES_MAX, "{counted} statuses after the hang");
    // No command has come since, and the last one has expired.
    let last = robot.last_command().unwrap();
    assert_eq!(last.valid_until_ns - last.release_ns, VALID_FOR_NS);
    assert!(last.release_ns <= hung_ns, "a command of a later cycle");
    // At the release of its last command both threads still ran.
    let still = Duration::from_nanos(end_ns - last.release_ns);
    println!("{thread} hung: the process ended {still:?} after its last command's release");
    assert!(still + LOOKS > WATCHDOG, "{still:?}");
    wait_until("it has run out", || last.valid_until_ns < monotonic_ns());

    daemon.restart();
    let connection = daemon.connect();
    Robot::held(&connection, 0.9);
}

#[test]
fn a_hung_cycle_thread_ends_the_process() {
    assert_ends_when_hung("cdcr-cycle", &format!("the cycle thread {NO_PROGRESS}"), 80);
}

#[test]
fn a_hung_exchange_thread_ends_the_process() {
    assert_ends_when_hung(
        "cdcr-exchange",
        &format!("the exchange thread {NO_PROGRESS}"),
        81,
    );
}

/// Checks that an error about silence says that the process runs, without a hint how to start it.
fn assert_names_the_process(error: &LinkError, process: u32) {
    let text = error.to_string();
    let is_reported = text.contains(&format!("it runs (process {process})"));
    assert!(is_reported && !text.contains("cdcrd run"), "{text}");
}

#[test]
fn a_hung_reporter_holds_up_nobody_and_ends_the_process_at_last() {
    let mut daemon = with_driver();
    let connection = daemon.connect();
    let (mut trail, mut robot) = Robot::moving(&connection);

    let Some(hung) = Hung::new(daemon.id(), "cdcr-reporter") else {
        return;
    };
    let hung_ns = monotonic_ns();
    // When it sent its last record, it still ran.
    let mut last_sent_ns = 0;
    while let Some(record) = trail.next_waiting() {
        last_sent_ns = record.header.sent_ns;
    }
    ask_for(&connection, RequestKind::Stop);
    wait_until("the commands stop the robot", || {
        robot.turn();
        let last = robot.last_command().unwrap();
        last.release_ns > hung_ns && last.bend_rate_rad_s.iter().all(|rate| *rate == 0.0)
    });
    // Another client can still connect and gets answers.
    let other = daemon.connect();
    ask_for(&other, RequestKind::Stop);
    drop(other);
    // It is not taken for an ended daemon.
    let silent = connection.settings().expect_err("no telemetry");
    assert_names_the_process(&silent, daemon.id());
    drive_until_end(&mut daemon, &mut robot, &hung);
    let still = Duration::from_nanos(monotonic_ns() - last_sent_ns);
    assert!(still + LOOKS > 5 * WATCHDOG, "{still:?}");
    let last = robot.last_command().unwrap();
    assert!(last.release_ns > hung_ns + WATCHDOG.as_nanos() as u64);
    let ended = daemon.stop_after_signal();
    assert_eq!(ended.code(), Some(81), "{}", daemon.log());
    let sentence = "the reporter thread made no progress for 2500 ms (5 times cycle.watchdog_ms)";
    assert!(daemon.log().contains(sentence), "{}", daemon.log());
}

#[test]
fn a_feed_goes_on_while_the_reporter_hangs() {
    let daemon = Daemon::start("[cycle]\nmiss_limit = 1000000\nwatchdog_ms = 2000.0\n");
    let connection = daemon.connect();
    let line = paper_line(60.0);
    let (mut hung, mut hung_at, mut back) = (None, None, None);
    let fed = connection.feed(&line, tracked()).unwrap().run(|event| {
        let FeedEvent::Progress(progress) = event else {
            return ControlFlow::Continue(());
        };
        if progress.tracking && hung_at.is_none() {
            hung_at = Some(Instant::now());
            hung = Hung::new(daemon.id(), "cdcr-reporter");
        }
        // Twice as long as a feed waits for a silent daemon.
        if hung_at.is_some_and(|at| at.elapsed() > Duration::from_secs(2)) {
            hung = None;
            back.get_or_insert_with(Instant::now);
        }
        match back {
            Some(at) if at.elapsed() > Duration::from_millis(200) => ControlFlow::Break(()),
            _ => ControlFlow::Continue(()),
        }
    });
    let report = fed.unwrap();
    assert_eq!((report.end, report.tracked), (FeedEnd::Interrupted, true));
}

#[test]
fn a_status_thread_that_hangs_for_good_ends_the_process_at_last() {
    let mut daemon = with_driver();
    let connection = daemon.connect();
    let (_, mut robot) = Robot::held(&connection, 1.0);
    let Some(hung) = Hung::new(daemon.id(), "cdcr-status") else {
        return;
    };
    let begin = Instant::now();
    drive_until_end(&mut daemon, &mut robot, &hung);
    assert!(begin.elapsed() + LOOKS > 20 * WATCHDOG);
    let ended = daemon.stop_after_signal();
    assert_eq!(ended.code(), Some(81), "{}", daemon.log());
    let sentence = "the status thread made no progress for 10000 ms (20 times cycle.watchdog_ms)";
    assert!(daemon.log().contains(sentence), "{}", daemon.log());
    daemon.restart();
    daemon.connect().status(TIMEOUT).unwrap();
}

#[test]
fn a_hung_supervisor_leaves_the_loop_running_and_starves_the_service_managers_watchdog() {
    let managed = Managed::start();
    let location = managed.place.location();
    let connection = Connection::open_within(location, ROBOT, TIMEOUT).unwrap();
    let mut trail = Trail::new(&connection);
    trail.until("holding", is(Mode::Holding));
    wait_until("the watchdog is fed", || managed.fed() > 0);

    let Some(hung) = Hung::new(managed.daemon.id(), "cdcrd") else {
        return;
    };
    managed.fed();
    trail.catch_up();
    let mut last = connection.status(TIMEOUT).unwrap();
    trail.until("the status is stale", |_| {
        match connection.status(Duration::ZERO) {
            Ok(status) => last = status,
            Err(error) => {
                assert_names_the_process(&error, managed.daemon.id());
                return matches!(error, LinkError::Silent { .. });
            }
        }
        false
    });
    let silent_ns = monotonic_ns() - last.header.sent_ns;
    println!(
        "supervisor hung: silent after {:.1} ms",
        silent_ns as f64 * 1e-6
    );
    assert!(silent_ns >= 1_000_000_000, "{silent_ns} ns");
    trail.until("the loop goes on", |record| {
        record.release_ns > last.header.sent_ns + silent_ns
    });
    assert_eq!(managed.fed(), 0, "five were due");
    // New clients learn that it runs but is delayed; the robot can still be stopped, in two ways.
    let error = Connection::open(location, ROBOT).expect_err("no status");
    assert!(matches!(error, ConnectError::Silent { .. }), "{error:?}");
    managed.place.checked("cdcrctl stop", 0, &[]);
    trail.until("stopped", is(Mode::Stopped));
    ask_for(&connection, RequestKind::Reset);
    trail.until("holding again", is(Mode::Holding));
    managed.daemon.signal(Signal::USR1);
    trail.until("stopped by a signal", is(Mode::Stopped));

    drop(hung);
    wait_until("the watchdog is fed", || managed.fed() > 0);
    wait_status(&connection, |status| status.mode == Mode::Stopped.code());
}

/// The messages leave through a thread that may wait for files. The thread itself is not waited for.
#[test]
fn a_hung_status_thread_keeps_neither_the_watchdog_nor_the_end_waiting() {
    let mut managed = Managed::start();
    let location = managed.place.location();
    let connection = Connection::open_within(location, ROBOT, TIMEOUT).unwrap();
    let mut trail = Trail::new(&connection);
    trail.until("holding", is(Mode::Holding));
    let Some(hung) = Hung::new(managed.daemon.id(), "cdcr-status") else {
        return;
    };
    trail.until("there is no status", |_| {
        connection.status(Duration::ZERO).is_err()
    });
    managed.fed();
    for _ in 0..5 {
        trail.until("the watchdog is fed", |_| managed.fed() > 0);
    }
    // The status thread handles neither requests nor records.
    managed.place.checked("cdcrctl stop", 0, &[]);
    trail.until("stopped", is(Mode::Stopped));
    managed.daemon.signal(Signal::TERM);
    wait_until("it ends", || {
        hung.reap();
        !managed.daemon.runs()
    });
    assert_eq!(managed.daemon.wait(String::new).code(), Some(0));
}
