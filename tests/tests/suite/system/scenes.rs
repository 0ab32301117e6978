//! Inputs of `cdcrctl` from formulas, files and pipes, curves and scenes, and its output for other programs.

use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::net::UdpSocket;
use std::process::{Child, Output, Stdio};
use std::time::Duration;

use cdcr_tests::{Daemon, STALL_TOLERANT, TIMEOUT, assert_output, ball, wait_status};
use serde_json::Value;

use super::freeze;

/// Starts `cdcrctl` with a standard input that the test writes.
fn piped(daemon: &Daemon, line: &str) -> Child {
    let mut command = daemon.place().command("cdcrctl");
    command.args(line.split(' ')).stdin(Stdio::piped());
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    command.spawn().unwrap()
}

fn write(child: &mut Child, text: &str) {
    let mut stdin = child.stdin.as_ref().unwrap();
    stdin.write_all(text.as_bytes()).unwrap();
}

/// Closes its standard input and waits for its end.
fn ended(child: Child) -> Output {
    child.wait_with_output().unwrap()
}

fn checked(daemon: &Daemon, line: &str, status: i32, part: &str) -> String {
    let line = format!("cdcrctl {line}");
    daemon.place().checked(&line, status, &[part])
}

#[test]
fn figures_are_tried_and_followed() {
    let daemon = Daemon::start(STALL_TOLERANT);
    for figure in [
        "helix --turns 1 --rise 0.02 --repeat 2",
        "lissajous --ratio 1:2 --plane xz",
        "rose --petals 3 --plane yz",
        "polygon",
    ] {
        let line = format!("ref {figure} --radius 0.02 --speed 0.15 --dry-run");
        checked(&daemon, &line, 0, "tip error");
    }
    checked(
        &daemon,
        "ref polygon --radius 0.5 --speed 1 --dry-run",
        1,
        "not reachable: at",
    );
    checked(
        &daemon,
        "ref polygon --radius 0.02 --speed 2 --dry-run",
        1,
        "too fast: at",
    );
    let alone = "ref polygon --radius 0.02 --blend";
    checked(&daemon, alone, 2, "<--track|--dry-run>");
    let both = "ref polygon --radius 0.02 --speed 0.15 --blend --dry-run";
    checked(&daemon, both, 0, "straight way: nothing moved");
    for of_mm in ["goto 0.1,0,0.8 --speed 50", "ref rose --speed 50"] {
        checked(&daemon, of_mm, 2, "is it in mm/s?");
    }
    let line =
        "ref polygon --corners 3 --centre 0,0,0.88 --radius 0.01 --repeat 8 --track --lead 1s";
    checked(&daemon, line, 0, "tracked to its end");

    let mut path = piped(&daemon, "ref stdin --track --lead 1s");
    write(&mut path, "t_s,x_m,y_m,z_m\n0,0,0,0.89\n3,0,0.001,0.89\n");
    assert_output(&ended(path), 0, &["standard input: 2 points"]);
    let mut path = piped(&daemon, "ref stdin --track");
    write(&mut path, "t_s,x_m,y_m,z_m\n0,0,0,0.89\n0,0,0.001,0.89\n");
    assert_output(&ended(path), 1, &["standard input:3"]);
}

