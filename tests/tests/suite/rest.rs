//! Rest: behind a driver with offsets of encoders and motors, the command does not creep.
//!
//! A moving robot is brought to rest in each mode that rests, and observed for `CDCR_REST_S` seconds (2 by
//! default). Every command has zero rates and the same positions, to the bit, and the robot stays where it
//! is, also when the daemon is started again.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use cdcr_client::{Connection, TelemetryStream};
use cdcr_shared_types::codes::{Interface, MeasurementKind, Mode, RequestKind};
use cdcr_shared_types::{Command, Location, Telemetry};
use cdcr_tests::record::largest;
use cdcr_tests::robot::DrivenRobot;
use cdcr_tests::{
    Daemon, EndWhenDropped, ROBOT, STALL_TOLERANT, TIMEOUT, ask_for, asked, wait_mode, wait_record,
    wait_until,
};

/// Motors with a lag of 20 ms have reached their target after this many cycles of 5 ms, to `SETTLED_RAD`.
const SETTLED_CYCLES: u64 = 100;
/// Remaining distance of a settled motor \[rad\].
const SETTLED_RAD: f64 = 1e-9;

#[test]
fn a_position_driver_with_offset_and_droop_is_at_rest_when_held() {
    rest(Interface::Position, Mode::Holding);
}

#[test]
fn a_position_driver_with_offset_and_droop_is_at_rest_when_stopped() {
    rest(Interface::Position, Mode::Stopped);
}

#[test]
fn a_position_driver_with_offset_and_droop_is_at_rest_when_faulted() {
    rest(Interface::Position, Mode::Faulted);
}

#[test]
fn a_velocity_driver_with_offset_is_at_rest_in_every_mode() {
    for mode in [Mode::Holding, Mode::Stopped, Mode::Faulted] {
        rest(Interface::Velocity, mode);
    }
}

/// Their driver goes on. The load and the zeros of the encoders, which a daemon begins beside, must not add up.
#[test]
fn a_daemon_that_is_started_again_moves_no_motors_of_positions() {
    for mode in [Mode::Holding, Mode::Stopped] {
        at_rest(Interface::Position, mode, restarted);
    }
}

#[test]
fn a_daemon_that_is_started_again_moves_no_motors_of_speeds() {
    at_rest(Interface::Velocity, Mode::Holding, restarted);
}

/// Duration of each observation.
fn duration() -> Duration {
    Duration::from_secs(asked("CDCR_REST_S").unwrap_or(2))
}

/// Stops a homing robot, and observes its rest.
fn rest(interface: Interface, mode: Mode) {
    at_rest(interface, mode, |_, telemetry, first| {
        let records = assert_constant(telemetry, first);
        println!("{} {mode}: {records} equal commands", interface.text());
    });
}

/// Kills the daemon or ends it, and starts it again.
fn restarted(daemon: &mut Daemon, _: &mut TelemetryStream, first: &Telemetry) {
    for restart in 0..4 {
        match restart % 2 {
            0 => daemon.kill(),
            _ => assert!(daemon.stop().success(), "{}", daemon.log()),
        }
        daemon.restart();
        let connection = daemon.connect();
        let again = settled(
            &mut connection.telemetry().unwrap(),
            Mode::try_from(first.mode).unwrap(),
        );
        assert_ne!(again.header.sender_id, first.header.sender_id);
        // The encoders say something else than the commands of before.
        assert_ne!(bits(&again.command), bits(&first.command));
    }
}

