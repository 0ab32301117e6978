//! The daemon is killed at any time and restarted: it works at once, and its remaining clients find it by
//! themselves.

mod home;

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::process::Stdio;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use cdcr_client::{
    Connection, FeedEnd, FeedError, FeedEvent, Line, LinkError, ObstacleSender, RequestError,
    Requester, StopError, TelemetryStream, monotonic_ns,
};
use cdcr_shared_types::Measurement;
use cdcr_shared_types::codes::{EventKind, Interface, MeasurementKind, Mode, Outcome, RequestKind};
use cdcr_tests::load::connect;
use cdcr_tests::{
    EndWhenDropped, Place, ROBOT, Running, STALL_TOLERANT, TIMEOUT, ask_for, ball, paper_line,
    tracked, wait_record, wait_status, wait_until,
};
use rustix::process::Signal;

use crate::chaos::dice::Dice;

/// Kills of a daemon that holds; others are killed during their start.
const KILLS: usize = 50;
/// Number of kills between two starts of a daemon at a place where none was ever killed.
const BESIDE_EVERY: usize = 5;
/// Upper bound for the median of the starts after a kill, as a multiple of that of the other starts, on the
/// same machine.
const RETURN_TIMES_MAX: u32 = 2;
/// A start that takes this multiple of the usual time was blocked.
const SLOW_TIMES: u32 = 15;

/// Adds the log of the newest daemon to the report of a failing test.
struct LogOfFailure<'a>(&'a Place);

impl Drop for LogOfFailure<'_> {
    fn drop(&mut self) {
        if thread::panicking() {
            let log = std::fs::read_to_string(log_of(self.0)).unwrap_or_default();
            println!("log of cdcrd:\n{log}");
        }
    }
}

fn log_of(place: &Place) -> PathBuf {
    place.folder().join("cdcrd.log")
}

/// Starts a daemon, which is killed and reaped when dropped.
fn begin(place: &Place) -> Running {
    let config = place.folder().join("robot.toml");
    let mut command = place.command("cdcrd");
    // With a driver, too, on machines without real time.
    command.env("CDCR_REALTIME_MODE", "prefer");
    command.args(["run", "--config"]).arg(config);
    let log = std::fs::File::create(log_of(place)).expect("the folder is writable");
    Running::start(command.stdout(Stdio::null()).stderr(log))
}

/// Ends a daemon like a service manager.
fn end(mut daemon: Running) {
    daemon.signal(Signal::TERM);
    let status = daemon.wait(String::new);
    assert!(status.success(), "{status}");
}

/// Starts the next daemon of a place, and waits until its client sees that it holds. Returns the time until
/// then.
fn start_to_holding(place: &Place, old: &mut Old<'_>) -> (Running, Duration) {
    let begin_ns = monotonic_ns();
    let daemon = begin(place);
    old.wait_mode(Mode::Holding, begin_ns);
    (daemon, Duration::from_nanos(monotonic_ns() - begin_ns))
}

fn place(configuration: &str) -> Place {
    let place = Place::new();
    place.write("robot.toml", configuration);
    place
}

/// A client that remains connected across all restarts of the daemon.
struct Old<'c> {
    connection: &'c Connection,
    telemetry: TelemetryStream,
    obstacles: ObstacleSender,
    /// Identity of the last awaited daemon.
    daemon: u64,
}

impl<'c> Old<'c> {
    fn new(connection: &'c Connection) -> Self {
        Self {
            connection,
            telemetry: connection.telemetry().unwrap(),
            obstacles: connection.obstacle_sender().unwrap(),
            daemon: 0,
        }
    }

    /// Waits until a daemon that began later than `begin_ns` is in `mode`. The queue may still contain
    /// messages of an earlier one.
    fn wait_mode(&mut self, mode: Mode, begin_ns: u64) {
        let record = wait_record(&mut self.telemetry, |record| {
            record.header.sent_ns > begin_ns && record.mode == mode.code()
        });
        self.daemon = record.header.sender_id;
    }