#[test]
fn a_scene_is_played_from_a_file() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let place = daemon.place();
    let ball = r#""start_m": [0.5, 0, 0.5], "radius_m": 0.02"#;
    let scene = format!(
        "{{\"id\": 1, {ball}}}\n{{\"id\": 2, {ball}}}\n{{\"time_s\": 0.1, \"id\": 3, {ball}}}\n{{\"time_s\": 0.2, \"remove\": [1, 2]}}\n"
    );
    place.write("scene.json", &scene);
    let played = "4 changes accepted, 1 known";
    checked(&daemon, "obstacle file scene.json", 0, played);
    // The output of the list is a scene, too.
    let list = checked(&daemon, "obstacle list --format json", 0, "\"id\": 3");
    place.write("list.json", &list);
    checked(&daemon, "obstacle clear", 0, "0 known");
    checked(&daemon, "obstacle file list.json", 0, "1 known");
    // Everything is checked before anything is sent.
    for (bad, part) in [
        ("{\"id\": 5}\n", "line 5: missing field `start_m`"),
        ("{\"remove\": [1]}\n", "line 5: time_s = 0 is before"),
        (
            "{\"time_s\": 1, \"id\": 5, \"start_m\": [500, 0, 0], \"radius_m\": 1}\n",
            "line 5: obstacle 5 is 499.0 m away",
        ),
    ] {
        place.write("bad.json", &format!("{scene}{bad}"));
        checked(&daemon, "obstacle file bad.json", 1, part);
    }
    place.write("empty.json", "\n");
    checked(&daemon, "obstacle file empty.json", 1, "no obstacle");
    checked(&daemon, "obstacle list", 0, "3  sphere");
}

#[test]
fn obstacles_are_taken_as_a_program_writes_them() {
    let mut daemon = Daemon::start(STALL_TOLERANT);
    let connection = daemon.connect();
    let mut camera = piped(&daemon, "obstacle stdin");
    for id in 1..=3_u32 {
        let line = format!("{{\"id\": {id}, \"start_m\": [0.5, 0, 0.5], \"radius_m\": 0.02}}\n");
        write(&mut camera, &line);
        wait_status(&connection, |status| status.obstacle_count == id);
    }
    write(&mut camera, "\n{\"remove\": [1, 2]}\n");
    assert_output(&ended(camera), 0, &["4 changes accepted", "1 known"]);

    let mut camera = piped(&daemon, "obstacle stdin");
    write(&mut camera, "{\"remove\": [3]}\n{\"id\": 7\n");
    assert_output(&ended(camera), 1, &["standard input: line 2"]);
    wait_status(&connection, |status| status.obstacle_count == 0);

    // An id that nobody had is named: not one of another client, nor one that this program sent, unless it has removed it.
    let mut camera = piped(&daemon, "obstacle stdin");
    write(
        &mut camera,
        "{\"id\": 5, \"start_m\": [0.5, 0, 0.5], \"radius_m\": 0.02}\n",
    );
    wait_status(&connection, |status| status.obstacle_count == 1);
    checked(&daemon, "obstacle clear", 0, "0 known");
    let other = connection.obstacle_sender().unwrap();
    other.upsert(&[ball(6, [0.5, 0.0, 0.5])]).unwrap();
    wait_status(&connection, |status| status.obstacle_count == 1);
    let removes = "{\"remove\": [5, 99]}\n{\"remove\": [6, 99]}\n{\"remove\": [5]}\n";
    write(&mut camera, removes);
    let unknown =
        "0 known to the daemon now\nnothing to remove: no obstacle with id 5, 99 was known";
    assert_output(&ended(camera), 0, &["4 changes accepted", unknown]);

    // What was not sent says nothing about what is known.
    let output = ended(piped(&daemon, "obstacle stdin"));
    assert!(!assert_output(&output, 0, &["0 changes accepted"]).contains("known"));
    let mut endless = daemon.place().command("cdcrctl");
    let zeros = File::open("/dev/zero").unwrap();
    let output = endless.args(["obstacle", "stdin"]).stdin(zeros).output();
    assert_output(
        &output.unwrap(),
        1,
        &["line 1: it is longer than 65536 bytes"],
    );

    // Stamped by a clock that shows the date.
    let mut camera = piped(&daemon, "obstacle stdin");
    write(
        &mut camera,
        "{\"id\": 1, \"start_m\": [0.5, 0, 0.5], \"radius_m\": 0.02, \"measured_ns\": 1795710684705428294}\n",
    );
    assert_output(&ended(camera), 1, &["line 1: ", "CLOCK_MONOTONIC"]);

    // The daemon ends while the program waits for a line.
    let mut camera = piped(&daemon, "obstacle stdin");
    write(
        &mut camera,
        "{\"id\": 1, \"start_m\": [0.5, 0, 0.5], \"radius_m\": 0.02}\n",
    );
    wait_status(&connection, |status| status.obstacle_count == 1);
    let stdin = camera.stdin.take();
    daemon.stop();
    let output = ended(camera);
    drop(stdin);
    assert_output(&output, 1, &["daemon"]);
}

