//! Obstacles that come too near, and too many obstacles.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use cdcr_client::{Connection, ObstacleSender, event_about, events, monotonic_ns};
use cdcr_shared_types::codes::{EventKind, Mode, Outcome, Reason, RequestKind, guard};
use cdcr_shared_types::{InputEvent, Obstacle, Telemetry};
use cdcr_tests::load::{Done, flood_bad_obstacles, flood_obstacles};
use cdcr_tests::{
    BALL_RADIUS_M, Daemon, EndWhenDropped, ROBOT, STALL_TOLERANT, ask_for, ball, refused,
    wait_record, wait_status,
};

use crate::faults::robot::Robot;
use crate::faults::trail::{Trail, is, say};

/// The safe distance of the default configuration.
const SAFE_DISTANCE_M: f64 = 0.01;
const BODY_RADIUS_M: f64 = 0.015;

/// Sends obstacles, and returns the record with their event, and the event.
fn send(trail: &mut Trail, sender: &ObstacleSender, balls: &[Obstacle]) -> (Telemetry, InputEvent) {
    trail.until_answered(
        || sender.upsert(balls).unwrap(),
        |header, record| event_about(record, EventKind::Obstacles, header),
    )
}

/// Sends an obstacle to the side, again if a stall let its lifetime pass on the way.
fn send_alive(
    trail: &mut Trail,
    sender: &ObstacleSender,
    lifetime_ns: u64,
) -> (Obstacle, Telemetry, InputEvent) {
    loop {
        let seen = Obstacle {
            lifetime_ns,
            ..ball(1, [0.5, 0.5, 0.3])
        };
        let (first, answer) = send(trail, sender, &[seen]);
        if answer.outcome != Outcome::InThePast.code() {
            assert_eq!(answer.outcome, Outcome::Accepted.code());
            return (seen, first, answer);
        }
    }
}

/// A robot that homes slowly, sideways, and the position of its next contact.
fn homing(connection: &Connection, trail: &mut Trail) -> [f64; 3] {
    ask_for(connection, RequestKind::Home);
    let mut tips = Vec::new();
    trail.until("homing", |record| {
        if record.mode == Mode::Homing.code() {
            tips.push(record.tip_position_m);
        }
        tips.len() > 20
    });
    let (from, to) = (tips[0], tips[tips.len() - 1]);
    let way: [f64; 3] = core::array::from_fn(|i| to[i] - from[i]);
    let length = way.iter().map(|x| x * x).sum::<f64>().sqrt();
    assert!(length > 0.0, "it moves");
    let apart_m = BODY_RADIUS_M + BALL_RADIUS_M + SAFE_DISTANCE_M / 2.0;
    core::array::from_fn(|i| to[i] + way[i] / length * apart_m)
}

#[test]
fn an_obstacle_at_once_inside_the_safe_distance_is_guarded_in_its_first_cycle() {
    // 2 mm/s: while the test places the ball, the robot does not reach it.
    let slowly = "[motion]\nhome_rate_rad_s = 0.002\n";
    let bent = "[link]\ninitial_bend_rad = [[0.8, 0.0], [0.0, 0.0], [0.0, 0.0]]\n";
    // Ideal, because the clearances of consecutive records are compared exactly.
    let daemon = Daemon::ideal(&format!("{STALL_TOLERANT}{slowly}{bent}"));
    let connection = daemon.connect();
    let mut trail = Trail::new(&connection);
    let sender = connection.obstacle_sender().unwrap();
    let ahead_m = homing(&connection, &mut trail);
    let (first, answer) = send(&mut trail, &sender, &[ball(1, ahead_m)]);
    assert_eq!(
        (answer.outcome, first.obstacle_count),
        (Outcome::Accepted.code(), 1)
    );
    let begin_m = first.clearance_m;
    assert!(0.0 < begin_m && begin_m < SAFE_DISTANCE_M, "{begin_m} m");
    assert_ne!(
        first.guard_flags & guard::CLEARANCE,
        0,
        "in the first cycle that knows it"
    );
    let detected_ns = first.release_ns.saturating_sub(answer.evaluated_ns);
    let bound_ns = 2 * first.period_ns + trail.history().late_since_ns(answer.evaluated_ns);
    say("obstacle inside the safe distance", detected_ns, bound_ns);
    assert!(detected_ns <= bound_ns);
    for _ in 0..100 {
        let (before, now) = trail.until("the next record", |_| true);
        assert_eq!(now.mode, Mode::Homing.code());
        // Rates that last longer than the period they were checked for may go too far.
        let checked = now.skipped_periods == 0;
        assert!(!checked || now.clearance_m >= before.clearance_m - 1e-9);
    }
    let status = wait_status(&connection, |status| status.clearance_guarded > 0);
    assert_eq!(status.faults, 0);
}

