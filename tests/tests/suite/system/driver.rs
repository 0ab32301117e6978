//! A driver process on the measurement and command services, simulated by the test.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use cdcr_client::{
    Connection, FeedError, FeedEvent, Line, TelemetryStream, TipSensor, monotonic_ns,
    section_lengths_m,
};
use cdcr_controller::plant::{Flaws, RobotPreset};
use cdcr_controller::robot::Configuration;
use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::{
    Interface, MeasurementState, Mode, Outcome, Reason, ReferenceState, RequestKind,
};
use cdcr_tests::record::robot_of;
use cdcr_tests::robot::DrivenRobot;
use cdcr_tests::{
    Daemon, Program, TIMEOUT, ask_for, paper_line, refused, text, tracked, until_undisturbed,
    wait_record, wait_status, wait_until,
};

use super::freeze;

/// Timeouts long enough that a stalled machine loses no measurement or command. Short enough that a robot
/// that continues at its largest rates without measurements stays within its limits.
const CONFIGURATION: &str = "[link]\nkind = \"driver\"\nmeasurement_timeout_ms = 2000.0\ncommand_valid_ms = 1000.0\n\
    [cycle]\nmiss_limit = 1000000\n[reference]\nlease_ms = 60000.0\n";

/// Offset of the measured tip from the position given by the bends.
const OFFSET_M: f64 = 0.02;

/// A robot that runs on this thread.
struct Robot(DrivenRobot);

impl Robot {
    fn new(connection: &Connection) -> Self {
        Self(DrivenRobot::new(connection, Interface::Velocity, [0.0; 12]))
    }

    /// A robot that its daemon holds, and its telemetry.
    fn held(connection: &Connection) -> (Self, TelemetryStream) {
        let (mut robot, mut telemetry) = (Self::new(connection), connection.telemetry().unwrap());
        robot.run_until(|| wait_record(&mut telemetry, |_| true).mode == Mode::Holding.code());
        (robot, telemetry)
    }

    fn turn(&mut self) {
        self.0.turn();
        std::thread::sleep(Duration::from_millis(2));
    }

    fn run_until(&mut self, mut done: impl FnMut() -> bool) {
        let begin = Instant::now();
        while !done() {
            assert!(begin.elapsed() < TIMEOUT, "it did not happen");
            self.turn();
        }
    }
}

#[test]
fn a_driver_is_commanded_along_the_reference() {
    let line = paper_line(0.5);
    let moved = until_undisturbed("a line is tracked", || {
        let daemon = Daemon::start(CONFIGURATION);
        let connection = daemon.connect();
        let feeding = daemon.connect();
        let mut robot = Robot::held(&connection).0;
        let mut moved = 0.0_f64;
        let report = feeding.feed(&line, tracked()).unwrap().run(|_| {
            robot.turn();
            let bends = robot.0.bend_rad();
            moved = bends.iter().fold(moved, |most, bend| bend.abs().max(most));
            ControlFlow::Continue(())
        });
        match report {
            Err(FeedError::LeftTracking { reason, .. }) if reason == Reason::InputsStale.text() => {
                None
            }
            report => report
                .map(|report| report.tracked.then_some(moved))
                .unwrap(),
        }
    });
    assert!(moved > 0.01, "the robot was moved by {moved} rad");
}

#[test]
fn a_fault_while_tracking_ends_the_feed_with_its_cause() {
    let daemon = Daemon::start(CONFIGURATION);
    let connection = daemon.connect();
    let feeding = daemon.connect();
    let mut robot = Robot::held(&connection).0;

    let line = Line {
        duration_s: 60.0,
        velocity_m_s: [0.001, 0.0, -0.001],
        ..Line::for_sections(&[0.3; 3])
    };
    let mut tracking = false;
    let error = feeding
        .feed(&line, tracked())
        .unwrap()
        .run(|event| {
            if let FeedEvent::Progress(progress) = event {
                tracking |= progress.tracking;
            }
            // The driver dies as soon as its robot moves.
            if !tracking {
                robot.turn();
            }
            ControlFlow::Continue(())
        })
        .expect_err("the driver is dead");
    let message = error.to_string();
    assert!(
        message.contains("faulted because the measurement is lost")
            && message.contains("Check that the driver runs"),
        "{message}"
    );
    let status = wait_status(&connection, |status| status.lease_holder == 0);
    assert_eq!(status.mode, Mode::Faulted.code());
}

