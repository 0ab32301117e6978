//! The reference and who feeds it.

use cdcr_client::{Connection, Lease, ReferenceFeed, events, monotonic_ns};
use cdcr_controller::reference::ReferenceWindow;
use cdcr_shared_types::codes::{
    ChunkMode, EventKind, Interpolation, LeaseState, Mode, Outcome, Reason, RequestKind,
};
use cdcr_shared_types::{Header, ReferencePoint, Telemetry};
use cdcr_tests::{Daemon, PATIENT, Program, text, wait_status};
use rustix::process::Signal;

use crate::faults::trail::{Trail, assert_ramps_to_rest, is, late_ns, say};

/// Slow enough for a ramp of many cycles, and a lease that survives a machine that stalls.
const RAMP: &str = "[motion]\ndeceleration_rad_s2 = 2.0\n";
const LEASE_MS: u64 = 400;
/// Periods of 5 ms that a cycle goes on without new inputs.
const WINDOW_PERIODS: u64 = ReferenceWindow::PATIENCE_NS / 5_000_000;

fn short_lease() -> Daemon {
    Daemon::start(&format!(
        "{RAMP}[cycle]\nmiss_limit = 1000000\n[reference]\nlease_ms = {LEASE_MS}.0\n"
    ))
}

/// A client that feeds a line to the side, 0.1 m/s, 10 ms between points.
pub(crate) struct Feeding<'c> {
    pub(crate) lease: Lease<'c>,
    feed: ReferenceFeed,
    end_ns: u64,
}

fn points(begin_ns: u64, count: u64) -> Vec<ReferencePoint> {
    (0..count)
        .map(|k| ReferencePoint {
            time_ns: begin_ns + k * 10_000_000,
            position_m: [0.001 * k as f64, 0.0, 0.89],
            ..ReferencePoint::default()
        })
        .collect()
}

/// Sends `count` points and has them tracked.
pub(crate) fn track(connection: &Connection, count: u64) -> Feeding<'_> {
    let lease = connection.acquire_lease().unwrap();
    let feed = connection.reference_feed().unwrap();
    let points = points(monotonic_ns() + 300_000_000, count);
    feed.send(ChunkMode::Replace, Interpolation::Cubic, &points)
        .unwrap();
    // Until the daemon has found the new writer there is nothing to track.
    while connection.request(RequestKind::Track).is_err() {
        lease.renew().unwrap();
    }
    Feeding {
        lease,
        feed,
        end_ns: points.last().unwrap().time_ns,
    }
}

/// The first release after the last point holds.
fn assert_ends_at(trail: &mut Trail, end_ns: u64) -> Telemetry {
    let (before, now) = trail.until("the end", |record| {
        record.mode == Mode::Holding.code() && record.reason == Reason::ReferenceEnded.code()
    });
    assert_eq!(before.mode, Mode::Tracking.code());
    assert!(before.release_ns <= end_ns);
    // A cycle that has got no inputs for longer than the window reaches has no reference left, either.
    if now.cycle > now.window_first_cycle + WINDOW_PERIODS {
        println!("reference ended: before its end, no inputs came for {WINDOW_PERIODS} periods");
        return now;
    }
    assert!(end_ns < now.release_ns);
    let bound_ns = now.period_ns + late_ns(&now);
    say("reference ended", now.release_ns - end_ns, bound_ns);
    assert!(now.release_ns - end_ns <= bound_ns);
    now
}

#[test]
fn a_reference_that_ends_is_held_at_the_next_release() {
    let daemon = Daemon::start(&format!("{PATIENT}{RAMP}"));
    let connection = daemon.connect();
    let mut trail = Trail::new(&connection);
    let feeding = track(&connection, 50);
    let now = assert_ends_at(&mut trail, feeding.end_ns);
    assert!(now.previous_rate_rad_s.iter().any(|rate| *rate != 0.0));
    assert_ramps_to_rest(&mut trail, &now, || {});
    drop(feeding.lease);
}

/// The event that tells what became of a chunk, in its record.
fn verdict(record: &Telemetry, header: &Header) -> Option<(Outcome, u64)> {
    let event = events(record).iter().find(|event| {
        event.kind == EventKind::Reference.code()
            && event.sender_id == header.sender_id
            && event.sequence == header.sequence
    })?;
    Some((Outcome::try_from(event.outcome).unwrap(), event.judged_ns))
}

