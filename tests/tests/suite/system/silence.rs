//! A daemon that is stopped like a frozen process: its clients detect it, and it works again afterwards.

use std::ops::ControlFlow;
use std::time::Duration;

use cdcr_client::{
    ConnectError, Connection, FeedEnd, FeedError, FeedEvent, Line, LinkError, RequestError,
    monotonic_ns,
};
use cdcr_shared_types::codes::{Mode, Outcome, RequestKind};
use cdcr_tests::{
    Daemon, ROBOT, STALL_TOLERANT, TIMEOUT, assert_output, text, tracked, until_undisturbed,
    wait_status, wait_until,
};
use rustix::process::Signal;

use super::freeze;

/// Longer than any test, slow enough to stay within reach.
fn long_line() -> Line {
    Line {
        duration_s: 120.0,
        velocity_m_s: [0.001, 0.0, -0.001],
        ..Line::for_sections(&[0.3; 3])
    }
}

/// Feeds until the feeder gives up the daemon, which is stopped during tracking.
fn feed_until_silence(daemon: &Daemon, connection: &Connection) -> FeedError {
    let (line, mut stopped) = (long_line(), false);
    let feeder = connection.feed(&line, tracked()).unwrap();
    let result = feeder.run(|event| {
        if let FeedEvent::Progress(progress) = event
            && progress.tracking
            && !stopped
        {
            daemon.signal(Signal::STOP);
            stopped = true;
        }
        ControlFlow::Continue(())
    });
    result.expect_err("the daemon is stopped")
}

#[test]
fn a_stopped_daemon_is_noticed_everywhere_and_works_again() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let connection = daemon.connect();
    let location = daemon.place().location();
    let error = feed_until_silence(&daemon, &connection);
    assert!(
        matches!(
            error,
            FeedError::Request(RequestError::Timeout { .. })
                | FeedError::Link(LinkError::Silent { .. })
        ),
        "{error:?}"
    );
    // Its last status counts as fresh for a moment.
    wait_until("the status is stale", || {
        let short = Duration::from_millis(1);
        matches!(connection.status(short), Err(LinkError::Silent { .. }))
    });
    let error = Connection::open(location, ROBOT).expect_err("no fresh status");
    assert!(matches!(error, ConnectError::Silent { .. }), "{error:?}");
    let error = connection.request(RequestKind::Hold).expect_err("silence");
    assert!(matches!(error, RequestError::Timeout { .. }), "{error:?}");
    for arguments in [&["status"][..], &["hold"], &["echo", "--count", "1"]] {
        let output = daemon.place().cdcrctl(arguments);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}");
        // It has not ended, and the text does not say so.
        let text = text(&output);
        let process = format!("(process {})", daemon.id());
        assert!(
            text.contains(&process) || text.contains("did not answer"),
            "{arguments:?}: {text}"
        );
        assert!(!text.contains("no daemon is running"), "{text}");
    }

    daemon.signal(Signal::CONT);
    let before = wait_status(&connection, |_| true);
    wait_status(&connection, |status| status.cycles > before.cycles + 20);
    wait_until("the lease is free", || connection.acquire_lease().is_ok());
    let line = Line {
        duration_s: 0.3,
        ..long_line()
    };
    let report = daemon.connect();
    let report = report.feed(&line, tracked()).unwrap();
    let report = report.run(|_| ControlFlow::Continue(())).unwrap();
    assert_eq!((report.end, report.tracked), (FeedEnd::Played, true));
}

#[test]
fn a_recording_of_a_stopped_daemon_goes_on_when_it_wakes() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let connection = daemon.connect();
    let mut recorder = daemon.place().record("run.mcap");
    freeze(&daemon, Duration::from_millis(2500));
    let before = wait_status(&connection, |_| true);
    wait_status(&connection, |status| status.cycles > before.cycles + 20);
    recorder.signal(Signal::INT);
    let reported = assert_output(&recorder.output(), 0, &["run.mcap"]);
    assert!(!reported.contains("the daemon ended"), "{reported}");
}

/// Like the first trial of a new user: only the robot is configured.
#[test]
fn a_simulated_robot_goes_on_after_misses_and_the_daemon_warns() {
    let mut daemon = Daemon::start("");
    let connection = daemon.connect();
    freeze(&daemon, Duration::from_secs(1));
    let status = wait_status(&connection, |status| status.misses_tolerated > 0);
    assert_eq!(status.mode, Mode::Holding.code());
    assert!(daemon.stop().success());
    let log = daemon.log();
    assert!(
        log.contains("the simulated robot continues; set cycle.miss_limit"),
        "{log}"
    );
}

#[test]
fn a_request_that_a_stopped_daemon_kept_waiting_is_carried_out_when_it_wakes() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let connection = daemon.connect();
    connection.prepare_requests().unwrap();
    let stale = || {
        let now_ns = monotonic_ns();
        let status = wait_status(&connection, |status| status.header.sent_ns > now_ns);
        status.outcomes[Outcome::Stale.code() as usize]
    };
    // If the machine sends the request seconds late, it has not waited for long.
    until_undisturbed("a request that waits", || {
        let before = stale();
        keep_waiting(&daemon, &connection);
        (stale() == before + 1).then_some(())
    });
}

/// Sends a request to a stopped daemon. The daemon wakes up after the longest wait of a request, and before
/// its client gives up.
fn keep_waiting(daemon: &Daemon, connection: &Connection) {
    daemon.signal(Signal::STOP);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            std::thread::sleep(Duration::from_secs(3));
            daemon.signal(Signal::CONT);
        });
        let answer = connection.request_within(RequestKind::Home, TIMEOUT);
        // A straight robot is at home at once.
        let mode = answer.unwrap().mode;
        assert!(
            [Mode::Homing, Mode::Holding]
                .map(Mode::code)
                .contains(&mode)
        );
    });
}