/// The rate in a line of `hz`.
fn rate_hz(line: &str) -> f64 {
    let words: Vec<_> = line.split_whitespace().collect();
    assert_eq!(words.len(), 6, "{line}");
    words[0].parse().unwrap()
}

#[test]
fn a_daemon_that_stood_still_is_not_counted_as_silent() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let mut hz = piped(&daemon, "hz status --count 1");
    let mut lines = BufReader::new(hz.stdout.take().unwrap()).lines();
    lines.next().unwrap().unwrap();
    freeze(&daemon, Duration::from_millis(1300));
    let line = lines.next().unwrap().unwrap();
    assert!(rate_hz(&line) > 0.0, "{line}");
    assert_output(&ended(hz), 0, &[]);
    // Without a feed, the rate is zero.
    let printed = checked(&daemon, "hz reference --count 1", 0, "messages/s");
    assert!(
        rate_hz(printed.lines().nth(1).unwrap()).abs() < 1e-9,
        "{printed}"
    );
}

#[test]
fn messages_are_counted_cut_to_fields_and_sent_to_a_plotter() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let printed = checked(&daemon, "hz status --count 1", 0, "messages/s");
    assert!(rate_hz(printed.lines().nth(1).unwrap()) > 0.0, "{printed}");

    let line = "echo telemetry --count 1 --field tip_position_m.0 --field obstacles.9.id";
    let printed = checked(&daemon, line, 0, "tip_position_m.0\tobstacles.9.id");
    assert!(printed.trim_end().ends_with("\tnull"), "{printed}");
    let line = "echo status --count 1 --field robot.sections.9.name";
    checked(&daemon, line, 1, "robot.sections has 3 elements");
    let line = "echo telemetry --count 1 --field tip";
    checked(&daemon, line, 1, "unknown field \"tip\"");
    let words: Vec<_> = line.split(' ').collect();
    let printed = daemon.place().cdcrctl(&words).stdout;
    assert!(printed.is_empty(), "a heading");

    let plotter = UdpSocket::bind("127.0.0.1:0").unwrap();
    plotter.set_read_timeout(Some(TIMEOUT)).unwrap();
    let line = format!("plot --count 3 --udp {}", plotter.local_addr().unwrap());
    checked(&daemon, &line, 0, "");
    let mut packet = [0; 4096];
    let mut last_s = 0.0;
    for _ in 0..3 {
        let length = plotter.recv(&mut packet).unwrap();
        let value: Value = serde_json::from_slice(&packet[..length]).unwrap();
        assert!(length < 2000 && value["tip_position_m"][2].as_f64() > Some(0.5));
        // Without a reference, there is no error.
        assert!(value.get("position_error_m").is_none(), "{value}");
        let time_s = value["timestamp"].as_f64().unwrap();
        assert!(time_s > last_s);
        last_s = time_s;
    }
    checked(&daemon, "plot --udp nowhere", 1, "expected HOST:PORT");
    checked(&daemon, "plot --udp localhost:99999", 1, "invalid port");
    checked(
        &daemon,
        "plot --udp 127.0.0.1:0",
        1,
        "cannot send to 127.0.0.1:0",
    );
    checked(&daemon, "plot status --count 1 --udp 127.0.0.1:9", 0, "");
    let whole = "plot status --field last_minute --field since_reset --field robot --count 1 --udp 127.0.0.1:9";
    checked(&daemon, whole, 1, "select fields with --field");
}