    /// Checks that all functions of a client work with the new daemon of this process.
    fn use_everything(&mut self, process: u32) {
        let answer = ask_for(self.connection, RequestKind::Hold);
        assert_eq!(answer.header.sender_id, self.daemon);
        wait_status(self.connection, |status| status.process_id == process);
        let far = ball(1, [5.0, 0.0, 0.0]);
        let sent = self.obstacles.upsert(&[far]).unwrap();
        let event = self
            .telemetry
            .event_on(EventKind::Obstacles, &sent, TIMEOUT)
            .unwrap();
        assert_eq!(event.outcome, Outcome::Accepted.code());
        assert_eq!(event.detail, 1, "a new daemon begins without obstacles");
    }
}

/// A second old client, always in the middle of a request when the daemon is killed. Counts its answers.
fn keep_asking(connection: &Connection, over: &AtomicBool, answered: &AtomicU64) {
    while !over.load(Ordering::Relaxed) {
        let mut telemetry = connection.telemetry().unwrap();
        match connection.request_within(RequestKind::Hold, Duration::from_secs(1)) {
            Ok(_) => drop(answered.fetch_add(1, Ordering::Relaxed)),
            // Rejected before the first cycle, unanswered without a daemon.
            Err(RequestError::Refused { .. } | RequestError::Timeout { .. }) => {}
            Err(error) => panic!("{error}"),
        }
        telemetry.try_next().unwrap();
    }
}

#[test]
fn fifty_kills_at_any_moment() {
    let place = place(STALL_TOLERANT);
    let _log = LogOfFailure(&place);
    let mut dice = Dice::new(1);
    let mut daemon = begin(&place);
    let connection = connect(&place);
    let mut old = Old::new(&connection);
    old.wait_mode(Mode::Holding, 0);
    let unharmed = self::place(STALL_TOLERANT);
    let mut beside = begin(&unharmed);
    let beside_connection = connect(&unharmed);
    let mut beside_old = Old::new(&beside_connection);
    beside_old.wait_mode(Mode::Holding, 0);
    let (is_over, answered) = (AtomicBool::new(false), AtomicU64::new(0));
    let answers = || answered.load(Ordering::Relaxed);
    let (mut returns, mut starts) = (Vec::new(), Vec::new());
    thread::scope(|scope| {
        scope.spawn(|| keep_asking(&connect(&place), &is_over, &answered));
        let _over = EndWhenDropped(&is_over);
        for kill in 0..KILLS {
            // The busy client still works, too: each daemon answers it.
            let before = answers();
            wait_until("an answer to the busy client", || answers() > before);
            thread::sleep(dice.duration_ms(0, 100));
            drop(daemon);
            if kill % 2 == 0 {
                let starting = begin(&place);
                thread::sleep(dice.duration_ms(0, 60));
                drop(starting);
            }
            let took;
            (daemon, took) = start_to_holding(&place, &mut old);
            returns.push(took);
            old.use_everything(daemon.id());
            if kill % BESIDE_EVERY == 0 {
                end(beside);
                let took;
                (beside, took) = start_to_holding(&unharmed, &mut beside_old);
                starts.push(took);
            }
        }
    });
    let [median, usual] = [&mut returns, &mut starts].map(|times| {
        times.sort_unstable();
        times[times.len() / 2]
    });
    let longest = returns[KILLS - 1];
    println!(
        "start to holding, {KILLS} times: median {median:.1?}, longest {longest:.1?}; where none was killed {usual:.1?}"
    );
    assert!(median < RETURN_TIMES_MAX * usual, "{returns:?}, {starts:?}");
    // The machine may delay a few; files of a killed daemon would delay every third one.
    let slow = returns.iter().filter(|took| **took > SLOW_TIMES * usual);
    assert!(slow.count() <= KILLS / 10, "{returns:?}, {starts:?}");
}

/// Slow starts, longer than a feeder waits, that a bad machine may cause.
const SLOW_STARTS_MAX: usize = 10;

