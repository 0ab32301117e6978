//! What bad input gets: a clear refusal, and the loop goes on.

use cdcr_client::{Connection, ReferenceFeed, TelemetryStream, monotonic_ns};
use cdcr_shared_types::ReferencePoint;
use cdcr_shared_types::codes::{ChunkMode, EventKind, Interpolation, Outcome};
use cdcr_tests::{Daemon, PATIENT, Place, TIMEOUT, wait_status};

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
        let lease = self.connection.acquire_lease().unwrap();
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

#[test]
fn a_bad_configuration_is_named_by_file_line_key_and_range() {
    let place = Place::new();
    let cases = [
        (
            "[cycle]\nperiod_ms = 0.01\n",
            ["line 2", "cycle.period_ms", "0.1 to 100"],
        ),
        ("[cycle]\n\nperiod = 5\n", ["line 3", "period", "period_ms"]),
        (
            "[controller]\nsolver = \"magic\"\n",
            ["line 2", "magic", "kpso-refined"],
        ),
        ("[robot]\nname = 7\n", ["line 2", "7", "string"]),
    ];
    for (text, expected) in cases {
        place.write("bad.toml", text);
        for (command, status) in [("check", 78), ("run", 78)] {
            let line = format!("cdcrd {command} --config bad.toml");
            let printed = place.says(&line, status, &expected);
            assert!(printed.contains("bad.toml"), "{printed}");
        }
    }
    let parts = ["/no/such.toml", "config default"];
    place.says("cdcrd check --config /no/such.toml", 78, &parts);
}

#[test]
fn the_default_configuration_checks() {
    let place = Place::new();
    let text = place.says("cdcrd config default", 0, &[]);
    place.write("default.toml", &text);
    place.says("cdcrd check --config default.toml", 0, &["3 sections"]);
}

#[test]
fn a_bad_reference_file_is_named_by_line() {
    let daemon = Daemon::start(PATIENT);
    let cases = [
        ("t_s,x_m,y_m,z_m\n0,0,0,0.9\n0.1,nan,0,0.9\n", "3"),
        (
            "t_s,x_m,y_m,z_m\n0,0,0,0.9\n0.1,0,0,0.9\n0.1,0,0,0.9\n",
            "4",
        ),
        ("t_s,x_m,y_m\n0,0,0\n", "z_m"),
    ];
    for (text, part) in cases {
        daemon.place().write("path.csv", text);
        daemon
            .place()
            .says("cdcrctl ref file path.csv", 1, &["path.csv", part]);
    }
}
