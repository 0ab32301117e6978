//! Faults of drivers: a killed driver, and two at once.

use std::process::Output;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use cdcr_client::model::robot_of;
use cdcr_client::{CommandRefusal, Connection, monotonic_ns};
use cdcr_controller::plant::{Flaws, RobotPreset};
use cdcr_controller::robot::Configuration;
use cdcr_shared_types::codes::{Interface, MeasurementState, Mode, Outcome, Reason, RequestKind};
use cdcr_shared_types::{Status, Telemetry};
use cdcr_tests::driver::DriverProcess;
use cdcr_tests::record::largest;
use cdcr_tests::{
    Daemon, EndWhenDropped, Place, TIMEOUT, ask_for, load, refused, reset_here, text,
    until_undisturbed, wait_for, wait_status, wait_until,
};
use rustix::process::Signal;

use super::measurement::{SENSED_RAD, assert_lost, daemon, go_home, state};
use super::robot::{Robot, behind_both};
use super::trail::{Trail, is, unless_kept};

/// Measurement of the other driver.
const OTHER_RAD: [f64; 12] = [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];

#[test]
fn a_killed_driver_is_a_lost_measurement() {
    behind_both(|interface| {
        let daemon = daemon(interface);
        let connection = daemon.connect();
        let mut trail = Trail::new(&connection);
        let driver = DriverProcess::start_at(daemon.place(), 1.0);
        trail.until("holding", is(Mode::Holding));
        go_home(&connection, &mut trail, || {})?;
        driver.signal(Signal::KILL);
        drop(driver);
        assert_lost(&mut trail, "driver killed", || {});
        // Another driver takes its place.
        let _driver = DriverProcess::start_at(daemon.place(), 1.0);
        trail.until("measured", |record| state(record) == MeasurementState::Used);
        // Its robot is not where the first one was left.
        reset_here(&connection);
        trail.until("holding", is(Mode::Holding));
        Some(())
    });
}

/// A position driver hangs while the robot is sent home, until `mode`. When it goes on, the motors stay where they are,
/// also while a reset moves the commanded position to them.
fn stays_after_a_hang(mode: Mode) -> Option<()> {
    let daemon = daemon(Interface::Position);
    let connection = daemon.connect();
    let mut trail = Trail::new(&connection);
    let driver = DriverProcess::start_at(daemon.place(), 1.0);
    trail.until("holding", is(Mode::Holding));
    go_home(&connection, &mut trail, || {})?;
    driver.signal(Signal::STOP);
    let (_, hung) = trail.until("the driver is silent", |record| {
        state(record) != MeasurementState::Used
    });
    let commanded_rad = |record: &Telemetry| record.command.bend_target_rad[0];
    let (_, far) = trail.until("the commands are far", |record| {
        commanded_rad(&hung) - commanded_rad(record) > FAR_RAD
    });
    if mode == Mode::Stopped {
        ask_for(&connection, RequestKind::Stop);
    }
    let (_, latched) = trail.until("latched", is(mode));
    driver.signal(Signal::CONT);
    let stays_for = |trail: &mut Trail, what: &str| {
        let mut used = 0;
        trail.until(what, |record| {
            if record.measurement.measured_ns > latched.release_ns {
                used += 1;
                let way_rad = record.measurement.bend_rad[0] - hung.measurement.bend_rad[0];
                assert!(way_rad.abs() < STAYS_RAD, "{what}: moved by {way_rad} rad");
            }
            used > 200
        });
    };
    stays_for(&mut trail, "latched, and the driver goes on");
    ask_for(&connection, RequestKind::Reset);
    stays_for(&mut trail, "the commanded position comes");
    let (_, now) = trail.until("it is there", |record| {
        (commanded_rad(record) - record.measurement.bend_rad[0]).abs() < STAYS_RAD
    });
    assert_eq!(now.mode, Mode::Holding.code());
    assert!(commanded_rad(&now) - commanded_rad(&far) > 0.5 * FAR_RAD);
    Some(())
}

