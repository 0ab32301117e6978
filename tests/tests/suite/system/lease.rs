//! One client at a time feeds the reference.

use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use cdcr_client::{FeedError, FeedEvent, FeedOptions, RequestError, monotonic_ns};
use cdcr_shared_types::ReferencePoint;
use cdcr_shared_types::codes::{ChunkMode, EventKind, Interpolation, Outcome};
use cdcr_tests::{Daemon, STALL_TOLERANT, TIMEOUT, paper_line, wait_status};

/// The same point repeatedly, from `lead` after now, 0.3 s apart.
fn points(lead: Duration, count: u64) -> Vec<ReferencePoint> {
    let begin_ns = monotonic_ns() + lead.as_nanos() as u64;
    (0..count)
        .map(|k| ReferencePoint {
            time_ns: begin_ns + k * 300_000_000,
            position_m: [0.02, 0.0, 0.89],
            ..ReferencePoint::default()
        })
        .collect()
}

#[test]
fn two_clients_one_lease() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let (first, second) = (daemon.connect(), daemon.connect());
    let asked = Instant::now();
    let lease = first.acquire_lease_within(TIMEOUT).unwrap();
    let most = Duration::from_secs(60);
    let left = lease.left();
    assert!(left <= most && left + asked.elapsed() >= most, "{left:?}");
    match second.acquire_lease_within(TIMEOUT) {
        Err(RequestError::Refused {
            outcome: Outcome::LeaseHeld,
            ..
        }) => {}
        other => panic!("{other:?}"),
    }

    let mut telemetry = second.telemetry().unwrap();
    let send = |connection: &cdcr_client::Connection| {
        let feed = connection.reference_feed().unwrap();
        // The daemon finds a new writer at its next check; earlier messages wait for it.
        std::thread::sleep(Duration::from_millis(50));
        let points = points(TIMEOUT, 20);
        let header = feed
            .send(ChunkMode::Replace, Interpolation::Cubic, &points)
            .unwrap();
        (feed, header)
    };
    let (_feed, header) = send(&second);
    let outcome = telemetry
        .outcome_on(EventKind::Reference, &header, TIMEOUT)
        .unwrap();
    assert_eq!(outcome, Outcome::NoLease);
    let code = Outcome::NoLease.code() as usize;
    wait_status(&first, |status| status.outcomes[code] == 1);

    lease.renew().unwrap();
    let (_feed, header) = send(&first);
    let outcome = telemetry
        .outcome_on(EventKind::Reference, &header, TIMEOUT)
        .unwrap();
    assert_eq!(outcome, Outcome::Accepted);

    lease.release().unwrap();
    let lease = second.acquire_lease_within(TIMEOUT).unwrap();
    let status = wait_status(&first, |status| status.lease_holder == second.sender_id());
    assert_eq!(
        status.reference_points, 0,
        "the reference went with its lease"
    );
    drop(lease);
}

#[test]
fn a_feed_that_was_delayed_until_its_reference_was_over_names_the_lease_if_that_was_lost() {
    for (lease_ms, is_lost) in [(500, true), (60_000, false)] {
        let error = delayed(&Daemon::start(&format!(
            "[reference]\nlease_ms = {lease_ms}.0\n"
        )));
        let is_told = match error {
            FeedError::LeaseLost { .. } => is_lost,
            FeedError::TooLate { .. } => !is_lost,
            _ => false,
        };
        assert!(is_told, "{error}");
    }
}

/// Why a feed fails whose program stands still until its reference is over.
fn delayed(daemon: &Daemon) -> FeedError {
    let connection = daemon.connect();
    let line = paper_line(0.1);
    let options = FeedOptions {
        lead: Duration::from_millis(100),
        track: true,
        ..FeedOptions::default()
    };
    let ended = connection.feed(&line, options).unwrap().run(|event| {
        if matches!(event, FeedEvent::Scheduled { .. }) {
            std::thread::sleep(Duration::from_secs(1));
        }
        ControlFlow::Continue(())
    });
    ended.expect_err("nothing was tracked")
}
