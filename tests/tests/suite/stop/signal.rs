//! Signals: SIGUSR1 stops the robot, SIGHUP reloads the configuration.

use std::time::Duration;

use cdcr_client::RequestError;
use cdcr_shared_types::SolverSettings;
use cdcr_shared_types::codes::{Mode, Outcome, Reason, RequestKind};
use cdcr_shared_types::proc_stat::has_bit;
use cdcr_tests::threads::{Hung, find_thread};
use cdcr_tests::{
    Daemon, STALL_TOLERANT, TIMEOUT, ask_for, refused, text, until_undisturbed, wait_status,
    wait_until,
};
use rustix::process::Signal;

use crate::faults::robot::Robot;
use crate::faults::trail::{assert_ramps_to_rest, is, rests};

#[test]
fn a_signal_stops_a_moving_robot_and_latches() {
    let daemon = Daemon::start(
        "[link]\nkind = \"driver\"\nmeasurement_timeout_ms = 5000.0\ncommand_valid_ms = 1000.0\n\
         [cycle]\nmiss_limit = 1000000\n",
    );
    let connection = daemon.connect();
    let (mut trail, mut robot) = Robot::held(&connection, 1.0);
    for _ in 0..3 {
        ask_for(&connection, RequestKind::Home);
        trail.until_while("moving", || robot.turn(), |record| !rests(record));
        daemon.signal(Signal::USR1);
        let (before, stopped) = trail.until_while("stopped", || robot.turn(), is(Mode::Stopped));
        assert_eq!(before.mode, Mode::Homing.code());
        assert_eq!(stopped.reason, Reason::Request.code());
        assert_ramps_to_rest(&mut trail, &stopped, || robot.turn());
        // Another signal changes nothing, and only a reset leaves the mode.
        daemon.signal(Signal::USR1);
        refused(&connection, RequestKind::Home);
        let (_, later) = trail.until_while("later", || robot.turn(), |_| true);
        assert_eq!(later.mode, Mode::Stopped.code());
        // The second signal has been handled, too, or it would stop the robot again.
        let seen = ask_for(&connection, RequestKind::Stop).cycle;
        trail.until_while("a cycle later", || robot.turn(), |now| now.cycle > seen);
        // If a stall delayed the signal, its stop comes in the cycle of the reset.
        wait_until("a reset", || {
            match connection.request_within(RequestKind::Reset, TIMEOUT) {
                Ok(_) => true,
                Err(RequestError::Refused {
                    outcome: Outcome::Overruled,
                    ..
                }) => false,
                Err(error) => panic!("{error}"),
            }
        });
        trail.until_while("holding", || robot.turn(), is(Mode::Holding));
    }
}

/// Any other thread may be kept from its core, for example by a task of higher priority, which would delay
/// the signal.
#[test]
fn only_the_cycle_takes_the_signal() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let cycle = find_thread(daemon.id(), "cdcr-cycle").unwrap();
    let tasks = std::fs::read_dir(format!("/proc/{}/task", daemon.id())).unwrap();
    for task in tasks.flatten().map(|task| task.path()) {
        let status = std::fs::read_to_string(task.join("status")).unwrap();
        let takes = !has_bit(&status, "SigBlk", Signal::USR1.as_raw().cast_unsigned() - 1);
        let is_cycle = task.ends_with(cycle.to_string());
        assert_eq!(takes, is_cycle, "{status}");
    }
}

#[test]
fn a_stop_that_is_answered_after_its_signal_is_confirmed() {
    let daemon = Daemon::start("[cycle]\nmiss_limit = 1000000\nwatchdog_ms = 60000.0\n");
    let connection = daemon.connect();
    until_undisturbed("the exchange hangs for a part of the time", || {
        let Some(hung) = Hung::new(daemon.id(), "cdcr-exchange") else {
            return Some(());
        };
        let mut stop = daemon.place().start("cdcrctl stop");
        // By then it has sent the signal, and repeats its request.
        std::thread::sleep(Duration::from_millis(600));
        let is_asking = stop.runs();
        drop(hung);
        let output = stop.output();
        ask_for(&connection, RequestKind::Reset);
        let printed = text(&output);
        let is_confirmed = output.status.success() && printed.contains("the daemon is stopped");
        assert!(
            is_confirmed || printed.contains("not confirmed"),
            "{printed}"
        );
        (is_asking && is_confirmed).then_some(())
    });
}

#[test]
fn a_terminal_that_hangs_up_does_not_end_the_daemon() {
    let mut daemon = Daemon::start(STALL_TOLERANT);
    let connection = daemon.connect();
    let unset = connection.settings().unwrap();
    let wider = SolverSettings {
        safe_distance_m: 2.0 * unset.safe_distance_m,
        ..unset
    };
    connection.change_settings(wider).unwrap();
    daemon.signal(Signal::HUP);
    wait_until("it says so", || daemon.log().contains("applied keys: none"));
    let before = connection.status(TIMEOUT).unwrap();
    let after = wait_status(&connection, |status| status.cycles > before.cycles + 20);
    assert_eq!(after.mode, Mode::Holding.code());
    assert_eq!(
        connection.settings().unwrap(),
        wider,
        "what a client set stays"
    );
    assert!(daemon.stop().success(), "{}", daemon.log());
}

#[test]
fn a_configuration_that_is_read_again_changes_the_solver_and_a_wrong_one_nothing() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let connection = daemon.connect();
    let before = connection.settings().unwrap();
    let reload = |text: &str, answer: &str| {
        daemon.place().write("robot.toml", text);
        let log_length = daemon.log().len();
        daemon.signal(Signal::HUP);
        wait_until(answer, || {
            daemon
                .log()
                .get(log_length..)
                .is_some_and(|new| new.contains(answer))
        });
    };
    let solver = "[controller]\nhorizon_steps = 7\n";
    reload(
        &format!("{STALL_TOLERANT}{solver}[motion]\nhome_rate_rad_s = 0.25\n"),
        "keys that need a restart: motion.home_rate_rad_s",
    );
    assert_ne!(before.horizon_steps, 7);
    wait_until("it is in force", || {
        connection.settings().unwrap().horizon_steps == 7
    });
    let in_force = connection.settings().unwrap();
    // Line and key, as at the start.
    reload(
        "[controller]\nhorizon_steps = 0\n",
        "robot.toml, line 2: controller.horizon_steps",
    );
    reload(
        "[controller]\nhorizon_steps =\n",
        "robot.toml: TOML parse error at line 2",
    );
    let nearer = "controller.safe_distance_m = 0.001 is below 0.01";
    reload("[controller]\nsafe_distance_m = 0.001\n", nearer);
    assert_eq!(connection.settings().unwrap(), in_force);
    // The original file: the settings of the start.
    reload(STALL_TOLERANT, "applied keys: controller.horizon_steps");
    wait_until("it is in force", || {
        connection.settings().unwrap() == before
    });
}