/// Brings a homing robot to rest in this mode, and checks that it stands still during `observe`.
fn at_rest(
    interface: Interface,
    mode: Mode,
    observe: impl FnOnce(&mut Daemon, &mut TelemetryStream, &Telemetry),
) {
    let mut daemon = Daemon::start(&format!(
        "{STALL_TOLERANT}[link]\nkind = \"driver\"\ninterface = \"{}\"\nmeasurement_timeout_ms = 2000.0\n\
         [motion]\nhome_rate_rad_s = 0.2\n",
        interface.text()
    ));
    let robot = RobotThread::default();
    let (answer, bends) = mpsc::channel();
    let location = daemon.place().location().clone();
    std::thread::scope(|scope| {
        let _ends = EndWhenDropped(&robot.ending);
        scope.spawn(|| drive(&location, interface, &robot, &answer));
        let connection = daemon.connect();
        let mut telemetry = connection.telemetry().unwrap();
        wait_mode(&mut telemetry, Mode::Holding);
        ask_for(&connection, RequestKind::Home);
        let homing = wait_mode(&mut telemetry, Mode::Homing);
        wait_record(&mut telemetry, |record| record.cycle > homing.cycle + 40);
        bring_to(mode, &connection, &robot);

        let first = settled(&mut telemetry, mode);
        let bend = || {
            robot.asked.store(true, Ordering::Relaxed);
            bends.recv_timeout(TIMEOUT).unwrap()
        };
        let stood = bend();
        assert!(
            (0.1..1.0).contains(&stood[0]),
            "{stood:?} is not on the way"
        );
        observe(&mut daemon, &mut telemetry, &first);
        let moved: [f64; 12] = core::array::from_fn(|i| bend()[i] - stood[i]);
        assert!(largest(&moved) < SETTLED_RAD, "it moved by {moved:?} rad");
    });
}

fn bring_to(mode: Mode, connection: &Connection, robot: &RobotThread) {
    match mode {
        Mode::Holding => drop(ask_for(connection, RequestKind::Hold)),
        Mode::Stopped => drop(ask_for(connection, RequestKind::Stop)),
        _ => {
            // A faulty sensor, until the fault is detected.
            robot.is_mad.store(true, Ordering::Relaxed);
            wait_until("the fault", || {
                connection.status(TIMEOUT).unwrap().mode == Mode::Faulted.code()
            });
            robot.is_mad.store(false, Ordering::Relaxed);
        }
    }
}

/// The first record at rest with settled motors and sensors.
fn settled(telemetry: &mut TelemetryStream, mode: Mode) -> Telemetry {
    let still = |record: &Telemetry| {
        record.mode == mode.code() && largest(&record.command.bend_rate_rad_s) == 0.0
    };
    let first = wait_record(telemetry, still);
    wait_record(telemetry, |record| {
        assert!(still(record), "cycle {} is not at rest", record.cycle);
        record.cycle > first.cycle + SETTLED_CYCLES
    })
}

/// Checks that every command in this time equals that of `first`, and returns their number.
fn assert_constant(telemetry: &mut TelemetryStream, first: &Telemetry) -> u64 {
    let (begin, mut records, duration) = (Instant::now(), 0, duration());
    while begin.elapsed() < duration || records < 100 {
        wait_record(telemetry, |record| {
            assert_eq!(record.mode, first.mode);
            assert_eq!(largest(&record.command.bend_rate_rad_s), 0.0);
            assert_eq!(largest(&record.command.cable_speed_m_s), 0.0);
            assert!(
                bits(&record.command) == bits(&first.command),
                "the command creeps, from {:?} to {:?} rad in cycle {}",
                &first.command.bend_target_rad[..6],
                &record.command.bend_target_rad[..6],
                record.cycle
            );
            records += 1;
            true
        });
    }
    records
}

/// The positions of a command.
fn bits(command: &Command) -> Vec<u64> {
    let positions = command
        .bend_target_rad
        .iter()
        .chain(&command.cable_length_m);
    positions.map(|position| position.to_bits()).collect()
}

/// Requests of the test to the thread of its robot.
#[derive(Debug, Default)]
struct RobotThread {
    ending: AtomicBool,
    is_mad: AtomicBool,
    asked: AtomicBool,
}

/// Runs the robot from a bend of 1 rad on, and returns its true bends.
fn drive(
    location: &Location,
    interface: Interface,
    thread: &RobotThread,
    answer: &mpsc::Sender<[f64; 12]>,
) {
    let connection = Connection::open_within(location, ROBOT, TIMEOUT).unwrap();
    let mut bends = [0.0; 12];
    bends[0] = 1.0;
    let mut robot = DrivenRobot::new(&connection, interface, bends);
    let mut turn = 0_u32;
    while !thread.ending.load(Ordering::Relaxed) {
        turn += 1;
        robot.follow();
        let mut measurement = robot.measurement(MeasurementKind::CableLengths);
        if thread.is_mad.load(Ordering::Relaxed) {
            measurement.cable_length_m[0] += [-0.01, 0.01][turn as usize % 2];
        }
        robot.send(&measurement);
        if thread.asked.swap(false, Ordering::Relaxed) {
            answer.send(robot.bend_rad()).unwrap();
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}
