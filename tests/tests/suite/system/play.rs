//! `cdcrctl replay` of a recording into a daemon.

use std::path::PathBuf;

use cdcr_client::{Connection, Spiral};
use cdcr_shared_types::Obstacle;
use cdcr_shared_types::codes::{EventKind, Mode, RequestKind};
use cdcr_tests::{
    Daemon, STALL_TOLERANT, TIMEOUT, ask_for, assert_output, ball, text, track, wait_record,
    wait_status,
};
use rustix::process::Signal;

/// A recording `run.mcap` of a curve that is tracked beside a moving obstacle, after the requests of
/// `before`.
pub(super) fn record_beside(
    daemon: &Daemon,
    id: u32,
    start_m: [f64; 3],
    before: impl FnOnce(&Connection),
) -> PathBuf {
    let mut recorder = daemon.place().record("run.mcap");
    let connection = daemon.connect();
    let mut telemetry = connection.telemetry().unwrap();
    let obstacle = Obstacle {
        velocity_m_s: [0.0, 0.01, 0.0],
        ..ball(id, start_m)
    };
    let sender = connection.obstacle_sender().unwrap();
    let header = sender.upsert(&[obstacle]).unwrap();
    telemetry
        .outcome_on(EventKind::Obstacles, &header, TIMEOUT)
        .unwrap();
    before(&connection);
    let curve = Spiral {
        duration_s: 1.5,
        ..Spiral::for_sections(&[0.3; 3])
    };
    track(&connection, &curve);
    recorder.signal(Signal::INT);
    assert_output(&recorder.output(), 0, &["run.mcap", "obstacle update"]);
    daemon.place().folder().join("run.mcap")
}

/// Such a recording, and its daemon, at rest at another position.
fn recorded() -> (Daemon, PathBuf) {
    let daemon = Daemon::start(STALL_TOLERANT);
    let file = record_beside(&daemon, 7, [0.4, 0.0, 0.5], |_| ());
    let place = daemon.place();
    place.checked("cdcrctl obstacle clear", 0, &[]);
    place.checked("cdcrctl home --wait", 0, &[]);
    (daemon, file)
}

#[test]
fn references_and_obstacles_of_a_recording_are_fed_again_and_the_robot_holds() {
    let (daemon, _) = recorded();
    let connection = daemon.connect();
    let mut telemetry = connection.telemetry().unwrap();
    let mut player = daemon.place().start("cdcrctl replay run.mcap --speed 2");
    let mut known = wait_record(&mut telemetry, |record| record.obstacle_count == 1);
    // Twice as fast, and so is the obstacle.
    assert_eq!(known.obstacles[0].velocity_m_s, [0.0, 0.02, 0.0]);
    known = wait_record(&mut telemetry, |record| {
        record.mode == Mode::Tracking.code()
    });
    // From the present position, on a smooth path.
    assert!(known.approach.duration_ns > 0);
    let begin_m = known.reference.position_m;
    let late = wait_record(&mut telemetry, |record| record.mode == Mode::Holding.code());
    let moved = (0..3).any(|i| (late.tip_position_m[i] - begin_m[i]).abs() > 1e-3);
    assert!(moved, "{:?}", late.tip_position_m);
    let reported = assert_output(
        &player.output(),
        0,
        &[
            "1 obstacle update sent, 2 times",
            "the daemon holds",
            "tip error",
        ],
    );
    assert!(!reported.contains(" 0 reference chunks"), "{reported}");
    wait_status(&connection, |status| {
        (status.mode, status.lease_holder) == (Mode::Holding.code(), 0)
    });
    wait_record(&mut telemetry, |record| record.obstacle_count == 0);
}

#[test]
fn an_interrupted_replay_ends_in_hold() {
    let (daemon, _) = recorded();
    let connection = daemon.connect();
    let mut telemetry = connection.telemetry().unwrap();
    let mut player = daemon.place().start("cdcrctl replay run.mcap --speed 0.1");
    wait_record(&mut telemetry, |record| record.obstacle_count == 1);
    player.signal(Signal::INT);
    let output = player.output();
    assert_eq!(output.status.code(), Some(130), "{}", text(&output));
    wait_record(&mut telemetry, |record| {
        record.obstacle_count == 0 && record.mode == Mode::Holding.code()
    });
}

