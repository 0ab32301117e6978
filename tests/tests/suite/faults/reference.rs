//! Faults of the reference and its client.

use std::ops::RangeInclusive;
use std::os::unix::process::ExitStatusExt as _;

use cdcr_client::{Connection, Lease, ReferenceFeed, event_about, events, monotonic_ns};
use cdcr_controller::reference::ReferenceWindow;
use cdcr_shared_types::codes::{
    ChunkMode, EventKind, Interpolation, LeaseState, Mode, Outcome, Reason, RequestKind,
};
use cdcr_shared_types::limits::CHUNK_POINTS_MAX;
use cdcr_shared_types::{Header, ReferencePoint, Telemetry};
use cdcr_tests::{Daemon, Program, STALL_TOLERANT, TIMEOUT, text, until_undisturbed, wait_status};
use rustix::process::Signal;

use crate::faults::history::History;
use crate::faults::trail::{Trail, assert_ramps_to_rest, late_ns, rests, say};

/// Slow enough for a ramp of many cycles; the lease lasts through stalls.
const RAMP: &str = "[motion]\ndeceleration_rad_s2 = 2.0\n";
const LEASE_MS: u64 = 400;
/// Periods of 5 ms for which a cycle continues without new inputs.
pub(crate) const WINDOW_PERIODS: u64 = ReferenceWindow::TIMEOUT_NS / 5_000_000;

fn short_lease() -> Daemon {
    Daemon::start(&format!(
        "{RAMP}[cycle]\nmiss_limit = 1000000\n[reference]\nlease_ms = {LEASE_MS}.0\n"
    ))
}

/// A client that feeds a line to the side, with points 1 mm apart.
pub(crate) struct Feeding<'c> {
    pub(crate) lease: Lease<'c>,
    feed: ReferenceFeed,
    pub(crate) end_ns: u64,
}

/// Time from sending to the begin of the reference.
const LEAD_NS: u64 = 300_000_000;
/// Number of points of a full chunk.
pub(crate) const POINTS_MAX: u64 = CHUNK_POINTS_MAX as u64;

fn points(begin_ns: u64, count: u64, step_ms: u64) -> Vec<ReferencePoint> {
    (0..count)
        .map(|k| ReferencePoint {
            time_ns: begin_ns + k * step_ms * 1_000_000,
            position_m: [0.001 * k as f64, 0.0, 0.89],
            ..ReferencePoint::default()
        })
        .collect()
}

/// Sends `count` points, `step_ms` apart, and starts tracking.
pub(crate) fn track(connection: &Connection, count: u64, step_ms: u64) -> Feeding<'_> {
    let lease = connection.acquire_lease_within(TIMEOUT).unwrap();
    let feed = connection.reference_feed().unwrap();
    let end_ns = until_undisturbed("the reference comes in time", || {
        let points = points(monotonic_ns() + LEAD_NS, count, step_ms);
        feed.send(ChunkMode::Replace, Interpolation::Cubic, &points)
            .unwrap();
        // Tracking needs a reference, which the daemon gets when it has found the new writer.
        while monotonic_ns() < points[0].time_ns {
            if connection.request(RequestKind::Track).is_ok() {
                return Some(points.last().unwrap().time_ns);
            }
            lease.renew().unwrap();
        }
        None
    });
    Feeding {
        lease,
        feed,
        end_ns,
    }
}

/// Checks that the robot holds from the first release after the last point.
fn assert_ends_at(trail: &mut Trail, end_ns: u64) -> Telemetry {
    let (before, now) = trail.until("the end", |record| {
        record.mode == Mode::Holding.code() && record.reason == Reason::ReferenceEnded.code()
    });
    assert_eq!(before.mode, Mode::Tracking.code());
    assert!(before.release_ns <= end_ns);
    // Without inputs for longer than its window, a cycle has no reference left, either.
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
    // After a stall in which the last command ran out, the robot rests.
    until_undisturbed("the robot moves when its reference ends", || {
        let daemon = Daemon::start(&format!("{STALL_TOLERANT}{RAMP}"));
        let connection = daemon.connect();
        let mut trail = Trail::new(&connection);
        let feeding = track(&connection, 50, 10);
        let now = assert_ends_at(&mut trail, feeding.end_ns);
        let moves = now.previous_rate_rad_s.iter().any(|rate| *rate != 0.0);
        assert_ramps_to_rest(&mut trail, &now, || {});
        drop(feeding.lease);
        moves.then_some(())
    });
}