/// Motion in the test during which the driver hangs, and less than half of it \[rad\].
const FAR_RAD: f64 = 0.15;
const STAYS_RAD: f64 = 0.06;

#[test]
fn a_driver_of_positions_that_hung_stays_where_it_stands() {
    for mode in [Mode::Faulted, Mode::Stopped] {
        until_undisturbed("a driver that hangs", || {
            unless_kept(|| stays_after_a_hang(mode))
        });
    }
}

/// Encoders that count from the power-on: the robot rests bent, and the driver that is started again measures it straight.
#[test]
fn a_driver_that_lost_its_zero_is_not_believed_by_a_reset() {
    behind_both(|interface| {
        let daemon = daemon(interface);
        let (connection, place) = (daemon.connect(), daemon.place());
        let mut trail = Trail::new(&connection);
        let driver = DriverProcess::start_at(place, 1.0);
        trail.until("holding", is(Mode::Holding));
        driver.signal(Signal::KILL);
        drop(driver);
        assert_lost(&mut trail, "driver killed", || {});
        let _driver = DriverProcess::start_at(place, 0.0);
        // However long the new driver measures: many times the second in which speeds are forgotten while in control.
        let mut measured_s = 0.0;
        trail.until("measured for 5 s", |record| {
            measured_s += if state(record) == MeasurementState::Used {
                1e-9 * record.period_ns as f64
            } else {
                0.0
            };
            measured_s > 5.0
        });
        let elsewhere = "is measured far from where its last command left it";
        let remedy = "have lost their zero: bring it to straight and set the zero (docs/drivers.md, Zero). Then accept the measured pose: cdcrctl reset --accept-pose.";
        place.checked(
            "cdcrctl status",
            0,
            &["is refused now: the robot ", elsewhere, remedy],
        );
        until_printed(
            place,
            "cdcrctl reset",
            1,
            &[elsewhere, "section 1 by ", remedy],
        );
        until_printed(
            place,
            "cdcrctl reset --wait",
            1,
            &[elsewhere, "section 1 by "],
        );
        assert_eq!(
            refused(&connection, RequestKind::Reset),
            Outcome::PoseDiffers
        );
        trail.catch_up();
        trail.until("it stays faulted", is(Mode::Faulted));
        until_printed(place, "cdcrctl reset --accept-pose", 0, &["accepted"]);
        let accepted =
            "the reset accepted a pose that differs from that of the last command: section 1 by ";
        wait_until("the log names it", || daemon.log().contains(accepted));
        trail.until("holding", is(Mode::Holding));
        // A stop of a robot that rests where it is commanded needs no such word.
        trail.until("control begins", |record| record.control_begins == 0);
        ask_for(&connection, RequestKind::Stop);
        ask_for(&connection, RequestKind::Reset);
        Some(())
    });
}