#[test]
fn contact_is_a_fault_in_the_next_cycle_and_not_reset_while_it_stands() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let connection = daemon.connect();
    let mut trail = Trail::new(&connection);
    let sender = connection.obstacle_sender().unwrap();
    trail.until("holding", is(Mode::Holding));
    // At the position of the body.
    let (first, answer) = send(&mut trail, &sender, &[ball(1, [0.0, 0.0, 0.5])]);
    assert_eq!(answer.outcome, Outcome::Accepted.code());
    assert!(first.clearance_m < 0.0 && first.mode == Mode::Holding.code());
    let (_, now) = trail.until("the next record", |_| true);
    assert_eq!(
        (now.mode, now.reason),
        (Mode::Faulted.code(), Reason::ClearanceBroken.code())
    );
    let detected_ns = now.release_ns.saturating_sub(answer.evaluated_ns);
    let bound_ns = 3 * now.period_ns + trail.history().late_since_ns(answer.evaluated_ns);
    say("contact", detected_ns, bound_ns);
    assert!(detected_ns <= bound_ns);
    let outcome = refused(&connection, RequestKind::Reset);
    assert_eq!(outcome, Outcome::CauseStands);
    let contact = Reason::ClearanceBroken.code();
    wait_status(&connection, |status| status.reset_refused_by == contact);
    sender.clear().unwrap();
    trail.until("gone", |record| record.obstacle_count == 0);
    wait_status(&connection, |status| {
        status.mode == Mode::Faulted.code() && status.reset_refused_by == Reason::Start.code()
    });
    ask_for(&connection, RequestKind::Reset);
    trail.until("holding", is(Mode::Holding));
}

#[test]
fn one_obstacle_too_many_is_refused_with_its_whole_update_and_counted() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let connection = daemon.connect();
    let mut trail = Trail::new(&connection);
    let sender = connection.obstacle_sender().unwrap();
    let all: Vec<_> = (0..64).map(|id| ball(id, [0.3, 0.0, 0.3])).collect();
    let (_, answer) = send(&mut trail, &sender, &all);
    assert_eq!(
        (answer.outcome, answer.detail),
        (Outcome::Accepted.code(), 64)
    );
    let nearer = ball(1, [0.1, 0.0, 0.3]);
    let (record, answer) = send(&mut trail, &sender, &[nearer, ball(64, [0.3, 0.0, 0.3])]);
    assert_eq!(
        (answer.outcome, answer.detail),
        (Outcome::BufferFull.code(), 1)
    );
    let detected_ns = record.release_ns.saturating_sub(answer.evaluated_ns);
    let bound_ns = 2 * record.period_ns + trail.history().late_since_ns(answer.evaluated_ns);
    say("too many obstacles", detected_ns, bound_ns);
    assert!(detected_ns <= bound_ns);
    assert_eq!(record.obstacle_count, 64);
    assert!(
        record.clearance_m > 0.2,
        "the nearer one of the same update does not count"
    );
    let status = wait_status(&connection, |status| status.obstacles_refused == 1);
    assert_eq!((status.obstacle_count, status.faults), (64, 0));
}

/// Largest number of updates checked in one gather, with the default lead (docs/realtime.md).
const UPDATES_PER_GATHER: u32 = 8;

/// Counts the updates in the record by the gather that checked them.
fn count_updates(record: &Telemetry, evaluated: &mut BTreeMap<u64, u32>) {
    let is_update = |event: &&InputEvent| event.kind == EventKind::Obstacles.code();
    for event in events(record).iter().filter(is_update) {
        *evaluated
            .entry(record.gather - u64::from(event.gathers_ago))
            .or_default() += 1;
    }
}

/// Checks that the work of a gather is bounded in updates, which keeps its inputs in time. Their lateness
/// beside six threads that never pause also depends on the machine (`docs/realtime.md` has numbers).
#[test]
fn floods_of_obstacles_keep_nobody_out_and_give_a_gather_no_more_work() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let connection = daemon.connect();
    let mut trail = Trail::new(&connection);
    let (ending, done) = (AtomicBool::new(false), Done::default());
    std::thread::scope(|scope| {
        let _ends = EndWhenDropped(&ending);
        for _ in 0..3 {
            scope.spawn(|| flood_obstacles(daemon.place(), &ending, &done));
            scope.spawn(|| flood_bad_obstacles(daemon.place(), &ending));
        }
        wait_status(&connection, |status| {
            status.obstacles_refused > 100 && status.outcomes[0] > 100
        });
        // The last client to connect, beside six that never pause.
        let sender = connection.obstacle_sender().unwrap();
        let mut evaluated = BTreeMap::new();
        for _ in 0..20 {
            let (_, answer) = send(&mut trail, &sender, &[ball(63, [0.3, 0.0, 0.3])]);
            assert_eq!(answer.outcome, Outcome::Accepted.code());
            for _ in 0..20 {
                let (_, record) = trail.until("the next record", |_| true);
                count_updates(&record, &mut evaluated);
            }
        }
        let most = evaluated.into_values().max().unwrap();
        assert!(
            (2..=UPDATES_PER_GATHER).contains(&most),
            "{most} in a gather"
        );
    });
}

