//! The end of a daemon: the robot comes to rest, whatever clients request meanwhile.

use std::path::PathBuf;

use cdcr_client::{FeedOptions, Line, RequestError};
use cdcr_shared_types::Command;
use cdcr_shared_types::codes::{Mode, Outcome, RequestKind};
use cdcr_tests::record::largest;
use cdcr_tests::{Daemon, STALL_TOLERANT, ask_for, wait_until};
use rustix::process::Signal;

const ASKED: i32 = 0;
const NOT_AT_REST: i32 = 82;

/// A daemon that homes its robot at `rate_rad_s`, with `deceleration_rad_s2` to rest.
fn moving(rate_rad_s: f64, deceleration_rad_s2: f64) -> Daemon {
    let motion = format!(
        "[motion]\ndeceleration_rad_s2 = {deceleration_rad_s2}\nhome_rate_rad_s = {rate_rad_s}\n"
    );
    // So long a validity that no stall of the machine ends the ramp.
    let bend = "[link]\ncommand_valid_ms = 500.0\ninitial_bend_rad = [[2.0, 0.0], [0.0, -2.0], [1.0, 1.0]]\n";
    let daemon = Daemon::start(&format!("{STALL_TOLERANT}{motion}{bend}"));
    let connection = daemon.connect();
    let mut commands = connection.commands().unwrap();
    ask_for(&connection, RequestKind::Home);
    wait_until("it moves", || {
        commands
            .newest()
            .unwrap()
            .is_some_and(|c| speed(&c) > 0.9 * rate_rad_s)
    });
    daemon
}

fn speed(command: &Command) -> f64 {
    largest(&command.bend_rate_rad_s)
}

#[test]
fn nothing_moves_the_robot_of_a_daemon_that_ends() {
    // A ramp of seconds, so that there is time for requests.
    let mut daemon = moving(0.5, 0.2);
    let (connection, asking) = (daemon.connect(), daemon.connect());
    let mut commands = connection.commands().unwrap();
    let line = Line::for_sections(&[0.3; 3]);
    daemon.signal(Signal::TERM);
    wait_until("the ramp", || {
        let newest = commands.newest().unwrap();
        newest.is_some_and(|command| command.mode == Mode::Stopped.code())
    });
    let mut asked = 0;
    let mut last = f64::INFINITY;
    let mut rests = false;
    for kind in [RequestKind::Reset, RequestKind::Home, RequestKind::Hold]
        .into_iter()
        .cycle()
    {
        match asking.request(kind) {
            Err(RequestError::Refused { outcome, .. }) => {
                assert_eq!(outcome, Outcome::Ending, "{kind:?}");
                asked += 1;
            }
            Err(_) => break,
            Ok(response) => panic!("{kind:?} was accepted: {response:?}"),
        }
        let _ = asking.feed(&line, FeedOptions::default());
        while let Ok(Some(command)) = commands.try_next() {
            assert!(speed(&command) <= last, "it moves faster again");
            last = speed(&command);
            rests = last == 0.0;
        }
        if rests {
            break;
        }
    }
    assert!(asked > 3, "{asked} requests were answered during the ramp");
    let status = daemon.stop_after_signal();
    while let Ok(Some(command)) = commands.try_next() {
        last = speed(&command);
    }
    assert_eq!(
        (status.code(), last),
        (Some(ASKED), 0.0),
        "{}",
        daemon.log()
    );
}

#[test]
fn a_robot_that_cannot_rest_in_time_ends_with_a_status_of_its_own() {
    // After ten seconds it is still moving, and has reached no bend limit.
    let mut daemon = moving(0.3, 0.01);
    daemon.signal(Signal::TERM);
    let status = daemon.stop_after_signal();
    assert_eq!(status.code(), Some(NOT_AT_REST), "{}", daemon.log());
    assert!(daemon.log().contains("motion.deceleration_rad_s2"));
    assert_eq!(daemon.place().memory_files(), Vec::<PathBuf>::new());
}

#[test]
fn the_largest_problem_starts_at_once_and_ends_on_request() {
    let mut daemon = Daemon::start(&format!(
        "{STALL_TOLERANT}[controller]\nhorizon_steps = 50\nswarm_size = 512\nswarm_iterations = 1000\n"
    ));
    let status = daemon.stop();
    assert_eq!(status.code(), Some(ASKED), "{}", daemon.log());
}
