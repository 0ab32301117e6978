//! Feed, track, hold, stop, reset: reactions of the daemon to requests.

use std::ops::ControlFlow;

use cdcr_client::{FeedEnd, FeedEvent, Spiral};
use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::{Mode, Outcome, Reason, ReferenceState, RequestKind};
use cdcr_tests::record::largest;
use cdcr_tests::{Daemon, STALL_TOLERANT, ask_for, refused, tracked, wait_mode, wait_record};

fn is_at_rest(record: &Telemetry) -> bool {
    largest(&record.command.bend_rate_rad_s) == 0.0
}

#[test]
fn feed_track_hold_stop_reset() {
    // Ideal, because the measured position at rest is compared to the bit.
    let daemon = Daemon::ideal(STALL_TOLERANT);
    let connection = daemon.connect();
    let mut telemetry = connection.telemetry().unwrap();
    assert_eq!(refused(&connection, RequestKind::Track), Outcome::NoLease);

    let spiral = Spiral::for_sections(&[0.3; 3]);
    let mut cycles = 0;
    let report = connection
        .feed(&spiral, tracked())
        .unwrap()
        .run(|event| {
            if let FeedEvent::Record(record) = event {
                let inside = record.reference.state == ReferenceState::Inside.code();
                cycles += u32::from(inside && record.mode == Mode::Tracking.code());
            }
            if cycles < 50 {
                ControlFlow::Continue(())
            } else {
                ControlFlow::Break(())
            }
        })
        .unwrap();
    assert_eq!(report.end, FeedEnd::Interrupted);
    // The feeder returned its lease: the robot holds.
    wait_mode(&mut telemetry, Mode::Tracking);
    let record = wait_record(&mut telemetry, |r| {
        r.mode == Mode::Holding.code() && is_at_rest(r)
    });

    ask_for(&connection, RequestKind::Stop);
    assert_eq!(
        wait_mode(&mut telemetry, Mode::Stopped).reason,
        Reason::Request.code()
    );
    for kind in [RequestKind::Track, RequestKind::Hold, RequestKind::Home] {
        assert_eq!(refused(&connection, kind), Outcome::WrongMode);
    }
    ask_for(&connection, RequestKind::Reset);
    let after = wait_record(&mut telemetry, |r| {
        r.cycle > record.cycle && r.mode == Mode::Holding.code()
    });
    assert_eq!(
        after.bend_rad, record.bend_rad,
        "a robot at rest does not move"
    );
}
