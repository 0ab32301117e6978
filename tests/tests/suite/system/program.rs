//! `cdcrctl` in normal use, without faults.

use std::path::PathBuf;
use std::time::Duration;

use cdcr_shared_types::codes::Mode;
use cdcr_tests::{
    Daemon, Place, Program, ROBOT, STALL_TOLERANT, TIMEOUT, assert_output, text, wait_status,
    wait_until,
};
use rustix::process::Signal;
use serde_json::Value;

use super::freeze;

/// A slow line that lasts longer than any test needs it.
const LONG_LINE: &str = "ref line --velocity 0.001,0,-0.001 --duration 120s --lead 1s";
const SHORT_LINE: &str = "ref line --duration 300ms --lead 1s";

fn start(place: &Place, line: &str) -> Program {
    place.start(&format!("cdcrctl {line}"))
}

/// Runs a command that must succeed, and returns its output.
fn good(place: &Place, line: &str) -> String {
    place.checked(&format!("cdcrctl {line}"), 0, &[])
}

fn status(place: &Place) -> Value {
    place.json("status")
}

#[test]
fn a_reference_is_fed_tracked_and_played_to_its_end() {
    // Ideal: the tip is at the begin of the line, so that no approach is needed.
    let daemon = Daemon::ideal(STALL_TOLERANT);
    let place = daemon.place();
    let line = format!("{SHORT_LINE} --axis 0,0,1 --track");
    let output = start(place, &line).output();
    assert_output(&output, 0, &["line: 61 points", "tracked to its end"]);
    let fed = text(&output);
    assert!(!fed.contains("warning"), "an orientation needs none: {fed}");
    let reason = "the reference ended";
    wait_until(reason, || status(place)["reason"] == reason);
    let fed = good(place, SHORT_LINE);
    assert!(fed.contains("but not tracked"), "{fed}");
    place.write(
        "path.csv",
        "t_s,x_m,y_m,z_m\n0,0,0,0.9\n0.1,0.001,0,0.899\n0.2,0.002,0,0.899\n",
    );
    let fed = good(place, "ref file path.csv --lead 1s --track");
    assert!(fed.contains("3 points"), "{fed}");
}

#[test]
fn obstacles_are_added_shown_and_removed() {
    // Ideal, because the clearance is compared exactly.
    let daemon = Daemon::ideal(STALL_TOLERANT);
    let place = daemon.place();
    let checked = |line: &str, part: &str| {
        place.checked(&format!("cdcrctl obstacle {line}"), 0, &[part]);
    };
    let ball = "--at 0.2,0,0.5 --radius 0.05";
    checked(&format!("add --id 1 {ball}"), "accepted, 1 known");
    let capsule = format!("add --id 2 {ball} --to 0.2,0.1,0.5");
    checked(&capsule, "accepted, 2 known");
    wait_until("2 obstacles", || status(place)["obstacle_count"] == 2);
    // The robot is straight: 0.2 m to the axis, less the radii of ball and body.
    let clearance_m = status(place)["clearance_m"].as_f64().unwrap();
    assert!((clearance_m - 0.135).abs() < 1e-12, "{clearance_m}");
    let table = good(place, "status");
    let shown = "obstacles   2, smallest clearance 135.00 mm as estimated";
    assert!(table.contains(shown), "{table}");
    checked("remove 2", "accepted, 1 known");
    checked("clear", "accepted, 0 known");
    wait_until("none", || status(place)["clearance_m"].is_null());
    let far = "cdcrctl obstacle add --id 1 --at 9e8,0,0 --radius 1 --far";
    let parts = ["rejected by the daemon", "within ±1000000 m"];
    place.checked(far, 1, &parts);
    wait_until("counted", || status(place)["obstacles_refused"] == 1);
}

#[test]
fn the_last_process_to_leave_leaves_nothing() {
    let mut daemon = Daemon::start(STALL_TOLERANT);
    good(daemon.place(), "status");
    let connection = daemon.connect();
    let telemetry = connection.telemetry().unwrap();
    assert!(daemon.stop().success());
    drop((telemetry, connection));
    let files = || daemon.place().memory_files();
    assert_eq!(files(), Vec::<PathBuf>::new());
    // A client without a daemon.
    assert!(!daemon.place().cdcrctl(&["status"]).status.success());
    assert_eq!(files(), Vec::<PathBuf>::new());
}

#[test]
fn every_request_is_answered() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let place = daemon.place();
    for (request, mode) in [
        ("hold", "holding"),
        ("home", "homing"),
        ("stop", "stopped"),
        ("reset", "holding"),
    ] {
        let parts = [": accepted in cycle ", &format!("daemon is {mode}")];
        place.checked(&format!("cdcrctl {request}"), 0, &parts);
    }
    let printed = place.checked("cdcrctl track", 1, &["cdcrctl ref"]);
    assert!(printed.starts_with("error: cannot track"), "{printed}");
}

