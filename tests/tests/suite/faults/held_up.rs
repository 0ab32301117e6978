//! An exchange that is stopped for a while and continues.

use std::time::{Duration, Instant};

use cdcr_client::{CommandStream, Connection, monotonic_ns};
use cdcr_shared_types::Command;
use cdcr_shared_types::codes::{Mode, Reason};
use cdcr_tests::record::largest;
use cdcr_tests::threads::{Hung, find_thread};
use cdcr_tests::{Daemon, TIMEOUT, until_undisturbed, wait_record, wait_until};
use rustix::process::Signal;

use crate::faults::reference::{POINTS_MAX, WINDOW_PERIODS, track};
use crate::faults::robot::Robot;
use crate::faults::threads::VALID_FOR_NS;

/// Stops the exchange for `held_up` while a client renews its lease regularly: the robot follows its
/// reference all the time.
fn assert_follows_while_held_up(lease: Duration, held_up: Duration) {
    let daemon = Daemon::start(&format!(
        "[cycle]\nmiss_limit = 1000000\nwatchdog_ms = 20000.0\n[reference]\nlease_ms = {}.0\n",
        lease.as_millis()
    ));
    let connection = daemon.connect();
    until_undisturbed("the exchange is held up for as long as meant", || {
        follow_while_held_up(&daemon, &connection, lease, held_up)
    });
}

/// `None` when a stall kept the test from stopping the exchange in time, or for the intended time only.
fn follow_while_held_up(
    daemon: &Daemon,
    connection: &Connection,
    lease: Duration,
    held_up: Duration,
) -> Option<()> {
    let feeding = track(connection, POINTS_MAX, 40);
    let mut telemetry = connection.telemetry().unwrap();
    wait_until("it tracks", || {
        let record = telemetry.next_within(TIMEOUT).unwrap();
        record.unwrap().mode == Mode::Tracking.code()
    });
    let renewed_ns = monotonic_ns();
    feeding.lease.renew().unwrap();

    let Some(hung) = Hung::new(daemon.id(), "cdcr-exchange") else {
        return Some(());
    };
    let is_held = monotonic_ns() - renewed_ns < lease.as_nanos() as u64;
    std::thread::sleep(held_up);
    let (end_ns, mut oldest_ns) = (monotonic_ns(), 0);
    drop(hung);
    loop {
        // Of a long stop, some records are lost, because the ring to the exchange is full.
        let record = telemetry.next_within(TIMEOUT).unwrap().unwrap();
        let has_reference = record.cycle <= record.window_first_cycle + WINDOW_PERIODS
            && record.release_ns <= feeding.end_ns;
        if !is_held || !has_reference {
            return None;
        }
        assert_eq!(record.mode, Mode::Tracking.code(), "{}", record.cycle);
        oldest_ns = oldest_ns.max(record.release_ns.saturating_sub(record.gather_ns));
        if record.release_ns > end_ns && record.gather_ns > end_ns {
            break;
        }
    }
    println!("the oldest inputs: {:.1} ms", oldest_ns as f64 * 1e-6);
    (oldest_ns > held_up.as_nanos() as u64 / 2).then_some(())
}

#[test]
fn an_exchange_that_is_held_up_does_not_end_the_reference() {
    assert_follows_while_held_up(Duration::from_secs(60), Duration::from_millis(250));
    // Longer than the samples of the reference, and longer than the lease.
    assert_follows_while_held_up(Duration::from_millis(400), Duration::from_millis(600));
}

/// A daemon with a homing robot, and the commands for its driver.
struct Commanded {
    daemon: Daemon,
    connection: Connection,
    commands: CommandStream,
    robot: Robot,
}

impl Commanded {
    /// The robot moves. Nothing ends the process while a thread is stopped.
    fn moving() -> Self {
        let daemon = Daemon::start(
            "[link]\nkind = \"driver\"\nmeasurement_timeout_ms = 5000.0\ncommand_valid_ms = 100.0\n\
             [motion]\nhome_rate_rad_s = 0.1\n\
             [cycle]\nmiss_limit = 1000000\nwatchdog_ms = 20000.0\n",
        );
        let connection = daemon.connect();
        let commands = connection.commands().unwrap();
        let (_, robot) = Robot::moving(&connection);
        Self {
            daemon,
            connection,
            commands,
            robot,
        }
    }

