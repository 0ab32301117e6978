//! Bad input is rejected with a clear error, and the loop continues.

use cdcr_client::{Connection, ReferenceFeed, TelemetryStream, monotonic_ns};
use cdcr_shared_types::ReferencePoint;
use cdcr_shared_types::codes::{ChunkMode, EventKind, Interpolation, Outcome};
use cdcr_tests::{Daemon, PATIENT, TIMEOUT, wait_status};

fn point(offset_ms: i64, position_m: [f64; 3]) -> ReferencePoint {
    ReferencePoint {
        time_ns: monotonic_ns().saturating_add_signed(offset_ms * 1_000_000),
        position_m,
        ..ReferencePoint::default()
    }
}

struct Client<'c> {
    connection: &'c Connection,
    feed: ReferenceFeed,
    telemetry: TelemetryStream,
}

impl Client<'_> {
    fn verdict(&mut self, mode: ChunkMode, points: &[ReferencePoint]) -> Outcome {
        let lease = self.connection.acquire_lease_within(TIMEOUT).unwrap();
        let header = self.feed.send(mode, Interpolation::Cubic, points).unwrap();
        let verdict = self
            .telemetry
            .outcome_on(EventKind::Reference, &header, TIMEOUT);
        std::mem::forget(lease);
        verdict.unwrap()
    }
}

#[test]
fn bad_points_are_refused_with_the_reason_and_counted() {
    let daemon = Daemon::start(PATIENT);
    let connection = daemon.connect();
    let mut client = Client {
        connection: &connection,
        feed: connection.reference_feed().unwrap(),
        telemetry: connection.telemetry().unwrap(),
    };
    let good = [0.0, 0.0, 0.9];
    let replace = ChunkMode::Replace;
    let far = 10_000;
    assert_eq!(
        client.verdict(replace, &[point(far, [f64::NAN, 0.0, 0.0])]),
        Outcome::NotFinite
    );
    assert_eq!(
        client.verdict(replace, &[point(-100, good)]),
        Outcome::InThePast
    );
    assert_eq!(
        client.verdict(replace, &[point(far, [0.0, 0.7, 0.7])]),
        Outcome::OutOfReach
    );
    let same = point(far, good);
    assert_eq!(
        client.verdict(replace, &[same, same]),
        Outcome::TimeNotIncreasing
    );
    // Nothing was accepted yet, so there is nothing to append to.
    assert_eq!(
        client.verdict(ChunkMode::Append, &[point(far, good)]),
        Outcome::SequenceGap
    );
    assert_eq!(
        client.verdict(replace, &[point(far, good)]),
        Outcome::Accepted
    );
    let next = point(2 * far, good);
    assert_eq!(
        client.verdict(ChunkMode::Append, &[next]),
        Outcome::Accepted
    );
    let tight = ReferencePoint {
        time_ns: next.time_ns + 999,
        ..next
    };
    assert_eq!(
        client.verdict(ChunkMode::Append, &[tight]),
        Outcome::TimeNotIncreasing
    );

    let status = wait_status(&connection, |status| {
        status.outcomes[Outcome::SequenceGap.code() as usize] == 1
    });
    for outcome in [Outcome::NotFinite, Outcome::InThePast, Outcome::OutOfReach] {
        assert_eq!(status.outcomes[outcome.code() as usize], 1, "{outcome}");
    }
    let before = status.cycles;
    wait_status(&connection, |status| status.cycles > before + 20);
}