#[test]
fn track_follows_what_another_program_feeds_until_sigint_holds() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let place = daemon.place();
    let connection = daemon.connect();
    let mut feeding = start(place, LONG_LINE);
    // Rejected until the first chunk is accepted.
    wait_until("tracking", || {
        let output = place.cdcrctl(&["track"]);
        assert!(
            feeding.runs(),
            "{}",
            text(&output) + &text(&feeding.output())
        );
        output.status.success()
    });
    wait_status(&connection, |status| status.mode == Mode::Tracking.code());
    feeding.signal(Signal::INT);
    let output = feeding.output();
    assert_eq!(output.status.code(), Some(130), "{}", text(&output));
    assert!(text(&output).contains("interrupted"), "{}", text(&output));
    wait_status(&connection, |status| {
        status.mode == Mode::Holding.code() && status.lease_holder == 0
    });
}

#[test]
fn sigint_and_sigterm_during_a_tracked_feed_hold_and_exit_with_130() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let connection = daemon.connect();
    for signal in [Signal::INT, Signal::TERM] {
        let mut feeding = start(daemon.place(), &format!("{LONG_LINE} --track"));
        wait_status(&connection, |status| status.mode == Mode::Tracking.code());
        feeding.signal(signal);
        let output = feeding.output();
        assert_eq!(output.status.code(), Some(130), "{}", text(&output));
        wait_status(&connection, |status| {
            status.mode == Mode::Holding.code() && status.lease_holder == 0
        });
    }
}

#[test]
fn the_status_is_shown_as_text_and_as_json() {
    let daemon = Daemon::start(&format!(
        "{STALL_TOLERANT}[robot]\ncable_speed_max_m_s = 0.25\n"
    ));
    let table = good(daemon.place(), "status");
    for part in [
        "robot       cdcr (3 sections",
        "mode        holding",
        "deadline misses",
        "response",
        "kpso-refined",
    ] {
        assert!(table.contains(part), "{part}: {table}");
    }
    let status = status(daemon.place());
    assert_eq!(status["robot_name"], ROBOT);
    assert_eq!(status["mode"], "holding");
    assert_eq!(status["period_ns"], 5_000_000);
    assert_eq!(status["robot"]["sections"].as_array().unwrap().len(), 3);
    assert_eq!(status["robot"]["cable_speed_max_m_s"], 0.25);
    let statistics = &status["since_reset"];
    assert_eq!(statistics["cycles"], status["cycles"]);
    assert_eq!(statistics["wake"]["count"], status["cycles"]);
}

#[test]
fn the_statistics_are_reset_for_all_and_the_stop_stays() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let place = daemon.place();
    good(place, "stop");
    let before = status(place);
    let printed = good(place, "status --reset-statistics");
    assert!(printed.contains("reset after cycle"), "{printed}");
    let since = |status: &Value| status["statistics_since_ns"].as_u64().unwrap();
    wait_until("the reset", || since(&status(place)) > since(&before));
    let after = status(place);
    let counted = after["since_reset"]["cycles"].as_u64().unwrap();
    assert!(counted < after["cycles"].as_u64().unwrap(), "{after}");
    assert_eq!(after["mode"], "stopped");
}

#[test]
fn a_watched_status_is_shown_again_and_again() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let mut watch = start(daemon.place(), "status --watch --format json");
    wait_until("two of them", || watch.lines() > 1);
    watch.signal(Signal::INT);
    let shown = assert_output(&watch.output(), 0, &[]);
    let cycles = shown.lines().map(|line| {
        let status: Value = serde_json::from_str(line).unwrap();
        status["cycles"].as_u64().unwrap()
    });
    let cycles: Vec<u64> = cycles.collect();
    assert!(cycles.len() > 1, "{cycles:?}");
    assert!(cycles.is_sorted_by(|a, b| a < b), "{cycles:?}");
}

/// Longer than a few periods, which causes an incident.
const FROZEN: Duration = Duration::from_millis(100);