/// Measures a tip that stays, until `ending`.
fn sense(place: &Place, tip_m: [f64; 3], ending: &AtomicBool) {
    let connection = load::connect(place);
    let sensor = connection.tip_sensor().unwrap();
    while !ending.load(Ordering::Relaxed) {
        sensor.send(monotonic_ns(), tip_m).unwrap();
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Repeats `line` until it ends with `status` and prints `parts`: while the machine holds up the driver's process, its
/// lost measurement is the cause that is named.
fn until_printed(place: &Place, line: &str, status: i32, parts: &[&str]) {
    let run = || place.start(line).output();
    let is_it = |output: &Output| {
        let printed = text(output);
        output.status.code() == Some(status) && parts.iter().all(|part| printed.contains(part))
    };
    wait_for(
        || format!("{line} never printed {parts:?}: {}", text(&run())),
        || Some(run()).filter(is_it),
    );
}

/// A camera that goes on measuring the tip shows that the zero was lost; nobody can accept the pose before it ends.
#[test]
fn a_zero_that_a_tip_sensor_contradicts_is_accepted_by_no_reset() {
    let separate = "[link]\nkind = \"driver\"\ntip_sensor = \"separate\"\nmeasurement_timeout_ms = 500.0\n[cycle]\nmiss_limit = 1000000\n";
    let daemon = Daemon::start(separate);
    let (connection, place) = (daemon.connect(), daemon.place());
    let robot = robot_of(&connection.status(TIMEOUT).unwrap().robot).unwrap();
    let mut bends = vec![0.0; robot.coordinate_count()];
    bends[0] = 1.0;
    let tip_m = robot.tip_position(&Configuration::from_slice(&bends).unwrap());
    let refused_by = |status: &Status, reason: Reason| status.reset_refused_by == reason.code();
    let ending = AtomicBool::new(false);
    // The sensor measures beside all this: a command may take longer than the second for which its tip counts.
    let _driver = std::thread::scope(|scope| {
        let _ends = EndWhenDropped(&ending);
        scope.spawn(|| sense(place, tip_m.into(), &ending));
        let driver = DriverProcess::start_at(place, 1.0);
        wait_status(&connection, |status| status.mode == Mode::Holding.code());
        driver.signal(Signal::KILL);
        drop(driver);
        wait_status(&connection, |status| {
            refused_by(status, Reason::MeasurementLost)
        });
        let driver = DriverProcess::start_at(place, 0.0);
        wait_status(&connection, |status| {
            refused_by(status, Reason::TipElsewhere)
        });
        let elsewhere = "the tip is measured far from where the bends place it";
        let remedy = "end the tip sensor, or let the driver send no tips";
        for line in ["cdcrctl reset", "cdcrctl reset --accept-pose"] {
            until_printed(place, line, 1, &[elsewhere, remedy]);
        }
        until_printed(place, "cdcrctl status", 0, &["mm away", remedy]);
        let error = "error: the daemon is faulted. ";
        place.checked("cdcrctl status --check", 1, &[error]);
        driver
    });
    // The sensor has ended.
    wait_status(&connection, |status| {
        refused_by(status, Reason::PoseDiffers)
    });
    until_printed(place, "cdcrctl reset --accept-pose", 0, &["accepted"]);
    wait_status(&connection, |status| status.mode == Mode::Holding.code());
    place.checked("cdcrctl status --check --format json", 0, &["holding"]);
}

/// The daemon is started again, too: the next one does not know where the last command led, and asks all the same.
#[test]
fn an_uncertain_pose_is_uncertain_for_the_next_daemon() {
    behind_both(|interface| {
        let mut daemon = daemon(interface);
        let differs = |connection: &Connection| {
            wait_status(connection, |status| {
                status.reset_refused_by == Reason::PoseDiffers.code()
            });
        };
        let connection = daemon.connect();
        let mut trail = Trail::new(&connection);
        let driver = DriverProcess::start_at(daemon.place(), 1.0);
        trail.until("holding", is(Mode::Holding));
        driver.signal(Signal::KILL);
        drop(driver);
        assert_lost(&mut trail, "driver killed", || {});
        drop(trail);
        let driver = DriverProcess::start_at(daemon.place(), 0.0);
        differs(&connection);
        drop((driver, connection));
        daemon.kill();
        daemon.restart();
        let _driver = DriverProcess::start_at(daemon.place(), 0.0);
        differs(&daemon.connect());
        let elsewhere = "is measured far from where its last command left it";
        until_printed(daemon.place(), "cdcrctl reset", 1, &[elsewhere]);
        until_printed(
            daemon.place(),
            "cdcrctl reset --accept-pose",
            0,
            &["accepted"],
        );
        let accepted = "that differs from that of the last command of the previous daemon";
        wait_until("the log names it", || daemon.log().contains(accepted));
        Some(())
    });
}

#[test]
fn of_two_drivers_the_second_is_refused_until_the_first_is_lost() {
    behind_both(|interface| {
        let daemon = daemon(interface);
        let (connection, other) = (daemon.connect(), daemon.connect());
        let mut trail = Trail::new(&connection);
        let mut first = Robot::new(&connection, 1.0);
        first.until_held(&mut trail);
        // The other driver measures another robot.
        let mut second = Robot::new(&other, -1.0);
        let mut records = 0;
        trail.until_while(
            "both measure",
            || {
                first.turn();
                second.measure(OTHER_RAD);
                second.follow();
            },
            |record| {
                assert_eq!(record.mode, Mode::Holding.code());
                assert!(
                    (record.bend_rad[0] - 1.0).abs() < SENSED_RAD,
                    "{:?}",
                    record.bend_rad
                );
                records += 1;
                records > 100
            },
        );
        let code = Outcome::OtherDriver.code() as usize;
        wait_status(&connection, |status| status.outcomes[code] > 10);
        // It received every command, and followed none.
        let refusal = second.last_refusal();
        assert!(
            matches!(refusal, Some(CommandRefusal::OtherDriver { .. })),
            "{refusal:?}"
        );
        assert_eq!(second.last_command(), None);
        // The first driver falls silent. This is a fault before the other driver is accepted.
        let measure = || {
            second.measure(OTHER_RAD);
        };
        let (_, now) = trail.until_while("the fault", measure, is(Mode::Faulted));
        assert_eq!(now.reason, Reason::MeasurementLost.code());
        assert!((now.bend_rad[0] - 1.0).abs() < SENSED_RAD);
        trail.until_while("the other has the robot", measure, |record| {
            record.measurement.bend_rad[0].to_bits() == OTHER_RAD[0].to_bits()
        });
        // The commands are for it from now on.
        wait_until("it follows", || {
            second.measure(OTHER_RAD);
            second.follow();
            let is_elsewhere = matches!(
                second.last_refusal(),
                Some(CommandRefusal::Elsewhere { .. })
            );
            // Positions begin where the first robot was, until a reset.
            second.last_command().is_some() || is_elsewhere
        });
        Some(())
    });
}

/// Waits until the robot has been held for `cycles`.
fn hold(trail: &mut Trail, robot: &mut Robot, cycles: u64) {
    let mut held = 0;
    let is_over = |record: &Telemetry| {
        held += u64::from(record.mode == Mode::Holding.code());
        held > cycles
    };
    trail.until_while("held", || robot.turn(), is_over);
}

/// Motors that droop: the commanded position moves to the measured one at each reset, and the motors stay.
#[test]
fn a_robot_that_sags_stays_where_it_is_at_every_reset() {
    let case = || {
        let daemon = daemon(Interface::Position);
        let connection = daemon.connect();
        let sagging = Flaws {
            droop_m: 2e-3,
            ..RobotPreset::Laboratory.flaws()
        };
        let mut trail = Trail::new(&connection);
        let mut robot = Robot::with_flaws(&connection, 1.0, sagging);
        robot.until_held(&mut trail);
        hold(&mut trail, &mut robot, 1000);
        let before_rad = robot.sensed_rad();
        for number in 1..=3 {
            ask_for(&connection, RequestKind::Stop);
            let (_, stopped) = trail.until_while("stopped", || robot.turn(), is(Mode::Stopped));
            let sag_rad = largest(&stopped.following_error_rad);
            reset_here(&connection);
            hold(&mut trail, &mut robot, 400);
            let now_rad = robot.sensed_rad();
            let moved_rad = (0..12).fold(0.0_f64, |most, i| {
                most.max((now_rad[i] - before_rad[i]).abs())
            });
            println!(
                "reset {number}: {sag_rad:.3} rad beside the command, moved by {moved_rad:.4} rad"
            );
            assert!(number > 1 || sag_rad > 0.06, "{sag_rad}");
            assert!(moved_rad < 0.02, "{moved_rad}");
        }
        Some(())
    };
    until_undisturbed("a robot that sags", || unless_kept(case));
}
