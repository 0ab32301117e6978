//! Feed, track, hold, stop, reset, home: reactions of the daemon to requests.

use std::ops::ControlFlow;

use cdcr_client::{FeedEnd, FeedEvent, RequestError, Spiral};
use cdcr_shared_types::codes::{Mode, Outcome, Reason, ReferenceState, RequestKind, SolverStatus};
use cdcr_shared_types::{SolverSettings, Telemetry};
use cdcr_tests::record::largest;
use cdcr_tests::{
    Daemon, PATIENT, TIMEOUT, ask_for, paper_line, refused, track, tracked, wait_mode, wait_record,
    wait_status,
};

use super::error_max_m;

/// `motion.home_tolerance_rad` of the default configuration.
const HOME_TOLERANCE_RAD: f64 = 0.01;

fn is_at_rest(record: &Telemetry) -> bool {
    largest(&record.command.bend_rate_rad_s) == 0.0
}

#[test]
fn feed_track_hold_stop_reset() {
    // Ideal, because the measured position at rest is compared to the bit.
    let daemon = Daemon::ideal(PATIENT);
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

#[test]
fn tracking_follows_and_ends_with_the_reference() {
    let daemon = Daemon::start(PATIENT);
    let connection = daemon.connect();
    let records = track(&connection, &paper_line(0.5));
    assert!(records.len() > 10, "{} cycles were solved", records.len());
    for record in &records {
        assert_ne!(record.report.status, SolverStatus::Idle.code());
        assert!(record.report.cost <= record.report.warm_cost);
    }
    let cycles = records.iter().map(|record| {
        let lost_ns = record.elapsed_ns.saturating_sub(record.period_ns);
        (lost_ns as f64 * 1e-9, record.period_ns as f64 * 1e-9)
    });
    let error_max_m = error_max_m(1e-3, cycles);
    let last_error_m = records.last().unwrap().position_error_m;
    assert!(
        last_error_m < error_max_m,
        "the tip is {last_error_m} m from the end of the line, {error_max_m} m are accounted for"
    );
    let status = wait_status(&connection, |status| status.mode == Mode::Holding.code());
    assert_eq!(status.reason, Reason::ReferenceEnded.code());
}

#[test]
fn home_moves_to_the_straight_robot() {
    let bent = "[link]\ninitial_bend_rad = [[0.1, 0.0], [0.0, -0.05], [0.02, 0.02]]\n";
    let slow = "[motion]\nhome_rate_rad_s = 1.0\n";
    let configuration = format!("{PATIENT}{bent}{slow}");
    // Ideal: without noise, straight is exactly straight.
    for (daemon, straight_rad) in [
        (Daemon::start(&configuration), HOME_TOLERANCE_RAD),
        (Daemon::ideal(&configuration), 1e-6),
    ] {
        let connection = daemon.connect();
        let mut telemetry = connection.telemetry().unwrap();
        ask_for(&connection, RequestKind::Home);
        let record = wait_record(&mut telemetry, |r| r.reason == Reason::HomeReached.code());
        let bends = record.present_rad;
        assert!(largest(&bends) < straight_rad, "{bends:?}");
    }
}

#[test]
fn settings_change_between_two_cycles_and_bad_ones_are_refused() {
    let daemon = Daemon::start(PATIENT);
    let connection = daemon.connect();
    let before = connection.status(TIMEOUT).unwrap().settings;
    let wanted = SolverSettings {
        swarm_size: 12,
        horizon_steps: 5,
        seed: 42,
        ..before
    };
    connection.change_settings(wanted).unwrap();
    let status = wait_status(&connection, |status| status.settings == wanted);
    assert_eq!(status.settings.control_blocks, before.control_blocks);
    let too_large = SolverSettings {
        swarm_size: 100_000,
        ..before
    };
    // Nearer to obstacles than the configuration allows.
    let too_near = SolverSettings {
        safe_distance_m: before.safe_distance_m / 2.0,
        ..before
    };
    for bad in [too_large, too_near] {
        match connection.change_settings(bad) {
            Err(RequestError::Refused {
                outcome: Outcome::OutOfRange,
                ..
            }) => {}
            other => panic!("{other:?}"),
        }
    }
    assert_eq!(connection.status(TIMEOUT).unwrap().settings, wanted);
}
