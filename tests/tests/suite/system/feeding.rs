//! Causes of an early end of a feed, and the effect on the lease.

use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use cdcr_client::{Connection, FeedEnd, FeedError, FeedEvent, FeedOptions, FeedReport, Line};
use cdcr_shared_types::codes::{LeaseState, Outcome};
use cdcr_tests::{Daemon, STALL_TOLERANT, paper_line, tracked, wait_status};

fn feed(connection: &Connection, line: &Line, track: bool) -> Result<FeedReport, FeedError> {
    let options = FeedOptions { track, ..tracked() };
    connection
        .feed(line, options)?
        .run(|_| ControlFlow::Continue(()))
}

#[test]
fn a_refused_chunk_ends_the_feed_with_the_reason_and_the_point() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let connection = daemon.connect();
    let reachable = paper_line(0.3);
    let beyond = Line {
        start_m: [0.0, 0.0, 5.0],
        ..reachable
    };
    let error = feed(&connection, &beyond, true).expect_err("5 m are out of reach");
    assert!(
        matches!(
            error,
            FeedError::Refused {
                outcome: Outcome::OutOfReach,
                point: 0,
                ..
            }
        ),
        "{error:?}"
    );
    assert!(
        error.to_string().contains("outside the reachable ball"),
        "{error}"
    );

    // 0.85 m upwards at 0.1 m/s: it leaves 0.9 m at 0.5 s, slightly after point 100.
    let leaving = Line {
        start_m: [0.0, 0.0, 0.85],
        velocity_m_s: [0.0, 0.0, 0.1],
        duration_s: 1.0,
        ..reachable
    };
    match feed(&connection, &leaving, false) {
        Err(FeedError::Refused { point, time_s, .. }) => {
            assert!((100..=102).contains(&point), "point {point}");
            assert!((time_s - 0.005 * point as f64).abs() < 1e-9, "{time_s} s");
        }
        other => panic!("{other:?}"),
    }

    // The lease was returned: another client feeds.
    wait_status(&connection, |status| status.lease_holder == 0);
    let report = feed(&daemon.connect(), &reachable, true).unwrap();
    assert_eq!(
        (report.end, report.points, report.tracked),
        (FeedEnd::Played, 61, true)
    );
}

#[test]
fn a_short_lease_is_renewed_in_time() {
    for lease in [20, 500].map(Duration::from_millis) {
        renewed_in_time(lease);
    }
}

/// Feeds with this lease. It may expire only if the machine delayed feeder or daemon for a large part of it.
fn renewed_in_time(lease: Duration) {
    let daemon = Daemon::start(&format!(
        "[cycle]\nmiss_limit = 1000000\n[reference]\nlease_ms = {}.0\n",
        lease.as_millis()
    ));
    let connection = daemon.connect();
    let line = paper_line(0.5);
    // The chunks renew the lease, too: with one chunk up to the end, only the renewals do.
    let options = FeedOptions {
        lead: Duration::from_millis(500),
        ahead: Duration::from_secs(10),
        ..FeedOptions::default()
    };
    let mut telemetry = connection.telemetry().unwrap();
    let mut last = Instant::now();
    let mut held_up = Duration::ZERO;
    let end = connection.feed(&line, options).and_then(|feeder| {
        feeder.run(|event| {
            if let FeedEvent::Progress(_) = event {
                held_up = held_up.max(last.elapsed());
                last = Instant::now();
            }
            ControlFlow::Continue(())
        })
    });
    // The turn that lost it.
    held_up = held_up.max(last.elapsed());
    let mut expired = 0;
    while let Some(record) = telemetry.try_next().unwrap() {
        expired += u32::from(record.lease_state == LeaseState::Expired.code());
        let late_ns =
            record.start_ns - record.due_ns + record.elapsed_ns.saturating_sub(record.period_ns);
        held_up = held_up.max(Duration::from_nanos(late_ns));
    }
    assert!(
        (end.is_ok() && expired == 0) || held_up > lease / 2,
        "{lease:?}: {end:?}, expired in {expired} cycles, held up for {held_up:?}"
    );
}