    /// The robot measures for `duration`, while the exchange receives nothing.
    fn turn_for(&mut self, duration: Duration) {
        let begin = Instant::now();
        while begin.elapsed() < duration {
            self.robot.turn();
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// The pending commands, checked: all are in order, and none that moves the robot had expired when it
    /// left.
    fn commands(&mut self, before: Option<&Command>) -> Vec<Command> {
        let mut commands: Vec<_> = before.copied().into_iter().collect();
        while let Some(command) = self.commands.try_next().unwrap() {
            assert!(
                is_rest(&command) || command.header.sent_ns < command.valid_until_ns,
                "of old: {command:?}"
            );
            if let Some(last) = commands.last() {
                assert!(command.cycle > last.cycle, "{last:?}, then {command:?}");
                assert!(command.header.sequence > last.header.sequence);
            }
            commands.push(command);
        }
        commands
    }
}

fn is_rest(command: &Command) -> bool {
    largest(&command.bend_rate_rad_s) == 0.0
}

#[test]
fn an_exchange_that_was_held_up_sends_the_newest_command_and_no_old_one() {
    let mut it = Commanded::moving();
    let before = *it.commands(None).last().unwrap();
    let Some(hung) = Hung::new(it.daemon.id(), "cdcr-exchange") else {
        return;
    };
    it.turn_for(Duration::from_millis(400));
    // The last command before the stop.
    let before = *it.commands(Some(&before)).last().unwrap();
    let end_ns = monotonic_ns();
    drop(hung);
    let mut commands = vec![before];
    wait_until("commands leave again", || {
        it.robot.turn();
        commands = it.commands(Some(&before));
        commands.len() > 1
    });
    let first = commands[1];
    let held_up_ns = end_ns - before.header.sent_ns;
    println!(
        "held up for {:.0} ms: the first command after it was sent {:.1} ms after its release",
        held_up_ns as f64 * 1e-6,
        (first.header.sent_ns - first.release_ns) as f64 * 1e-6
    );
    // Some forty cycles computed a command; only the last one leaves.
    assert!(first.header.sent_ns >= end_ns);
    assert!(
        first.cycle - before.cycle > 20,
        "{before:?}, then {first:?}"
    );
}

/// Sends SIGTERM after `held_up` of a stop of the exchange.
fn assert_last_command_is_rest(held_up: Duration) {
    let mut it = Commanded::moving();
    let Some(hung) = Hung::new(it.daemon.id(), "cdcr-exchange") else {
        return;
    };
    it.turn_for(held_up);
    let before = *it.commands(None).last().unwrap();
    it.daemon.signal(Signal::TERM);
    // The robot is at rest for the cycle, but no command says so.
    wait_until("the cycle thread ends", || {
        it.robot.turn();
        find_thread(it.daemon.id(), "cdcr-cycle").is_none()
    });
    assert_eq!(it.commands(Some(&before)).len(), 1);
    assert!(!is_rest(&before));
    drop(hung);
    let ended = it.daemon.stop_after_signal();
    let last = *it.commands(Some(&before)).last().unwrap();
    assert!(is_rest(&last), "{last:?}");
    assert_eq!(last.mode, Mode::Stopped.code());
    assert_eq!(ended.code(), Some(0), "{}", it.daemon.log());
    drop(it.connection);
}

#[test]
fn the_last_command_of_a_daemon_that_ends_is_rest_also_when_its_exchange_was_held_up() {
    assert_last_command_is_rest(Duration::from_millis(100));
    // Longer than the room for records.
    assert_last_command_is_rest(Duration::from_millis(800));
}

/// Behind a driver, the cycle uses predictions only as long as a command is valid.
#[test]
fn behind_a_driver_stale_inputs_make_the_robot_hold() {
    let mut it = Commanded::moving();
    let mut telemetry = it.connection.telemetry().unwrap();
    let Some(hung) = Hung::new(it.daemon.id(), "cdcr-exchange") else {
        return;
    };
    it.turn_for(Duration::from_millis(400));
    drop(hung);
    let held = wait_record(&mut telemetry, |record| {
        it.robot.turn();
        record.mode != Mode::Homing.code()
    });
    assert_eq!(
        (held.mode, held.reason),
        (Mode::Holding.code(), Reason::InputsStale.code())
    );
    let oldest_ns = held.release_ns - held.gather_ns;
    println!("inputs stale: held after {:.0} ms", oldest_ns as f64 * 1e-6);
    assert!(oldest_ns > VALID_FOR_NS);
    // Homing does not continue by itself.
    let after = wait_record(&mut telemetry, |record| {
        it.robot.turn();
        record.gather_ns > held.release_ns && record.release_ns > held.release_ns + 100_000_000
    });
    assert_eq!(after.mode, Mode::Holding.code());
}