/// The event of a chunk in its record.
fn outcome_of(record: &Telemetry, header: &Header) -> Option<(Outcome, u64)> {
    let event = event_about(record, EventKind::Reference, header)?;
    Some((
        Outcome::try_from(event.outcome).unwrap(),
        event.evaluated_ns,
    ))
}

#[test]
fn points_that_come_too_late_are_refused_and_the_rest_is_followed() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let connection = daemon.connect();
    let mut trail = Trail::new(&connection);
    let mut refused = 0;
    until_undisturbed("the outcome comes before the reference ends", || {
        refuse_late_points(&connection, &mut trail, &mut refused)
    });
    let code = Outcome::InThePast.code() as usize;
    wait_status(&connection, |status| status.outcomes[code] == refused);
}

/// `None` when the reference ended before the cycle of the event. Counts the rejected chunks.
fn refuse_late_points(connection: &Connection, trail: &mut Trail, refused: &mut u64) -> Option<()> {
    let in_the_past = |record: &Telemetry| {
        let outcomes = events(record).iter().map(|event| event.outcome);
        outcomes
            .filter(|outcome| *outcome == Outcome::InThePast.code())
            .count() as u64
    };
    let feeding = track(connection, 80, 10);
    trail.until("tracking", |record| {
        *refused += in_the_past(record);
        record.mode == Mode::Tracking.code()
    });
    let late = points(monotonic_ns() - 2_000_000_000, 10, 10);
    let header = feeding
        .feed
        .send(ChunkMode::Append, Interpolation::Cubic, &late)
        .unwrap();
    let (mut outcome, mut is_held) = (None, false);
    let (_, now) = trail.until("the outcome", |record| {
        *refused += in_the_past(record);
        outcome = outcome_of(record, &header);
        is_held |= record.mode == Mode::Holding.code();
        outcome.is_some()
    });
    let (outcome, evaluated_ns) = outcome.unwrap();
    assert_eq!(outcome, Outcome::InThePast);
    let bound_ns = 2 * now.period_ns + trail.history().late_since_ns(evaluated_ns);
    let reported_ns = now.release_ns.saturating_sub(evaluated_ns);
    say(
        "reference late, evaluated before the release",
        reported_ns,
        bound_ns,
    );
    assert!(reported_ns <= bound_ns);
    if is_held && now.release_ns > feeding.end_ns {
        return None;
    }
    assert!(!is_held, "it left tracking before the end");
    assert_ends_at(trail, feeding.end_ns);
    Some(())
}

/// The newest renewal of the lease, according to the records.
#[derive(Default)]
struct Renewal {
    evaluated_ns: u64,
    gather: u64,
    gather_ns: u64,
}

impl Renewal {
    fn look(&mut self, record: &Telemetry) {
        for event in events(record) {
            let renews = event.kind == EventKind::Reference.code()
                || event.kind == EventKind::Request.code()
                    && event.detail == RequestKind::AcquireLease.code();
            if renews && event.outcome == Outcome::Accepted.code() {
                self.evaluated_ns = self.evaluated_ns.max(event.evaluated_ns);
                self.gather = self
                    .gather
                    .max(record.gather - u64::from(event.gathers_ago));
                self.gather_ns = self.evaluated_ns;
            }
        }
        // A request that was taken shortly before the release was checked later than its gather began.
        if record.gather == self.gather {
            self.gather_ns = record.gather_ns;
        }
    }

    /// Time at which the lease expires, seen at gather `gather`. Time in which the daemon did not receive
    /// messages does not count.
    fn expires_ns(&self, history: &History, gather: u64) -> RangeInclusive<u64> {
        let unheard_ns = history.unheard_ns(self.gather, self.gather_ns, gather);
        let ends_ns = |unheard_ns| self.evaluated_ns + LEASE_MS * 1_000_000 + unheard_ns;
        ends_ns(unheard_ns.start())..=ends_ns(unheard_ns.end())
    }
}