/// A robot that homes slowly beside a source that falls silent. The reaction depends on the configuration;
/// the obstacles remain in any case.
fn lose_source(rule: &str) {
    let bent = "[link]\ninitial_bend_rad = [[0.8, 0.0], [0.0, 0.0], [0.0, 0.0]]\n";
    let daemon = Daemon::start(&format!(
        "{STALL_TOLERANT}{bent}[motion]\nhome_rate_rad_s = 0.02\n\
         [obstacles]\nsource_timeout_ms = 200.0\nsource_silent = \"{rule}\"\n"
    ));
    let connection = daemon.connect();
    let mut trail = Trail::new(&connection);
    let sender = connection.obstacle_sender().unwrap();
    homing(&connection, &mut trail);
    let (seen, first, answer) = send_alive(&mut trail, &sender, 30_000_000);
    // Silence for longer than lifetime and timeout together.
    let mut held = None;
    let (_, last) = trail.until("silence", |record| {
        assert_eq!(record.obstacle_count, 1, "{rule}");
        assert_eq!(record.obstacles[0].start_m, seen.start_m);
        if record.mode == Mode::Holding.code() && held.is_none() {
            held = Some(*record);
        }
        record.release_ns > first.release_ns + 600_000_000
    });
    let silent = wait_status(&connection, |status| status.silent_obstacle_source != 0);
    assert!((1..last.release_ns).contains(&silent.silent_since_ns));
    if rule == "keep" {
        assert!(held.is_none());
        assert_eq!(last.mode, Mode::Homing.code());
    } else {
        let held = held.unwrap();
        assert_eq!(held.reason, Reason::ObstacleSourceSilent.code());
        let detected_ns = held.release_ns.saturating_sub(answer.evaluated_ns);
        let history = trail.history();
        let bound_ns =
            200_000_000 + 2 * held.period_ns + history.late_since_ns(answer.evaluated_ns);
        say("source of obstacles silent", detected_ns, bound_ns);
        assert!((200_000_000..=bound_ns).contains(&detected_ns));
        // Still silent.
        assert_eq!(refused(&connection, RequestKind::Home), Outcome::Waits);
    }
    // The source is alive, and no longer sees the obstacle.
    let alive = sender.upsert(&[]).unwrap();
    assert_eq!(silent.silent_obstacle_source, alive.sender_id);
    trail.until("gone", |record| record.obstacle_count == 0);
    wait_status(&connection, |status| status.silent_obstacle_source == 0);
    // While the source is alive, lifetimes count.
    let seen = Obstacle {
        measured_ns: monotonic_ns(),
        lifetime_ns: 300_000_000,
        ..seen
    };
    send(&mut trail, &sender, &[seen]);
    let live = || {
        sender.upsert(&[]).unwrap();
    };
    let (_, gone) = trail.until_while("expired", live, |record| record.obstacle_count == 0);
    assert!(gone.release_ns >= seen.measured_ns + seen.lifetime_ns);
}

#[test]
fn a_source_of_obstacles_that_died_holds_the_robot_and_its_obstacles_stay() {
    lose_source("hold");
}

#[test]
fn a_robot_goes_on_beside_the_obstacles_of_a_source_that_died_where_it_should() {
    lose_source("keep");
}