#[test]
fn bad_cycles_are_kept_for_clients_that_ask_later() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let place = daemon.place();
    // Only incidents that the daemon kept, at most the newest.
    let frozen = |line: &str| {
        // While a program still writes, its last line may be incomplete.
        let Ok(incident) = serde_json::from_str::<Value>(line) else {
            return false;
        };
        let record = &incident["telemetry"];
        record["skipped_periods"].as_u64().unwrap() >= 10
            && record["late_start"] == true
            && record["scheduling"]["late_cause"] != "in time"
    };
    // If frozen between its command and its sleep, a cycle is not late; the machine causes incidents, too.
    wait_until("the incident", || {
        freeze(&daemon, FROZEN);
        let printed = good(place, "incidents --format json");
        printed.lines().any(frozen)
    });
    let printed = good(place, "incidents --count 1");
    assert_eq!(
        printed.lines().count(),
        2,
        "a heading and one line: {printed}"
    );
    let printed = good(place, "incidents");
    assert!(printed.contains("late start, "), "{printed}");
    assert!(printed.contains("skipped "), "{printed}");

    let line = "incidents --follow --count 0 --format json";
    let mut follow = start(place, line);
    // The time until it listens depends on the machine.
    wait_until("a new incident", || {
        freeze(&daemon, FROZEN);
        follow.printed().lines().any(frozen)
    });
    follow.signal(Signal::INT);
    let printed = assert_output(&follow.output(), 0, &[]);
    assert!(
        printed
            .lines()
            .all(|line| serde_json::from_str::<Value>(line).is_ok()),
        "{printed}"
    );
}

#[test]
fn settings_are_shown_and_changed_by_their_keys() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let place = daemon.place();
    let shown = || place.json("settings show");
    let before = shown();
    let table = good(place, "settings");
    assert!(
        table.contains("kpso, gauss-newton or kpso-refined"),
        "{table}"
    );

    let set = "cdcrctl settings set solver=gauss-newton budget_ms=2.5 horizon_steps=4";
    let parts = [
        "solver: kpso-refined -> gauss-newton",
        "budget_ms: 0 -> 2.5",
        &format!("horizon_steps: {} -> 4", before["horizon_steps"]),
        "settings: accepted",
    ];
    place.checked(set, 0, &parts);
    // In rapid succession: none reverts the change of the one before.
    good(place, "settings set seed=7");
    good(place, "settings set inertia=0.6");
    let mut expected = before;
    expected["solver"] = "gauss-newton".into();
    expected["budget_ms"] = 2.5.into();
    expected["horizon_steps"] = 4.into();
    expected["seed"] = 7.into();
    expected["inertia"] = 0.6.into();
    assert_eq!(shown(), expected);

    let refused = |change: &str, status, part: &str| {
        place.checked(&format!("cdcrctl settings set {change}"), status, &[part]);
    };
    // More blocks than steps: in the range of the key, but invalid for the daemon.
    let out_of_range = "control_blocks = 5 is out of range: allowed is 0 to 4";
    refused("control_blocks=5", 1, out_of_range);
    // The value for a daemon with a period of 5 ms.
    refused(
        "budget_ms=9",
        1,
        "budget_ms = 9 is longer than the period of the daemon: at most 5",
    );
    refused("horizon=5", 2, "did you mean horizon_steps?");
    assert_eq!(shown(), expected, "a refusal changes nothing");
}

/// Starts an echo, calls `speak` to cause messages until the echo has enough, and returns its lines.
fn echo(place: &Place, topic: &str, format: &str, speak: &dyn Fn()) -> Vec<String> {
    let line = format!("echo {topic} --count 3 --format {format}");
    let mut echo = start(place, &line);
    wait_until(topic, || {
        speak();
        !echo.runs()
    });
    let output = echo.output();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output));
    let lines = String::from_utf8(output.stdout).unwrap();
    lines.lines().map(str::to_owned).collect()
}

#[test]
fn every_topic_is_echoed_as_text_and_as_json() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let place = daemon.place();
    let connection = daemon.connect();
    let obstacles = connection.obstacle_sender().unwrap();
    // A late chunk is rejected, but echoed.
    let line = ["ref", "line", "--duration", "10ms", "--lead", "100ms"];
    let feed = || drop(place.cdcrctl(&line));
    let clear = || {
        obstacles.clear().unwrap();
    };
    let nothing = || {};
    let topics: [(&str, &str, &dyn Fn()); 5] = [
        ("telemetry", "tip_position_m", &nothing),
        ("command", "cable_length_m", &nothing),
        ("status", "deadline_misses", &nothing),
        ("reference", "points", &feed),
        ("obstacles", "action", &clear),
    ];
    for (topic, field, speak) in topics {
        let lines = echo(place, topic, "text", speak);
        assert_eq!(lines.len(), 4, "a heading and three lines: {lines:?}");
        let lines = echo(place, topic, "json", speak);
        assert_eq!(lines.len(), 3, "{lines:?}");
        for line in lines {
            let message: Value = serde_json::from_str(&line).unwrap();
            assert!(!message[field].is_null(), "{field} in {line}");
            assert!(message["header"]["sequence"].is_u64(), "{line}");
        }
    }
    assert!(connection.status(TIMEOUT).is_ok());
}
