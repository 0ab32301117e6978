//! Cycles that are recomputed from a recording: `cdcrctl replay --verify` and `--with`.

use std::fs;

use cdcr_shared_types::codes::{Mode, RequestKind};
use cdcr_tests::{Daemon, STALL_TOLERANT, TIMEOUT, assert_output, refused, text, track, wait_mode};
use rustix::process::Signal;
use serde_json::Value;

use super::recorded::Recorded;
use super::{curve, know_an_obstacle, rewrite, tracked_curve};

/// Modes change, requests are rejected, obstacles appear, solves exceed their budget: every cycle can be
/// recomputed from the recording alone.
#[test]
fn every_cycle_of_a_recording_is_computed_again() {
    let budget =
        "[cycle]\nmiss_limit = 1000000\nbudget_ms = 0.02\n[reference]\nlease_ms = 60000.0\n";
    let mut run = Recorded::start(budget);
    let connection = run.daemon.connect();
    let _sender = know_an_obstacle(&connection);
    track(&connection, &curve());
    // Rejected: no client feeds.
    refused(&connection, RequestKind::Track);
    let mut telemetry = connection.telemetry().unwrap();
    for (request, mode) in [
        (RequestKind::Home, Mode::Homing),
        (RequestKind::Stop, Mode::Stopped),
        (RequestKind::Reset, Mode::Holding),
    ] {
        connection.request_within(request, TIMEOUT).unwrap();
        wait_mode(&mut telemetry, mode);
    }
    let settings = connection.settings().unwrap();
    let changed = cdcr_shared_types::SolverSettings {
        horizon_steps: settings.horizon_steps + 1,
        ..settings
    };
    connection.change_settings(changed).unwrap();
    track(&connection, &curve());
    run.end();
    let verified = run.daemon.place().json("replay --verify run.mcap");
    assert_eq!(verified["cycles"], verified["reproduced"], "{verified}");
    assert_eq!(verified["first_difference"], Value::Null);
    assert!(verified["solved"].as_u64().unwrap() > 300, "{verified}");
    let info = run.info();
    assert_eq!(
        verified["cycles"],
        info["channels"]["telemetry"]["messages"]
    );
    for mode in ["tracking", "holding", "homing", "stopped"] {
        assert!(info["modes"][mode].as_u64().unwrap() > 0, "{info}");
    }
}

#[test]
fn cycles_of_a_reference_from_before_the_recording_are_counted_apart() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let connection = daemon.connect();
    let mut run = std::thread::scope(|scope| {
        let feed = scope.spawn(|| track(&daemon.connect(), &curve()));
        let mut telemetry = connection.telemetry().unwrap();
        wait_mode(&mut telemetry, Mode::Tracking);
        let recorder = daemon.place().record("run.mcap");
        feed.join().unwrap();
        recorder
    });
    drop(connection);
    run.signal(Signal::INT);
    assert_output(&run.output(), 0, &["run.mcap"]);
    let reported = daemon
        .place()
        .checked("cdcrctl replay --verify run.mcap", 0, &["reproduced"]);
    assert!(reported.contains("not completely recorded"), "{reported}");
}

#[test]
fn the_first_difference_is_named_and_saved_so_that_it_shows_again_alone() {
    let (place, file) = tracked_curve();
    let altered = file.with_file_name("altered.mcap");
    let mut solved = 0;
    rewrite(
        &file,
        &altered,
        |_| {},
        |record| {
            solved += u32::from(record.plan_length > 0);
            // Tracking for a while: chunks were appended meanwhile.
            if solved == 150 || solved == 160 {
                record.plan[3] += f64::EPSILON;
            }
        },
    );
    let verify = |file: &str| -> Value {
        let line = format!("cdcrctl replay --format json --verify {file}");
        let output = place.start(&line).output();
        assert_eq!(output.status.code(), Some(1), "{}", text(&output));
        serde_json::from_slice(&output.stdout).unwrap()
    };
    let all = verify("altered.mcap");
    let first = &all["first_difference"];
    assert_eq!(
        (&all["different"], &first["what"]),
        (&2.into(), &"plan[3]".into()),
        "{all}"
    );
    let alone = verify(first["inputs"].as_str().unwrap());
    assert_eq!(
        (&alone["cycles"], &alone["different"]),
        (&1.into(), &1.into()),
        "{alone}"
    );
    for name in ["cycle", "what", "recorded", "computed"] {
        assert_eq!(alone["first_difference"][name], first[name], "{name}");
    }
    // Where its inputs cannot be saved, it is named all the same.
    let saved = file.with_file_name(first["inputs"].as_str().unwrap());
    fs::remove_file(&saved).unwrap();
    fs::create_dir(&saved).unwrap();
    let unsaved = &verify("altered.mcap")["first_difference"];
    assert_eq!(unsaved["inputs"], Value::Null);
    assert_eq!(unsaved["what"], first["what"]);
}

#[test]
fn other_settings_are_compared_with_what_was_commanded() {
    let (place, file) = tracked_curve();
    let with = |changes: &str| place.json(&format!("replay --with {changes} run.mcap"));
    let [same, others] = [
        "velocity_rule=inertia",
        "solver=gauss-newton,horizon_steps=5",
    ]
    .map(with);
    let most = |found: &Value| found["rates_apart_rad_s"]["max"].as_f64().unwrap();
    assert!(same["cycles"].as_u64().unwrap() > 150, "{same}");
    // Only a solve that the machine shortened gives another result.
    let is_cut_short = same["recorded_cut_short"].as_u64().unwrap() > 0;
    assert!(most(&same) == 0.0 || is_cut_short, "{same}");
    assert!(most(&others) > 1e-6, "{others}");
    assert_eq!(same["cycles"], others["cycles"]);
    assert_ne!(same["with"]["evaluations"], others["with"]["evaluations"]);
    place.checked("cdcrctl replay --with horizon=5 run.mcap", 2, &["horizon"]);
    // Plans of a version with other control blocks have another length.
    let other = file.with_file_name("other.mcap");
    rewrite(
        &file,
        &other,
        |_| {},
        |record| record.plan_length = record.plan_length.saturating_sub(1),
    );
    for how in ["--with velocity_rule=inertia", "--verify"] {
        let line = format!("cdcrctl replay {how} other.mcap");
        place.checked(&line, 1, &["a version with other control blocks"]);
    }
}
