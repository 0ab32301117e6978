//! A stop in each mode, beside each thing that could keep it out, with and without floods: accepted and at rest within
//! the cycles of the ramp, or an error that is true; never a success that is not.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use cdcr_client::Connection;
use cdcr_shared_types::Obstacle;
use cdcr_shared_types::codes::{Mode, RequestKind};
use cdcr_tests::load::{Done, flood_obstacles, flood_references};
use cdcr_tests::{Daemon, EndWhenDropped, Place, wait_status, wait_until};

use super::access::Crowd;
use crate::faults::reference::track;
use crate::faults::threads::Hung;
use crate::faults::trail::{Trail, assert_ramps_to_rest, is, rests};

/// Modes that one daemon is brought to one after the other.
const MODES: [Mode; 4] = [Mode::Holding, Mode::Tracking, Mode::Homing, Mode::Stopped];

/// What could keep a stop out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Beside {
    Nothing,
    Crowd,
    HungSupervisor,
}

/// Slow enough that a robot still moves when the stop arrives.
const CONFIGURATION: &str = "[cycle]\nmiss_limit = 1000000\nwatchdog_ms = 20000.0\n\
    [reference]\nlease_ms = 60000.0\n[motion]\nhome_rate_rad_s = 0.1\n\
    [link]\ninitial_bend_rad = [[0.8, 0.0], [0.0, 0.0], [0.0, 0.0]]\n";

/// A ball in the body of the robot: a fault.
fn ball() -> Obstacle {
    Obstacle {
        id: 63,
        start_m: [0.0, 0.0, 0.02],
        end_m: [0.0, 0.0, 0.02],
        radius_m: 0.02,
        measured_ns: cdcr_client::monotonic_ns(),
        ..Obstacle::default()
    }
}

/// Brings a daemon that holds into `mode`, and stops it there.
fn stop_in(
    daemon: &Daemon,
    connection: &Connection,
    trail: &mut Trail,
    mode: Mode,
    beside: Beside,
) {
    let feeding = match mode {
        Mode::Tracking => Some(track(connection, 100, 40)),
        _ => None,
    };
    match mode {
        Mode::Homing => drop(connection.request(RequestKind::Home).unwrap()),
        Mode::Stopped => drop(connection.request(RequestKind::Stop).unwrap()),
        _ => {}
    }
    trail.until("the mode", is(mode));
    if mode == Mode::Homing {
        trail.until("moving", |record| !rests(record));
    }
    let hung = (beside == Beside::HungSupervisor).then(|| Hung::new(daemon.id(), "cdcrd"));
    if let Some(None) = hung {
        return;
    }
    let begin = Instant::now();
    println!("{mode:?} beside {beside:?}");
    let goal = if mode == Mode::Faulted {
        Mode::Faulted
    } else {
        Mode::Stopped
    };
    let parts = format!("the daemon is {}", goal.text());
    let printed = daemon.place().says("cdcrctl stop", 0, &[&parts]);
    println!("  took {:?}", begin.elapsed());
    assert_rests_from(trail, accepted_in(&printed), goal);
    drop(hung);
    drop(feeding);
    if mode != Mode::Faulted {
        connection.request(RequestKind::Reset).unwrap();
        trail.until("holding", is(Mode::Holding));
    }
}

/// The cycle that a client says its request was accepted in.
fn accepted_in(printed: &str) -> u64 {
    let (_, cycle) = printed.split_once("accepted in cycle ").unwrap();
    cycle.split(',').next().unwrap().parse().unwrap()
}

/// From the cycle of the answer on the mode is `goal`, and the rates ramp to zero.
fn assert_rests_from(trail: &mut Trail, cycle: u64, goal: Mode) {
    let (_, first) = trail.until("the cycle of the answer", |record| record.cycle >= cycle);
    assert_eq!(first.mode, goal.code(), "cycle {} of {cycle}", first.cycle);
    assert_ramps_to_rest(trail, &first, || {});
    for _ in 0..20 {
        let (_, later) = trail.until("later", |_| true);
        assert!(rests(&later) && later.mode == goal.code());
    }
}

fn run(beside: Beside, floods: bool) {
    stop_one_daemon(&MODES, beside, floods);
    stop_one_daemon(&[Mode::Faulted], beside, floods);
}

fn stop_one_daemon(modes: &[Mode], beside: Beside, floods: bool) {
    let daemon = Daemon::start(CONFIGURATION);
    let connection = daemon.connect();
    if modes == [Mode::Faulted] {
        // Before the floods, whose own obstacles may take all the room.
        let obstacles = connection.obstacle_sender().unwrap();
        obstacles.upsert(&[ball()]).unwrap();
        wait_status(&connection, |status| status.mode == Mode::Faulted.code());
    }
    let ending = AtomicBool::new(false);
    let done = Done::default();
    let place: &Place = daemon.place();
    std::thread::scope(|scope| {
        if floods {
            scope.spawn(|| flood_references(place, &ending, &done));
            scope.spawn(|| flood_obstacles(place, &ending, &done));
        }
        let _ends = EndWhenDropped(&ending);
        wait_until("the floods begin", || {
            !floods || done.updates.load(Ordering::Relaxed) > 0
        });
        connection.prepare_requests().unwrap();
        // It takes long to come, beside floods.
        let _crowd = (beside == Beside::Crowd).then(|| Crowd::of(place.location()));
        let mut trail = Trail::new(&connection);
        for mode in modes {
            stop_in(&daemon, &connection, &mut trail, *mode, beside);
        }
    });
}

#[test]
fn a_stop_in_each_mode_is_carried_out() {
    run(Beside::Nothing, false);
}

#[test]
fn a_stop_in_each_mode_is_carried_out_beside_floods() {
    run(Beside::Nothing, true);
}

#[test]
fn a_stop_in_each_mode_is_carried_out_beside_a_crowd_that_floods() {
    run(Beside::Crowd, true);
}

#[test]
fn a_stop_in_each_mode_is_carried_out_while_the_supervisor_hangs() {
    run(Beside::HungSupervisor, false);
    run(Beside::HungSupervisor, true);
}