#[test]
fn points_that_come_too_late_are_refused_and_the_rest_is_followed() {
    let daemon = Daemon::start(PATIENT);
    let connection = daemon.connect();
    let mut trail = Trail::new(&connection);
    let feeding = track(&connection, 80);
    trail.until("tracking", is(Mode::Tracking));
    let late = points(monotonic_ns() - 50_000_000, 10);
    let header = feeding
        .feed
        .send(ChunkMode::Append, Interpolation::Cubic, &late)
        .unwrap();
    let mut judged = None;
    let (_, now) = trail.until("the verdict", |record| {
        judged = verdict(record, &header);
        judged.is_some()
    });
    let (outcome, judged_ns) = judged.unwrap();
    assert_eq!(outcome, Outcome::InThePast);
    // A gather that takes longer than its lead is used a cycle later.
    let bound_ns = 2 * now.period_ns + late_ns(&now);
    let told_ns = now.release_ns.saturating_sub(judged_ns);
    say(
        "reference late, judged before the release",
        told_ns,
        bound_ns,
    );
    assert!(told_ns <= bound_ns);
    assert_eq!(now.mode, Mode::Tracking.code());
    assert_ends_at(&mut trail, feeding.end_ns);
    let code = Outcome::InThePast.code() as usize;
    wait_status(&connection, |status| status.outcomes[code] == 1);
}

/// Remembers when the lease was last renewed, by what the records tell.
#[derive(Default)]
struct Renewals {
    last_ns: u64,
}

impl Renewals {
    fn look(&mut self, record: &Telemetry) {
        for event in events(record) {
            let renews = event.kind == EventKind::Reference.code()
                || event.kind == EventKind::Request.code()
                    && event.detail == RequestKind::AcquireLease.code();
            if renews && event.outcome == Outcome::Accepted.code() {
                self.last_ns = self.last_ns.max(event.judged_ns);
            }
        }
    }
}

/// The first gather after the lease ran out ends it, and the robot holds in the cycle after that gather.
fn assert_expires(trail: &mut Trail, renewals: &mut Renewals, what: &str) {
    let (before, now) = trail.until("the end of the lease", |record| {
        renewals.look(record);
        record.mode == Mode::Holding.code() && record.reason == Reason::LeaseExpired.code()
    });
    let expires_ns = renewals.last_ns + LEASE_MS * 1_000_000;
    assert_eq!(before.mode, Mode::Tracking.code());
    assert_eq!(before.lease_state, LeaseState::Held.code());
    assert_eq!(now.lease_state, LeaseState::Expired.code());
    assert!(before.gather_ns < expires_ns && expires_ns <= now.gather_ns);
    // Between the two gathers lies a period, and what the records say was late.
    let bound_ns = now.release_ns - before.gather_ns;
    say(
        what,
        now.release_ns - renewals.last_ns,
        LEASE_MS * 1_000_000 + bound_ns,
    );
    assert_ramps_to_rest(trail, &now, || {});
}

#[test]
fn a_silent_holder_loses_the_lease() {
    let daemon = short_lease();
    let connection = daemon.connect();
    let mut trail = Trail::new(&connection);
    let feeding = track(&connection, 128);
    let mut renewals = Renewals::default();
    assert_expires(&mut trail, &mut renewals, "lease expired");
    std::mem::forget(feeding.lease);
}

/// A client process that feeds and has the robot track.
fn feeding_process(daemon: &Daemon, trail: &mut Trail, renewals: &mut Renewals) -> Program {
    let mut command = daemon.place().command("cdcrctl");
    let arguments = ["ref", "line", "--track", "--duration", "15s"];
    let program = Program::start(
        command
            .args(arguments)
            .args(["--velocity", "0.02,0,-0.005"]),
    );
    let mut tracked = 0;
    trail.until("tracking", |record| {
        renewals.look(record);
        tracked += u64::from(record.mode == Mode::Tracking.code());
        tracked > 80
    });
    program
}

#[test]
fn a_killed_client_loses_the_lease_to_whoever_comes() {
    let daemon = short_lease();
    let connection = daemon.connect();
    let (mut trail, mut renewals) = (Trail::new(&connection), Renewals::default());
    let mut client = feeding_process(&daemon, &mut trail, &mut renewals);
    client.signal(Signal::KILL);
    client.output();
    assert_expires(&mut trail, &mut renewals, "client killed");
    connection.acquire_lease().unwrap();
}

#[test]
fn a_stopped_client_loses_the_lease_and_is_told_when_it_wakes() {
    let daemon = short_lease();
    let connection = daemon.connect();
    let (mut trail, mut renewals) = (Trail::new(&connection), Renewals::default());
    let mut client = feeding_process(&daemon, &mut trail, &mut renewals);
    client.signal(Signal::STOP);
    assert_expires(&mut trail, &mut renewals, "client stopped");
    client.signal(Signal::CONT);
    let output = client.output();
    assert_eq!(output.status.code(), Some(1), "{}", text(&output));
    assert!(text(&output).contains("lease expired"), "{}", text(&output));
}
