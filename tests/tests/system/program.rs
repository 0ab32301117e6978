//! `cdcrctl` as a user meets it when all is well.

use std::process::Command;

use cdcr_shared_types::codes::Mode;
use cdcr_tests::{Daemon, PATIENCE, PATIENT, Place, Program, ROBOT, text, wait_status, wait_until};
use rustix::process::Signal;
use serde_json::Value;

/// A slow line that lasts as long as a test needs it.
const LONG_LINE: &[&str] = &[
    "ref",
    "line",
    "--velocity",
    "0.001,0,-0.001",
    "--duration",
    "120s",
    "--lead",
    "1s",
];
const SHORT_LINE: &[&str] = &["ref", "line", "--duration", "300ms", "--lead", "1s"];

fn command(place: &Place, arguments: &[&[&str]]) -> Command {
    let mut command = place.command("cdcrctl");
    command.args(arguments.concat());
    command
}

/// Runs to a good end; what it printed.
fn good(place: &Place, arguments: &[&[&str]]) -> String {
    let output = Program::start(&mut command(place, arguments)).output();
    let text = text(&output);
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {text}");
    text
}

fn status(place: &Place) -> Value {
    serde_json::from_str(&good(place, &[&["status", "--format", "json"]])).unwrap()
}

#[test]
fn a_reference_is_fed_tracked_and_played_to_its_end() {
    let daemon = Daemon::start(PATIENT);
    let place = daemon.place();
    let fed = good(place, &[SHORT_LINE, &["--track"]]);
    assert!(
        fed.contains("line: 61 points") && fed.contains("tracked to its end"),
        "{fed}"
    );
    let reason = "the reference ended";
    wait_until(reason, || status(place)["reason"] == reason);
    let fed = good(place, &[SHORT_LINE]);
    assert!(fed.contains("but not tracked"), "{fed}");
    let file = place.write(
        "path.csv",
        "t_s,x_m,y_m,z_m\n0,0,0,0.9\n0.1,0.001,0,0.899\n0.2,0.002,0,0.899\n",
    );
    let file = ["ref", "file", file.to_str().unwrap(), "--lead", "1s"];
    let fed = good(place, &[&file, &["--track"]]);
    assert!(fed.contains("3 points"), "{fed}");
}

#[test]
fn an_orientation_is_fed_without_a_warning() {
    let daemon = Daemon::start(PATIENT);
    let place = daemon.place();
    let fed = good(place, &[SHORT_LINE, &["--axis", "0,0,1", "--track"]]);
    assert!(fed.contains("tracked to its end"), "{fed}");
    assert!(!fed.contains("warning"), "{fed}");
}

#[test]
fn obstacles_are_added_shown_and_removed() {
    let daemon = Daemon::start(PATIENT);
    let place = daemon.place();
    let add = |id, rest: &[&str]| {
        let sphere = ["obstacle", "add", "--id", id, "--at", "0.2,0,0.5"];
        good(place, &[&sphere, rest])
    };
    let said = add("1", &["--radius", "0.05"]);
    assert!(said.contains("accepted, 1 known"), "{said}");
    let said = add("2", &["--radius", "0.05", "--to", "0.2,0.1,0.5"]);
    assert!(said.contains("accepted, 2 known"), "{said}");
    wait_until("2 obstacles", || status(place)["obstacle_count"] == 2);
    // The robot is straight: 0.2 m to the axis, less the radii of ball and body.
    let clearance_m = status(place)["clearance_m"].as_f64().unwrap();
    assert!((clearance_m - 0.135).abs() < 1e-12, "{clearance_m}");
    let table = good(place, &[&["status"]]);
    let shown = "obstacles   2, smallest clearance 135.00 mm";
    assert!(table.contains(shown), "{table}");
    let said = good(place, &[&["obstacle", "remove", "2", "77"]]);
    assert!(said.contains("accepted, 1 known"), "{said}");
    let said = good(place, &[&["obstacle", "clear"]]);
    assert!(said.contains("accepted, 0 known"), "{said}");
    wait_until("none", || status(place)["clearance_m"].is_null());
    let refused = place.cdcrctl(&[
        "obstacle", "add", "--id", "1", "--at", "9e9,0,0", "--radius", "1",
    ]);
    let message = text(&refused);
    assert_eq!(refused.status.code(), Some(1), "{message}");
    assert!(message.contains("the daemon refused it"), "{message}");
    assert!(message.contains("within ±1000000 m"), "{message}");
    wait_until("counted", || status(place)["obstacles_refused"] == 1);
}

#[test]
fn whoever_leaves_last_leaves_nothing() {
    let mut daemon = Daemon::start(PATIENT);
    good(daemon.place(), &[&["status"]]);
    let connection = daemon.connect();
    let telemetry = connection.telemetry().unwrap();
    assert!(daemon.stop().success());
    drop((telemetry, connection));
    let files = || daemon.place().shared_memory_files();
    assert_eq!(files(), Vec::<String>::new());
    // A client that finds nobody.
    assert!(!daemon.place().cdcrctl(&["status"]).status.success());
    assert_eq!(files(), Vec::<String>::new());
}

#[test]
fn every_request_is_answered() {
    let daemon = Daemon::start(PATIENT);
    let place = daemon.place();
    for (request, mode) in [
        ("hold", "holding"),
        ("home", "homing"),
        ("stop", "stopped"),
        ("reset", "holding"),
    ] {
        let answer = good(place, &[&[request]]);
        assert!(answer.contains(": accepted in cycle "), "{answer}");
        assert!(answer.contains(&format!("daemon is {mode}")), "{answer}");
    }
    let output = place.cdcrctl(&["track"]);
    let message = text(&output);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.starts_with("error: cannot track"), "{message}");
    assert!(message.contains("cdcrctl ref"), "{message}");
}

#[test]
fn track_follows_what_another_program_feeds_until_sigint_holds() {
    let daemon = Daemon::start(PATIENT);
    let place = daemon.place();
    let connection = daemon.connect();
    let mut feeding = Program::start(&mut command(place, &[LONG_LINE]));
    // Refused until the first chunk is in.
    wait_until("tracking", || place.cdcrctl(&["track"]).status.success());
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
    let daemon = Daemon::start(PATIENT);
    let connection = daemon.connect();
    for signal in [Signal::INT, Signal::TERM] {
        let mut feeding = Program::start(&mut command(daemon.place(), &[LONG_LINE, &["--track"]]));
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
    let daemon = Daemon::start(PATIENT);
    let table = good(daemon.place(), &[&["status"]]);
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
}

/// Starts an echo, lets `speak` make messages until the echo has enough, and returns its lines.
fn echo(place: &Place, topic: &str, format: &str, speak: &dyn Fn()) -> Vec<String> {
    let options = ["echo", topic, "--count", "3", "--format", format];
    let mut echo = Program::start(&mut command(place, &[&options]));
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
    let daemon = Daemon::start(PATIENT);
    let place = daemon.place();
    let connection = daemon.connect();
    let obstacles = connection.obstacle_sender().unwrap();
    let feed = || {
        good(
            place,
            &[&["ref", "line", "--duration", "10ms", "--lead", "100ms"]],
        );
    };
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
    assert!(connection.status(PATIENCE).is_ok());
}