/// A velocity driver that has not measured yet, beside the driver: in its first second it follows no command for the driver,
/// because it may be about to measure another robot. Later it counts as one that measures nothing, and follows.
#[test]
fn a_driver_follows_no_foreign_command_in_its_first_second() {
    let daemon = Daemon::start(CONFIGURATION);
    let connection = daemon.connect();
    let (mut robot, _) = Robot::held(&connection);
    let mut commands = connection.commands().unwrap();
    until_undisturbed("foreign commands in the first second", || {
        let beside = daemon.connect();
        let opening = Instant::now();
        let mut other = beside.driver(Interface::Velocity).unwrap();
        let (mut foreign, mut early) = (0, 0);
        robot.run_until(|| {
            while let Some(command) = commands.try_next().unwrap() {
                assert_ne!(command.driver_id, 0);
                foreign += 1;
            }
            let update = other.update().unwrap();
            assert_eq!(update.refused, None);
            // After a stall, the second may be over.
            if opening.elapsed() < Duration::from_secs(1) {
                assert_eq!(update.command, None, "after {foreign} foreign commands");
                early = foreign;
            }
            update.command.is_some()
        });
        (early > 20).then_some(())
    });
}

#[test]
fn no_command_comes_before_the_first_measurement() {
    let daemon = Daemon::start(CONFIGURATION);
    let connection = daemon.connect();
    let mut commands = connection.commands().unwrap();
    let mut telemetry = connection.telemetry().unwrap();
    let first = wait_record(&mut telemetry, |_| true).cycle;
    wait_record(&mut telemetry, |record| record.cycle > first + 20);
    assert_eq!(
        commands.try_next().unwrap(),
        None,
        "nobody knows where the robot is"
    );
    // A stop before that is accepted, and is not a fault; a reset has to wait.
    ask_for(&connection, RequestKind::Stop);
    refused(&connection, RequestKind::Reset);
    assert_eq!(connection.status(TIMEOUT).unwrap().faults, 0);
    let mut robot = Robot::new(&connection);
    robot.run_until(|| commands.try_next().unwrap().is_some());
    ask_for(&connection, RequestKind::Reset);
}

#[test]
fn home_is_reached_with_noisy_sensors() {
    let daemon = Daemon::start(CONFIGURATION);
    let connection = daemon.connect();
    let mut telemetry = connection.telemetry().unwrap();
    let mut bends = [0.0; 12];
    bends[..3].copy_from_slice(&[0.2, -0.1, 0.05]);
    let flaws = Flaws {
        noise_m: 5e-5,
        ..RobotPreset::Laboratory.flaws()
    };
    let robot = DrivenRobot::with_flaws(&connection, Interface::Velocity, bends, flaws);
    let mut robot = Robot(robot);
    robot.run_until(|| connection.request(RequestKind::Home).is_ok());
    let mut reached = None;
    robot.run_until(|| {
        while let Some(record) = telemetry.try_next().unwrap() {
            if record.reason == Reason::HomeReached.code() {
                reached = Some(record);
            }
        }
        reached.is_some()
    });
    let bends = reached.unwrap().bend_rad;
    assert!(bends.iter().all(|bend| bend.abs() < 0.02), "{bends:?}");
}

#[test]
fn a_machine_that_stands_still_is_not_the_drivers_fault() {
    // A third of the time for which the daemon is stopped.
    let timeout = Duration::from_millis(500);
    let configuration = CONFIGURATION
        .replace("= 2000.0", "= 500.0")
        .replace("= 1000000", "= 40");
    let daemon = Daemon::start(&configuration);
    let connection = daemon.connect();
    let (mut robot, mut telemetry) = Robot::held(&connection);
    let ending = AtomicBool::new(false);
    let (mut last, mut silent) = (Instant::now(), Duration::ZERO);
    std::thread::scope(|scope| {
        let daemon = &daemon;
        scope.spawn(|| {
            freeze(daemon, 3 * timeout);
            std::thread::sleep(Duration::from_millis(300));
            ending.store(true, Ordering::Relaxed);
        });
        // The driver measures all the time.
        robot.run_until(|| {
            silent = silent.max(last.elapsed());
            last = Instant::now();
            ending.load(Ordering::Relaxed)
        });
    });
    let record = wait_record(&mut telemetry, |record| record.mode != Mode::Holding.code());
    let (mode, reason) = (record.mode, record.reason);
    // Unless the driver itself was delayed for so long.
    assert!(
        (mode, reason) == (Mode::Stopped.code(), Reason::DeadlineMisses.code())
            || silent > timeout / 2,
        "{mode}, {reason}; the driver was silent for {silent:?}"
    );
}