/// A source whose obstacle has expired is silent: a remove of it ends the wait, although nothing of that id is known.
#[test]
fn removing_what_a_silent_source_sent_last_ends_the_wait_also_after_its_lifetime() {
    let daemon = Daemon::start(&format!(
        "{STALL_TOLERANT}[obstacles]\nsource_timeout_ms = 200.0\n"
    ));
    let connection = daemon.connect();
    let mut trail = Trail::new(&connection);
    let other = daemon.connect();
    let senders = [&connection, &other].map(|from| from.obstacle_sender().unwrap());
    for (id, sender) in (1..).zip(&senders) {
        let seen = Obstacle {
            measured_ns: monotonic_ns(),
            lifetime_ns: 100_000_000,
            ..ball(id, [0.5, 0.0, 0.5])
        };
        send(&mut trail, sender, &[seen]);
    }
    let live = || {
        for sender in &senders {
            sender.upsert(&[]).unwrap();
        }
    };
    trail.until_while("expired", live, |record| record.obstacle_count == 0);
    let silent = wait_status(&connection, |status| status.silent_obstacle_source != 0);
    let place = daemon.place();
    let unknown = "no obstacle with id 9 was known";
    place.checked("cdcrctl obstacle remove 9", 1, &[unknown]);
    let over = "was known to the daemon, but the daemon waits no longer";
    let of_first = 1 + u32::from(silent.silent_obstacle_source == other.sender_id());
    for id in [of_first, 3 - of_first] {
        wait_status(&connection, |status| status.silent_obstacle_source != 0);
        place.checked(&format!("cdcrctl obstacle remove {id}"), 0, &[over]);
    }
    wait_status(&connection, |status| status.silent_obstacle_source == 0);
    place.checked(
        "cdcrctl obstacle remove 1",
        1,
        &["no obstacle with id 1 was"],
    );
}

/// A driver's robot while homing, beside an obstacle whose lifetime is not renewed. No configuration key
/// about sources is set.
#[test]
fn behind_a_driver_a_source_that_died_holds_the_robot_without_any_setting() {
    let daemon = Daemon::start(
        "[link]\nkind = \"driver\"\nmeasurement_timeout_ms = 5000.0\ncommand_valid_ms = 1000.0\n\
         [motion]\nhome_rate_rad_s = 0.02\n[cycle]\nmiss_limit = 1000000\n",
    );
    let connection = daemon.connect();
    let (mut trail, mut robot) = (Trail::new(&connection), Robot::new(&connection, 1.0));
    let sender = connection.obstacle_sender().unwrap();
    robot.until_held(&mut trail);
    ask_for(&connection, RequestKind::Home);
    trail.until_while("homing", || robot.turn(), is(Mode::Homing));
    let (seen, first, _) = send_alive(&mut trail, &sender, 300_000_000);
    assert_eq!(first.obstacle_count, 1);
    let (_, held) = trail.until_while(
        "holding",
        || robot.turn(),
        |record| {
            assert_eq!(record.obstacle_count, 1, "it stays");
            record.mode == Mode::Holding.code()
        },
    );
    assert_eq!(held.reason, Reason::ObstacleSourceSilent.code());
    assert!(held.release_ns >= seen.measured_ns + 500_000_000);
}

/// The program of a camera dies beside an obstacle that an operator declared, and is started again. The robot
/// may go on, and the operator's obstacle stays.
#[test]
fn behind_a_driver_a_source_that_starts_again_with_its_ids_ends_the_hold_and_fixed_obstacles_stay()
{
    let daemon = Daemon::start(
        "[link]\nkind = \"driver\"\nmeasurement_timeout_ms = 5000.0\ncommand_valid_ms = 1000.0\n\
         [motion]\nhome_rate_rad_s = 0.02\n[cycle]\nmiss_limit = 1000000\n",
    );
    let connection = daemon.connect();
    let (mut trail, mut robot) = (Trail::new(&connection), Robot::new(&connection, 1.0));
    robot.until_held(&mut trail);
    let fixed = connection.obstacle_sender().unwrap();
    send(&mut trail, &fixed, &[ball(2, [0.5, -0.5, 0.3])]);
    for (takes_over, known) in [(true, 2), (false, 1)] {
        ask_for(&connection, RequestKind::Home);
        trail.until_while("homing", || robot.turn(), is(Mode::Homing));
        let other = daemon.connect();
        let camera = other.obstacle_sender().unwrap();
        send_alive(&mut trail, &camera, 300_000_000);
        let (_, held) = trail.until_while("holding", || robot.turn(), is(Mode::Holding));
        assert_eq!(held.reason, Reason::ObstacleSourceSilent.code());
        assert_eq!(refused(&connection, RequestKind::Home), Outcome::Waits);
        let again = daemon.connect();
        let again = again.obstacle_sender().unwrap();
        let mut live = || {
            robot.turn();
            if takes_over {
                again.upsert(&[ball(1, [0.5, 0.5, 0.3])]).unwrap();
            } else {
                again.remove(&[1]).unwrap();
            }
        };
        let is_taken = |record: &Telemetry| record.obstacle_count == known;
        let (_, now) = trail.until_while("it is another's", &mut live, is_taken);
        assert!(now.obstacles.iter().any(|obstacle| obstacle.id == 2));
        wait_status(&connection, |status| status.silent_obstacle_source == 0);
    }
    ask_for(&connection, RequestKind::Home);
}