#[test]
fn a_feeder_gets_an_error_and_feeds_again_on_the_same_connection() {
    let is_seen = (0..SLOW_STARTS_MAX).any(|_| sees_the_restart_and_feeds_again());
    assert!(is_seen, "every start of a daemon took more than a second");
}

/// False if the start took so long that the feeder detected silence.
fn sees_the_restart_and_feeds_again() -> bool {
    let place = place(STALL_TOLERANT);
    let mut daemon = Some(begin(&place));
    let connection = connect(&place);
    let line = paper_line(0.3);
    let long = Line {
        duration_s: 120.0,
        velocity_m_s: [0.001, 0.0, -0.001],
        ..line
    };
    let options = tracked();
    let mut killed = None;
    let fed = connection.feed(&long, options).unwrap().run(|event| {
        if let FeedEvent::Progress(progress) = event
            && progress.tracking
            && killed.is_none()
        {
            killed = Some(Instant::now());
            drop(daemon.take());
            daemon = Some(begin(&place));
        }
        ControlFlow::Continue(())
    });
    let error = fed.expect_err("its lease died with the daemon");
    let is_reported = matches!(error, FeedError::Restarted { .. });
    if is_reported {
        assert!(
            error.to_string().contains("Feed the reference again"),
            "{error}"
        );
    } else {
        // On a bad machine, a long start is detected as silence before the new daemon is.
        let silence = killed.unwrap().elapsed();
        let is_silence = matches!(error, FeedError::Link(LinkError::Silent { .. }));
        assert!(is_silence && silence > Duration::from_secs(1), "{error:?}");
    }

    // Rejected until the new daemon has a robot.
    let connection_lives = || connection.request(RequestKind::Hold).is_ok();
    wait_until("the new daemon holds", connection_lives);
    let feeder = connection.feed(&line, options).unwrap();
    let report = feeder.run(|_| ControlFlow::Continue(())).unwrap();
    assert_eq!((report.end, report.tracked), (FeedEnd::Played, true));
    assert_eq!(report.lost_records, 0);
    is_reported
}

#[test]
fn a_lease_ends_with_its_daemon_and_an_old_one_does_not_take_a_new_one_along() {
    let place = place(STALL_TOLERANT);
    let daemon = begin(&place);
    let connection = connect(&place);
    let first = connection.acquire_lease_within(TIMEOUT).unwrap();
    first.renew().unwrap();
    drop(daemon);
    let _daemon = begin(&place);
    // The first answer of the new daemon.
    wait_until("an answer", || {
        !matches!(first.renew(), Err(RequestError::Timeout { .. }))
    });
    wait_status(&connection, |status| status.lease_holder == 0);
    let error = first.renew().expect_err("another daemon");
    assert!(matches!(error, RequestError::Restarted), "{error:?}");

    let second = connection.acquire_lease_within(TIMEOUT).unwrap();
    drop(first);
    second.renew().unwrap();
    let other = connect(&place);
    let refused = other.acquire_lease_within(TIMEOUT).expect_err("it is held");
    let held = Outcome::LeaseHeld;
    assert!(
        matches!(refused, RequestError::Refused { outcome, .. } if outcome == held),
        "{refused:?}"
    );
    drop(second);
    other.acquire_lease_within(TIMEOUT).unwrap();
}

#[test]
fn a_stop_reaches_the_next_daemon_or_is_reported_as_lost() {
    let place = place(STALL_TOLERANT);
    let daemon = begin(&place);
    let connection = connect(&place);
    let mut old = Old::new(&connection);
    old.wait_mode(Mode::Holding, 0);
    drop(daemon);
    let short = Duration::from_millis(200);
    let error = connection.request_within(RequestKind::Stop, short);
    let error = error.expect_err("nobody is there");
    assert!(matches!(error, RequestError::Timeout { .. }), "{error:?}");

    let begin_ns = monotonic_ns();
    thread::scope(|scope| {
        let next = scope.spawn(|| {
            thread::sleep(short);
            begin(&place)
        });
        let answer = ask_for(&connection, RequestKind::Stop);
        assert_eq!(answer.mode, Mode::Stopped.code());
        old.wait_mode(Mode::Stopped, begin_ns);
        next.join().unwrap()
    });
}

