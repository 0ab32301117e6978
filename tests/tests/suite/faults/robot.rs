//! A robot behind a driver, played by the test.

use std::time::{Duration, Instant};

use cdcr_client::{Connection, Driver, monotonic_ns};
use cdcr_shared_types::codes::{Interface, MeasurementKind, Mode};
use cdcr_shared_types::{Command, Measurement};

use crate::faults::trail::{Trail, is};

/// A robot that is where it was told to go.
pub(crate) struct Robot {
    driver: Driver,
    pub(crate) bend_rad: [f64; 12],
    pub(crate) last_command: Option<Command>,
    measured: Instant,
}

/// A driver measures this often.
const EVERY: Duration = Duration::from_millis(1);

impl Robot {
    /// A straight robot whose first section is bent by `bend_rad`.
    pub(crate) fn new(connection: &Connection, bend_rad: f64) -> Self {
        let mut bends = [0.0; 12];
        bends[0] = bend_rad;
        Self {
            driver: connection.driver(Interface::Velocity).unwrap(),
            bend_rad: bends,
            last_command: None,
            measured: Instant::now(),
        }
    }

    /// Follows the newest command, and measures once a millisecond.
    pub(crate) fn turn(&mut self) {
        self.follow();
        if self.measured.elapsed() >= EVERY {
            self.measured = Instant::now();
            self.measure(self.bend_rad);
        }
    }

    /// Follows the newest command.
    pub(crate) fn follow(&mut self) {
        if let Some(command) = self.driver.newest_command().unwrap() {
            self.bend_rad = command.bend_target_rad;
            self.last_command = Some(command);
        }
    }

    /// Says that the robot is bent like this now; returns when.
    pub(crate) fn measure(&self, bend_rad: [f64; 12]) -> u64 {
        let measured_ns = monotonic_ns();
        self.measure_at(measured_ns, bend_rad);
        measured_ns
    }

    /// Says that the robot was bent like this at `measured_ns`.
    pub(crate) fn measure_at(&self, measured_ns: u64, bend_rad: [f64; 12]) {
        self.send(&Measurement {
            measured_ns,
            kind: MeasurementKind::Configuration.code(),
            bend_rad,
            ..Measurement::default()
        });
    }

    /// Sends what a driver of three sections says.
    fn send(&self, measurement: &Measurement) {
        let measurement = Measurement {
            sections: 3,
            ..*measurement
        };
        self.driver.send(measurement).unwrap();
    }

    /// Turns until the daemon holds it.
    pub(crate) fn until_held(&mut self, trail: &mut Trail) {
        trail.until_while("holding", || self.turn(), is(Mode::Holding));
    }
}