#[test]
fn a_driver_of_the_other_interface_is_refused_and_moves_nothing() {
    let daemon = Daemon::start(CONFIGURATION);
    let connection = daemon.connect();
    let bends = core::array::from_fn(|i| if i == 0 { 0.5 } else { 0.0 });
    let mut robot = DrivenRobot::new(&connection, Interface::Position, bends);
    let stood = robot.bend_rad();
    let code = Outcome::WrongInterface.code() as usize;
    wait_until("it is refused", || {
        robot.turn();
        connection.status(TIMEOUT).unwrap().outcomes[code] > 0
    });
    let status = connection.status(TIMEOUT).unwrap();
    assert_eq!(status.mode, Mode::Starting.code());
    assert_eq!(robot.bend_rad(), stood);
    // Once, however many messages there are.
    let line = format!("refused a message: {}", Outcome::WrongInterface.text());
    wait_until("the log says it", || daemon.log().contains(&line));
    for _ in 0..100 {
        robot.turn();
    }
    let log = daemon.log();
    assert_eq!(log.matches(&line).count(), 1, "{log}");
}

#[test]
fn a_tip_sensor_is_a_sender_of_its_own_beside_the_driver() {
    let separate = CONFIGURATION.replace("[link]\n", "[link]\ntip_sensor = \"separate\"\n");
    let daemon = Daemon::start(&separate);
    let (connection, beside, other) = (daemon.connect(), daemon.connect(), daemon.connect());
    let mut telemetry = connection.telemetry().unwrap();
    let length_m: f64 = section_lengths_m(&connection.status(TIMEOUT).unwrap().robot)
        .iter()
        .sum();
    let (sensor, second) = (beside.tip_sensor().unwrap(), other.tip_sensor().unwrap());
    let mut sent = 0_u32;
    // Each position differs from the previous one in its bits.
    let mut sense = |sensor: &TipSensor, x_m: f64| {
        sent += 1;
        let position_m = [x_m, 0.0, length_m + f64::from(sent % 7) * 1e-6];
        sensor.send(monotonic_ns(), position_m).unwrap();
    };
    // The tip alone does not determine the configuration.
    let mut seen = 0;
    wait_until("tips are seen", || {
        sense(&sensor, OFFSET_M);
        while let Some(record) = telemetry.try_next().unwrap() {
            assert_eq!(record.mode, Mode::Starting.code());
            seen += u32::from(record.tip_state == MeasurementState::Used.code());
        }
        seen > 10
    });
    let mut robot = Robot::new(&connection);
    // Another sensor with other values is rejected; the offset of the first one remains.
    let (mut newest, mut steady) = (None, 0);
    robot.run_until(|| {
        sense(&sensor, OFFSET_M);
        sense(&second, -OFFSET_M);
        while let Some(record) = telemetry.try_next().unwrap() {
            let missed_m = (record.tip_offset_m[0] - OFFSET_M).abs();
            // The encoders have an offset of 0.1 mm: 3 mm at the tip.
            let is_steady = record.mode == Mode::Holding.code() && missed_m < OFFSET_M / 4.0;
            steady = if is_steady { steady + 1 } else { 0 };
            newest = Some(record);
        }
        steady > 100
    });
    let code = Outcome::OtherDriver.code() as usize;
    wait_status(&connection, |status| status.outcomes[code] > 0);
    // The robot continues without a tip sensor.
    let offset_m = newest.unwrap().tip_offset_m;
    let begin_ns = monotonic_ns();
    robot.run_until(|| {
        while let Some(record) = telemetry.try_next().unwrap() {
            newest = Some(record);
        }
        newest.is_some_and(|record| {
            record.release_ns > begin_ns + 500_000_000
                && record.tip_state == MeasurementState::Repeated.code()
        })
    });
    let silent = newest.unwrap();
    assert_eq!(silent.mode, Mode::Holding.code());
    assert!((silent.tip_offset_m[0] - offset_m[0]).abs() < OFFSET_M / 10.0);
    robot.run_until(|| daemon.log().contains("no tip measurement for 1000 ms"));
    let measured_ns = connection.status(TIMEOUT).unwrap().tip_measured_ns;
    assert!(0 < measured_ns && measured_ns <= begin_ns);
    robot.run_until(|| {
        sense(&sensor, OFFSET_M);
        daemon.log().contains("the tip sensor measures regularly")
    });
    // Only the log and the telemetry show a tip that is rejected.
    robot.run_until(|| {
        sense(&sensor, 0.3);
        daemon.log().contains("the measured tip is not used")
    });
}