#[test]
fn a_stop_that_comes_while_no_daemon_runs_stops_the_one_that_is_just_started_again() {
    let place = place(STALL_TOLERANT);
    drop(begin(&place));
    let next = thread::scope(|scope| {
        let next = scope.spawn(|| {
            thread::sleep(Duration::from_millis(200));
            begin(&place)
        });
        let stopped = Requester::stop(place.location(), ROBOT);
        let is_sent = matches!(stopped, Ok(_) | Err(StopError::Unconfirmed { .. }));
        assert!(is_sent, "{stopped:?}");
        next.join().unwrap()
    });
    wait_status(&connect(&place), |status| {
        status.mode == Mode::Stopped.code()
    });
    drop(next);
}

/// Measures a robot whose first section is bent by `bend_rad` every 2 ms; `commanded_by` is the daemon of the
/// newest command. Returns how often the driver detected another daemon.
fn drive(
    connection: &Connection,
    bend_rad: f64,
    commanded_by: &AtomicU64,
    over: &AtomicBool,
) -> usize {
    let mut bends = [0.0; 12];
    bends[0] = bend_rad;
    let mut others = 0;
    let mut driver = connection.driver(Interface::Velocity).unwrap();
    while !over.load(Ordering::Relaxed) {
        let measured = Measurement {
            bend_rad: bends,
            kind: MeasurementKind::Configuration.code(),
            sections: 3,
            measured_ns: monotonic_ns(),
            ..Measurement::default()
        };
        driver.send(measured).unwrap();
        let update = driver.update().unwrap();
        if let Some(command) = update.command {
            commanded_by.store(command.header.sender_id, Ordering::Relaxed);
        }
        others += usize::from(update.new_daemon.is_some());
        thread::sleep(Duration::from_millis(2));
    }
    others
}

#[test]
fn a_driver_serves_every_daemon() {
    let link = "[link]\nkind = \"driver\"\nmeasurement_timeout_ms = 10000.0\n";
    let place = place(&format!("{STALL_TOLERANT}{link}"));
    let mut daemon = Some(begin(&place));
    let connection = connect(&place);
    let mut old = Old::new(&connection);
    let (is_over, commanded_by) = (AtomicBool::new(false), AtomicU64::new(0));
    thread::scope(|scope| {
        let over = EndWhenDropped(&is_over);
        let driver = scope.spawn(|| drive(&connect(&place), 0.0, &commanded_by, &is_over));
        let mut begin_ns = 0;
        for _ in 0..4 {
            old.wait_mode(Mode::Holding, begin_ns);
            wait_until("a command of this daemon", || {
                commanded_by.load(Ordering::Relaxed) == old.daemon
            });
            drop(daemon.take());
            begin_ns = monotonic_ns();
            daemon = Some(begin(&place));
        }
        drop(over);
        // The fifth daemon may not have sent a command yet.
        let others = driver.join().unwrap();
        assert!((3..=4).contains(&others), "{others} other daemons");
    });
}

#[test]
fn kills_in_the_middle_of_the_start_leave_nothing_that_hinders_the_next_one() {
    let place = place(STALL_TOLERANT);
    let _log = LogOfFailure(&place);
    let mut dice = Dice::new(2);
    let mut starts = Vec::new();
    for _ in 0..5 {
        // No other process keeps the services open: each of these creates them.
        for _ in 0..20 {
            let starting = begin(&place);
            thread::sleep(dice.duration_ms(0, 60));
            drop(starting);
        }
        let begin_ns = monotonic_ns();
        let _daemon = begin(&place);
        let connection = connect(&place);
        Old::new(&connection).wait_mode(Mode::Holding, begin_ns);
        starts.push(Duration::from_nanos(monotonic_ns() - begin_ns));
    }
    println!("start to holding after 20 broken starts: {starts:.1?}");
}
