//! A robot behind a driver, simulated by a test.

use cdcr_client::{CommandRefusal, Connection, PlantDriver, monotonic_ns};
use cdcr_controller::plant::{Flaws, RobotPreset};
use cdcr_controller::robot::{Configuration, Robot};
use cdcr_shared_types::codes::{Interface, MeasurementKind};
use cdcr_shared_types::limits::COORDINATES_MAX;
use cdcr_shared_types::{Command, Measurement};

use crate::TIMEOUT;
use crate::record::robot_of;

/// Default seed of the noise.
const SEED: u64 = 11;

/// A [`PlantDriver`] that fails the test when the daemon sends a command beyond the robot's limits.
#[derive(Debug)]
pub struct DrivenRobot {
    driver: PlantDriver,
    model: Robot,
    last_command: Option<Command>,
    last_refusal: Option<CommandRefusal>,
}

impl DrivenRobot {
    /// The [laboratory](RobotPreset::Laboratory)'s robot, bent by `bend_rad`.
    pub fn new(
        connection: &Connection,
        interface: Interface,
        bend_rad: [f64; COORDINATES_MAX],
    ) -> Self {
        Self::with_flaws(
            connection,
            interface,
            bend_rad,
            RobotPreset::Laboratory.flaws(),
        )
    }

    pub fn with_flaws(
        connection: &Connection,
        interface: Interface,
        bend_rad: [f64; COORDINATES_MAX],
        flaws: Flaws,
    ) -> Self {
        let model = robot_of(&connection.status(TIMEOUT).unwrap().robot);
        let at = Configuration::from_slice(&bend_rad[..model.coordinate_count()]).unwrap();
        Self {
            driver: PlantDriver::new(connection, interface, Some(&at), flaws, SEED).unwrap(),
            model,
            last_command: None,
            last_refusal: None,
        }
    }

    /// Advances to the present time, and takes the received commands.
    pub fn follow(&mut self) {
        let update = self.driver.follow().unwrap();
        if let Some(refusal) = update.refused {
            assert!(may_happen(&refusal), "the daemon's command: {refusal}");
        }
        self.last_command = update.command.or(self.last_command);
        self.last_refusal = update.refused.or(self.last_refusal);
    }

    /// Follows, and sends a measurement of the bends.
    pub fn turn(&mut self) {
        self.follow();
        self.measure(MeasurementKind::Configuration);
    }

    /// Sends a measurement of this kind at the present time.
    pub fn measure(&mut self, kind: MeasurementKind) {
        let measurement = self.measurement(kind);
        self.send(&measurement);
    }

    /// The present measurement of sensors that always have a value.
    pub fn measurement(&mut self, kind: MeasurementKind) -> Measurement {
        self.sensed(kind).expect("its sensors say it")
    }

    /// The present measurement; `None` if the sensor has no value.
    pub fn sensed(&mut self, kind: MeasurementKind) -> Option<Measurement> {
        let mut measurement = Measurement {
            measured_ns: monotonic_ns(),
            kind: kind.code(),
            ..Measurement::default()
        };
        if kind == MeasurementKind::TipPose {
            measurement.tip_position_m = self.driver.plant().measure_tip()?.into();
            return Some(measurement);
        }
        let lengths_m = self.driver.plant().measure_cables()?;
        if kind == MeasurementKind::CableLengths {
            measurement.cable_length_m = lengths_m;
        } else {
            measurement.bend_rad = padded(&self.model.bend_from_cable_lengths(&lengths_m));
        }
        Some(measurement)
    }

    /// Sends a measurement of this robot's driver.
    pub fn send(&self, measurement: &Measurement) {
        let measurement = Measurement {
            sections: self.model.section_count() as u32,
            ..*measurement
        };
        self.driver.driver().send(measurement).unwrap();
    }

    /// The true bends \[rad\].
    pub fn bend_rad(&mut self) -> [f64; COORDINATES_MAX] {
        padded(&self.driver.plant().configuration())
    }

    pub fn last_command(&self) -> Option<Command> {
        self.last_command
    }

    pub fn last_refusal(&self) -> Option<CommandRefusal> {
        self.last_refusal
    }
}

/// The interface in the configuration of this connection's daemon.
pub fn interface_of(connection: &Connection) -> Interface {
    Interface::try_from(connection.status(TIMEOUT).unwrap().interface).unwrap()
}

fn padded(bends: &Configuration) -> [f64; COORDINATES_MAX] {
    core::array::from_fn(|i| bends.as_slice().get(i).copied().unwrap_or(0.0))
}

/// Rejections that a stalled machine or a killed daemon or driver can cause. Any other one is a command
/// beyond the robot's limits.
fn may_happen(refusal: &CommandRefusal) -> bool {
    matches!(
        refusal,
        CommandRefusal::Expired { .. }
            | CommandRefusal::NotNewer { .. }
            | CommandRefusal::OtherDaemon { .. }
            | CommandRefusal::Elsewhere { .. }
            | CommandRefusal::OtherDriver { .. }
    )
}