/// A camera with another clock measures nothing that counts: the tip is the model's, and a person has to know it.
#[test]
fn a_tip_sensor_of_which_nothing_is_accepted_is_named_with_its_refusals() {
    let separate = CONFIGURATION.replace("[link]\n", "[link]\ntip_sensor = \"separate\"\n");
    let daemon = Daemon::start(&separate);
    let (connection, beside) = (daemon.connect(), daemon.connect());
    let sensor = beside.tip_sensor().unwrap();
    let (mut robot, _telemetry) = Robot::held(&connection);
    robot.run_until(|| {
        let wall_clock_ns = monotonic_ns() + 1_000_000_000_000_000_000;
        sensor.send(wall_clock_ns, [0.0, 0.0, 0.3]).unwrap();
        daemon.log().contains("no tip measurement accepted yet")
    });
    let in_the_future = Outcome::InTheFuture;
    assert!(daemon.log().contains(in_the_future.text()));
    let status = connection.status(TIMEOUT).unwrap();
    assert_eq!((status.has_tip_sensor, status.tip_measured_ns), (1, 0));
    assert_eq!(status.tip_refused_by, in_the_future.code());
    assert!(status.tips_refused > 0 && status.since_reset.tips_not_used > 0);
    let printed = until_undisturbed("a reference is tracked without a tip", || {
        let line = "cdcrctl ref circle --duration 10s --lead 1s --max-error 1m --track";
        let mut feed = daemon.place().start(line);
        robot.run_until(|| !feed.runs());
        let printed = text(&feed.output());
        (!printed.contains(Reason::InputsStale.text())).then_some(printed)
    });
    // At its start, which may be long ago, and at its end.
    for part in [
        "warning: no tip measurement accepted yet",
        "tip error by the model: mean ",
        "all errors are by the model: no tip measurement accepted yet; ",
    ] {
        assert!(printed.contains(part), "{part}: {printed}");
    }
}

/// The estimate goes on with the last offset, so its errors are small whatever the tip does: a person has to know it.
#[test]
fn a_tip_sensor_that_falls_silent_on_the_way_makes_the_errors_those_of_the_model() {
    let what = "a reference is tracked to its end without its tip sensor";
    let printed = until_undisturbed(what, tracked_while_the_tip_sensor_falls_silent);
    for part in [
        "tip error by the model (the measured tip was not in use for ",
        "the tip sensor was silent for up to ",
        "also the final one (tip sensor silent for ",
        "check the tip sensor",
        "--max-error was decided by the model for ",
        // At the time when it falls silent.
        "warning: the tip sensor is silent",
    ] {
        assert!(printed.contains(part), "{part}: {printed}");
    }
}

/// What `ref` prints; `None`: the machine stalled.
fn tracked_while_the_tip_sensor_falls_silent() -> Option<String> {
    let separate = CONFIGURATION.replace("[link]\n", "[link]\ntip_sensor = \"separate\"\n");
    let daemon = Daemon::start(&separate);
    let (connection, beside) = (daemon.connect(), daemon.connect());
    let sensor = beside.tip_sensor().unwrap();
    let mut robot = Robot::new(&connection);
    let model = robot_of(&connection.status(TIMEOUT).unwrap().robot);
    let mut sent = 0_u32;
    let mut sense = |robot: &mut Robot| {
        sent += 1;
        let noise_m = f64::from(sent % 7) * 1e-5;
        let bends = robot.0.bend_rad();
        let bends = Configuration::from_slice(&bends[..model.coordinate_count()]).unwrap();
        let mut tip_m: [f64; 3] = model.tip_position(&bends).into();
        tip_m[0] += OFFSET_M / 4.0 + noise_m;
        sensor.send(monotonic_ns(), tip_m).unwrap();
        robot.turn();
    };
    let mut telemetry = connection.telemetry().unwrap();
    let mut sense_until = |robot: &mut Robot, is_it: &dyn Fn(&Telemetry) -> bool| {
        let begin = Instant::now();
        let mut is_done = false;
        while !is_done {
            assert!(begin.elapsed() < TIMEOUT, "it did not happen");
            sense(robot);
            while let Some(record) = telemetry.try_next().unwrap() {
                is_done |= is_it(&record);
            }
        }
    };
    sense_until(&mut robot, &|record| {
        record.mode == Mode::Holding.code() && record.tip_offset_m[0] > OFFSET_M / 8.0
    });
    let line = "ref circle --duration 10s --lead 1s --max-error 1m --track";
    let mut command = daemon.place().command("cdcrctl");
    let mut feed = Program::start(command.args(line.split(' ')));
    sense_until(&mut robot, &|record| {
        let is_approach = record.approach.duration_ns.max(record.approach.joining_ns) > 0;
        let is_inside = record.reference.state == ReferenceState::Inside.code();
        record.mode == Mode::Tracking.code() && is_inside && !is_approach
    });
    robot.run_until(|| !feed.runs());
    let output = feed.output();
    if text(&output).contains(Reason::InputsStale.text()) {
        return None;
    }
    assert!(output.status.success(), "{output:?}");
    Some(text(&output))
}
