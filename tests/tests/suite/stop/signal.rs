//! What signals do: SIGUSR1 stops the robot, SIGHUP does not end it.

use cdcr_client::RequestError;
use cdcr_shared_types::codes::{Mode, Reason, RequestKind};
use cdcr_tests::{Daemon, PATIENCE, PATIENT, wait_status, wait_until};
use rustix::process::Signal;

use crate::faults::robot::Robot;
use crate::faults::trail::{Trail, assert_ramps_to_rest, is, rests};

#[test]
fn a_signal_stops_a_moving_robot_and_latches() {
    let daemon = Daemon::start(
        "[link]\nkind = \"driver\"\nmeasurement_timeout_ms = 5000.0\n[cycle]\nmiss_limit = 1000000\n",
    );
    let connection = daemon.connect();
    let (mut trail, mut robot) = (Trail::new(&connection), Robot::new(&connection, 1.0));
    robot.until_held(&mut trail);
    for _ in 0..3 {
        connection.request(RequestKind::Home).unwrap();
        trail.until_while("moving", || robot.turn(), |record| !rests(record));
        daemon.signal(Signal::USR1);
        let (before, stopped) = trail.until_while("stopped", || robot.turn(), is(Mode::Stopped));
        assert_eq!(before.mode, Mode::Homing.code());
        assert_eq!(stopped.reason, Reason::Request.code());
        assert_ramps_to_rest(&mut trail, &stopped, || robot.turn());
        // Once more changes nothing, and nothing but a reset leaves it.
        daemon.signal(Signal::USR1);
        let refused = connection.request(RequestKind::Home);
        assert!(matches!(refused, Err(RequestError::Refused { .. })));
        let (_, later) = trail.until_while("later", || robot.turn(), |_| true);
        assert_eq!(later.mode, Mode::Stopped.code());
        // The second signal has been taken, too, or it would stop the robot again.
        let seen = connection.request(RequestKind::Stop).unwrap().cycle;
        trail.until_while("a cycle later", || robot.turn(), |now| now.cycle > seen);
        connection.request(RequestKind::Reset).unwrap();
        trail.until_while("holding", || robot.turn(), is(Mode::Holding));
    }
}

#[test]
fn a_terminal_that_hangs_up_does_not_end_the_daemon() {
    let mut daemon = Daemon::start(PATIENT);
    let connection = daemon.connect();
    daemon.signal(Signal::HUP);
    wait_until("it says so", || daemon.log().contains("SIGHUP"));
    let before = connection.status(PATIENCE).unwrap();
    let after = wait_status(&connection, |status| status.cycles > before.cycles + 20);
    assert_eq!(after.mode, Mode::Holding.code());
    assert!(daemon.stop().success(), "{}", daemon.log());
}