/// A record of the newest daemon with so many obstacles, and these.
fn record_with(daemon: &Daemon, count: u32) -> (Telemetry, Vec<Obstacle>) {
    let mut telemetry = daemon.connect().telemetry().unwrap();
    let record = wait_record(&mut telemetry, |record| {
        record.mode != Mode::Starting.code() && record.obstacle_count == count
    });
    let known = record.obstacles[..count as usize].to_vec();
    (record, known)
}

fn kept_file(daemon: &Daemon) -> PathBuf {
    let lock = daemon.place().location().lock_file(ROBOT);
    lock.with_extension("obstacles")
}

#[test]
fn obstacles_without_a_lifetime_outlive_the_daemon_until_they_are_removed() {
    let mut daemon = Daemon::start(STALL_TOLERANT);
    let add = |daemon: &Daemon, options: &str, known: &str| {
        let line = format!("cdcrctl obstacle add {options}");
        daemon.place().checked(&line, 0, &[known]);
    };
    let goto = |daemon: &Daemon, status: i32, parts: &[&str]| {
        let line = "cdcrctl goto 0.1,0,0.85 --speed 0.2 --acceleration 2";
        daemon.place().checked(line, status, parts);
    };
    add(&daemon, "--id 1 --at 0.1,0,0.85 --radius 0.03", "1 known");
    let moves = "--at 0.5,0,0.6 --to 0.5,0.3,0.6 --radius 0.01 --velocity 0.001,0,0";
    add(&daemon, &format!("--id 2 {moves}"), "2 known");
    add(
        &daemon,
        "--id 3 --at 0.5,0.5,0.5 --radius 0.01 --lifetime 24h",
        "3 known",
    );
    goto(&daemon, 1, &["obstacle"]);
    let (before, known) = record_with(&daemon, 3);
    for is_killed in [true, false] {
        if is_killed {
            daemon.kill();
        } else {
            assert!(daemon.stop().success(), "{}", daemon.log());
        }
        daemon.restart();
        let kept = "2 obstacles of the previous daemon are kept; `cdcrctl obstacle clear`";
        assert!(daemon.log().contains(kept), "{}", daemon.log());
        let (now, found) = record_with(&daemon, 2);
        assert_eq!(found[0].start_m, known[0].start_m);
        let moved_m = found[1].start_m[0] - known[1].start_m[0];
        let expected_m = (now.release_ns - before.release_ns) as f64 * 1e-9 * 0.001;
        assert!(
            (moved_m - expected_m).abs() < 1e-12,
            "{moved_m} m, {expected_m} m"
        );
        goto(&daemon, 1, &["obstacle"]);
    }
    daemon
        .place()
        .checked("cdcrctl obstacle remove 1", 0, &["1 known"]);
    daemon.kill();
    daemon.restart();
    assert_eq!(record_with(&daemon, 1).1[0].id, 2);
    daemon
        .place()
        .checked("cdcrctl obstacle clear", 0, &["0 known"]);
    daemon.kill();
    daemon.restart();
    record_with(&daemon, 0);
    goto(&daemon, 0, &[]);
    assert!(daemon.stop().success(), "{}", daemon.log());
    assert!(!kept_file(&daemon).exists(), "nothing is left to keep");
}

#[test]
fn a_daemon_that_cannot_read_the_obstacles_before_it_begins_stopped() {
    let mut daemon = Daemon::start(STALL_TOLERANT);
    let add = "cdcrctl obstacle add --id 1 --at 0.5,0,0.5 --radius 0.03";
    daemon.place().checked(add, 0, &["1 known"]);
    daemon.kill();
    std::fs::write(kept_file(&daemon), "of another version").unwrap();
    // It stays stopped for a later daemon, too, although that finds a file that it can read.
    for is_first in [true, false] {
        daemon.restart();
        let (stopped, _) = record_with(&daemon, 0);
        let expected = (Mode::Stopped.code(), Reason::ObstaclesLost.code());
        assert_eq!((stopped.mode, stopped.reason), expected);
        let lost = "the obstacles of the previous daemon are lost: another version";
        assert_eq!(daemon.log().contains(lost), is_first, "{}", daemon.log());
        daemon.kill();
    }
    daemon.restart();
    daemon.place().checked(add, 0, &["1 known"]);
    daemon.place().checked("cdcrctl reset", 0, &[]);
    daemon.kill();
    daemon.restart();
    assert_eq!(record_with(&daemon, 1).0.mode, Mode::Holding.code());
}