/// What the daemon knows: ids, and the second coordinates of the obstacles \[m\].
fn live(daemon: &Daemon) -> Vec<(u64, f64)> {
    let list = daemon.place().json("obstacle list");
    let known = list.as_array().unwrap().iter();
    let reported = known.map(|it| (it["id"].as_u64(), it["start_m"][1].as_f64()));
    reported.map(|(id, y)| (id.unwrap(), y.unwrap())).collect()
}

#[test]
fn a_replay_whose_obstacle_has_an_id_in_use_is_refused_or_leaves_it_out() {
    let (daemon, _) = recorded();
    let place = daemon.place();
    for id in [7, 8] {
        let add = format!("cdcrctl obstacle add --id {id} --at 0.4,0.3,0.5 --radius 0.03");
        place.checked(&add, 0, &[]);
    }
    let remedy = ["ids are in use: 7.", "obstacle remove 7)", "--keep-live"];
    place.checked("cdcrctl replay run.mcap", 1, &remedy);
    let declared = [(7, 0.3), (8, 0.3)];
    assert_eq!(live(&daemon), declared);
    let replay = "cdcrctl replay run.mcap --speed 2 --keep-live";
    place.checked(replay, 0, &["the daemon holds"]);
    assert_eq!(live(&daemon), declared);
}

#[test]
fn a_replay_removes_no_obstacle_of_others() {
    let daemon = Daemon::start(STALL_TOLERANT);
    record_beside(&daemon, 7, [0.4, 0.0, 0.5], |connection| {
        let mut telemetry = connection.telemetry().unwrap();
        let sender = connection.obstacle_sender().unwrap();
        let header = sender.clear().unwrap();
        let answer = telemetry.outcome_on(EventKind::Obstacles, &header, TIMEOUT);
        answer.unwrap();
        sender.upsert(&[ball(8, [0.4, 0.0, 0.5])]).unwrap();
        wait_record(&mut telemetry, |record| record.obstacle_count == 1);
    });
    let place = daemon.place();
    let cleared = "removed: 1 obstacle of other clients, 8";
    place.checked("cdcrctl obstacle clear", 0, &["0 known", cleared]);
    place.checked("cdcrctl home --wait", 0, &[]);
    place.checked(
        "cdcrctl obstacle add --id 1 --at 0.4,0.3,0.5 --radius 0.03",
        0,
        &["1 known"],
    );
    // The recording has a clear.
    place.checked(
        "cdcrctl replay run.mcap --speed 2",
        0,
        &["the daemon holds"],
    );
    assert_eq!(live(&daemon), [(1, 0.3)]);
    // Another client declares an obstacle with an id of the replay meanwhile.
    let connection = daemon.connect();
    let mut telemetry = connection.telemetry().unwrap();
    let mut player = place.start("cdcrctl replay run.mcap --speed 0.1");
    wait_record(&mut telemetry, |record| record.obstacle_count == 2);
    let sender = connection.obstacle_sender().unwrap();
    let header = sender.upsert(&[ball(8, [0.4, -0.3, 0.5])]).unwrap();
    let answer = telemetry.outcome_on(EventKind::Obstacles, &header, TIMEOUT);
    answer.unwrap();
    player.signal(Signal::INT);
    assert_eq!(player.output().status.code(), Some(130));
    wait_record(&mut telemetry, |record| record.mode == Mode::Holding.code());
    assert_eq!(live(&daemon), [(1, 0.3), (8, -0.3)]);
}

#[test]
fn what_cannot_be_fed_again_is_refused_before_anything_moves() {
    let (daemon, file) = recorded();
    let place = daemon.place();
    let section = "[[robot.sections]]\nlength_m = 0.31\ncable_radius_m = 0.0125\ncable_offset_rad = 0.0\n\
                   bend_max_rad = 2.8\nrate_max_rad_s = 2.0\nbody_radius_m = 0.015\n";
    let other = Daemon::start(&format!("{STALL_TOLERANT}{section}"));
    let play = format!("cdcrctl replay {}", file.display());
    other.place().checked(&play, 1, &["another robot"]);
    place.write("empty.mcap", "");
    place.checked("cdcrctl replay empty.mcap", 1, &["the file is empty"]);
    place.checked("cdcrctl replay run.mcap --speed 9", 2, &["0.1 and 4"]);
    place.checked(
        "cdcrctl replay run.mcap --speed 2 --verify",
        2,
        &["--verify"],
    );
    ask_for(&daemon.connect(), RequestKind::Stop);
    place.checked("cdcrctl replay run.mcap", 1, &["cdcrctl reset"]);
}
