//! A robot behind a driver, simulated by a test.

use std::time::{Duration, Instant};

use cdcr_client::{CommandRefusal, Connection, monotonic_ns};
use cdcr_controller::plant::{Flaws, RobotPreset};
use cdcr_shared_types::codes::{Interface, MeasurementKind, Mode, Reason, RequestKind};
use cdcr_shared_types::{Command, Measurement, Telemetry};
use cdcr_tests::robot::{DrivenRobot, interface_of};
use cdcr_tests::{ask_for, until_undisturbed};

use crate::faults::trail::{Trail, is, rests, unless_kept};

/// Runs a case behind a driver of each interface, again if a stall of the machine disturbed it.
pub(crate) fn behind_both(case: impl Fn(Interface) -> Option<()>) {
    for interface in [Interface::Velocity, Interface::Position] {
        println!("behind a driver that obeys the {interface}");
        let case = || unless_kept(|| case(interface));
        until_undisturbed("a robot behind a driver", case);
    }
}

/// Whether a moving robot holds because of a stall of the machine: its inputs were stale. There is no other
/// cause.
pub(crate) fn is_held_by_a_stall(record: &Telemetry) -> bool {
    let is_held = record.mode == Mode::Holding.code() && record.reason != Reason::Start.code();
    assert!(!is_held || record.reason == Reason::InputsStale.code());
    is_held
}

/// A robot whose driver sends the true measurement or a given one.
pub(crate) struct Robot {
    robot: DrivenRobot,
    measured: Instant,
}

/// Measurement interval of a driver.
const EVERY: Duration = Duration::from_millis(1);

impl Robot {
    /// A straight robot that obeys its daemon's interface, with the first section bent by `bend_rad`.
    pub(crate) fn new(connection: &Connection, bend_rad: f64) -> Self {
        Self::with_flaws(connection, bend_rad, RobotPreset::Laboratory.flaws())
    }

    pub(crate) fn with_flaws(connection: &Connection, bend_rad: f64, flaws: Flaws) -> Self {
        let mut bends = [0.0; 12];
        bends[0] = bend_rad;
        let interface = interface_of(connection);
        Self {
            robot: DrivenRobot::with_flaws(connection, interface, bends, flaws),
            measured: Instant::now(),
        }
    }

    /// A robot that its daemon knows and holds, and its records.
    pub(crate) fn held(connection: &Connection, bend_rad: f64) -> (Trail, Self) {
        let (mut trail, mut robot) = (Trail::new(connection), Self::new(connection, bend_rad));
        robot.until_held(&mut trail);
        (trail, robot)
    }

    /// The same while homing.
    pub(crate) fn moving(connection: &Connection) -> (Trail, Self) {
        let (mut trail, mut robot) = Self::held(connection, 1.0);
        ask_for(connection, RequestKind::Home);
        trail.until_while("moving", || robot.turn(), |record| !rests(record));
        (trail, robot)
    }

    /// Follows the newest command, and measures once a millisecond.
    pub(crate) fn turn(&mut self) {
        self.follow();
        if self.measured.elapsed() >= EVERY {
            self.measured = Instant::now();
            self.robot.measure(MeasurementKind::Configuration);
        }
    }

    /// Follows the newest command.
    pub(crate) fn follow(&mut self) {
        self.robot.follow();
    }

    /// The present values of its sensors \[rad\].
    pub(crate) fn sensed_rad(&mut self) -> [f64; 12] {
        let measurement = self.robot.measurement(MeasurementKind::Configuration);
        measurement.bend_rad
    }

    pub(crate) fn last_command(&self) -> Option<Command> {
        self.robot.last_command()
    }

    pub(crate) fn last_refusal(&self) -> Option<CommandRefusal> {
        self.robot.last_refusal()
    }

    /// Sends a measurement of these bends, and returns its time.
    pub(crate) fn measure(&self, bend_rad: [f64; 12]) -> u64 {
        let measured_ns = monotonic_ns();
        self.measure_at(measured_ns, bend_rad);
        measured_ns
    }

    /// Sends a measurement of these bends at `measured_ns`.
    pub(crate) fn measure_at(&self, measured_ns: u64, bend_rad: [f64; 12]) {
        self.robot.send(&Measurement {
            measured_ns,
            kind: MeasurementKind::Configuration.code(),
            bend_rad,
            ..Measurement::default()
        });
    }

    pub(crate) fn until_held(&mut self, trail: &mut Trail) {
        trail.until_while("holding", || self.turn(), is(Mode::Holding));
    }
}