/// Checks that the first gather after the expiry ends the lease, and that the robot holds in the cycle after
/// that gather. `None` when tracking ended earlier for another reason: a stall of the machine, or a client
/// that returned its lease.
fn expires(trail: &mut Trail, renewal: &mut Renewal, what: &str) -> Option<()> {
    let (before, now) = trail.until("the end of the tracking", |record| {
        renewal.look(record);
        record.mode == Mode::Holding.code() && record.reason != Reason::Start.code()
    });
    let others = [
        Reason::InputsStale,
        Reason::ReferenceEnded,
        Reason::LeaseReleased,
    ];
    if others.map(Reason::code).contains(&now.reason) {
        return None;
    }
    assert_eq!(now.reason, Reason::LeaseExpired.code());
    assert_eq!(before.mode, Mode::Tracking.code());
    assert_eq!(before.lease_state, LeaseState::Held.code());
    assert_eq!(now.lease_state, LeaseState::Expired.code());
    let history = trail.history();
    let [ended_ns, held_ns] = [&now, &before]
        .map(|record| (record.gather_ns, renewal.expires_ns(history, record.gather)));
    assert!(ended_ns.0 >= *ended_ns.1.start(), "too early: {ended_ns:?}");
    assert!(held_ns.0 < *held_ns.1.end(), "too late: {held_ns:?}");
    // Between the two gathers lie one period and the lateness in the records.
    let bound_ns = now.release_ns - before.gather_ns;
    say(
        what,
        now.release_ns - renewal.evaluated_ns,
        ended_ns.1.end() - renewal.evaluated_ns + bound_ns,
    );
    assert_ramps_to_rest(trail, &now, || {});
    Some(())
}

#[test]
fn a_silent_holder_loses_the_lease() {
    let daemon = short_lease();
    let connection = daemon.connect();
    let mut trail = Trail::new(&connection);
    let mut renewal = Renewal::default();
    until_undisturbed("the lease ends the tracking", || {
        trail.until("at rest", |record| {
            renewal.look(record);
            record.mode == Mode::Holding.code() && rests(record)
        });
        let feeding = track(&connection, POINTS_MAX, 10);
        std::mem::forget(feeding.lease);
        trail.until("tracking", |record| {
            renewal.look(record);
            record.mode == Mode::Tracking.code()
        });
        expires(&mut trail, &mut renewal, "lease expired")
    });
}

/// A client process that feeds and starts tracking. `None` when it ended by itself: its reference was late,
/// or it lost its lease.
fn feeding_process(daemon: &Daemon, trail: &mut Trail, renewal: &mut Renewal) -> Option<Program> {
    let line = "cdcrctl ref line --track --duration 60s --velocity 0.005,0,-0.001";
    let mut program = daemon.place().start(line);
    let (mut tracked, mut is_gone) = (0, false);
    trail.until("tracking", |record| {
        renewal.look(record);
        tracked += u64::from(record.mode == Mode::Tracking.code());
        is_gone = !program.runs();
        is_gone || tracked > 80
    });
    (!is_gone).then_some(program)
}

#[test]
fn a_killed_client_loses_the_lease_to_the_next_client() {
    let daemon = short_lease();
    let connection = daemon.connect();
    let (mut trail, mut renewal) = (Trail::new(&connection), Renewal::default());
    until_undisturbed("a client is killed that feeds", || {
        let mut client = feeding_process(&daemon, &mut trail, &mut renewal)?;
        client.signal(Signal::KILL);
        // A client that ended earlier returned its lease.
        client.output().status.signal()?;
        expires(&mut trail, &mut renewal, "client killed")
    });
    connection.acquire_lease_within(TIMEOUT).unwrap();
}

#[test]
fn a_stopped_client_loses_the_lease_and_gets_an_error_when_it_continues() {
    let daemon = short_lease();
    let connection = daemon.connect();
    let (mut trail, mut renewal) = (Trail::new(&connection), Renewal::default());
    until_undisturbed("a client is stopped that feeds", || {
        let mut client = feeding_process(&daemon, &mut trail, &mut renewal)?;
        client.signal(Signal::STOP);
        let expired = expires(&mut trail, &mut renewal, "client stopped");
        client.signal(Signal::CONT);
        let output = client.output();
        assert_eq!(output.status.code(), Some(1), "{}", text(&output));
        expired?;
        assert!(text(&output).contains("lease expired"), "{}", text(&output));
        Some(())
    });
}
