use cdcr_controller::plant::{Flaws, MisbehavingRobot, MotorOrder, true_robot};
use cdcr_controller::robot::{Configuration, RobotError};
use cdcr_shared_types::Measurement;
use cdcr_shared_types::codes::{Interface, MeasurementKind};
use cdcr_shared_types::counted;

use crate::model::robot_of;
use crate::{Connection, Driver, DriverUpdate, LinkError, STATUS_TIMEOUT, monotonic_ns};

/// Time step of the motors \[ns\].
const STEP_NS: u64 = 1_000_000;

/// A simulated robot behind a driver: [`MisbehavingRobot`] at the ports of a [`Driver`].
///
/// The motors follow the commands in time steps of 1 ms, independent of the call rate.
#[derive(Debug)]
pub struct PlantDriver {
    driver: Driver,
    interface: Interface,
    sections: u32,
    plant: MisbehavingRobot,
    /// Time up to which the motors are simulated \[ns\].
    moved_ns: u64,
}

/// Why no simulated robot could be created.
#[derive(Debug, thiserror::Error)]
pub enum PlantError {
    /// The daemon is not reachable, or a port failed.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The flaws give an invalid robot.
    #[error("invalid robot with these flaws: {0}")]
    Robot(#[from] RobotError),
    /// The number of sections differs from the robot's.
    #[error("{} given, but the robot has {robot}", counted(*given, "section"))]
    SectionCount {
        /// Sections that were given.
        given: usize,
        /// Sections of the robot.
        robot: usize,
    },
}

impl PlantDriver {
    /// The robot of the connected daemon with these flaws and this noise seed; its initial configuration is
    /// `start`, or straight.
    ///
    /// # Errors
    /// [`PlantError`].
    pub fn new(
        connection: &Connection,
        interface: Interface,
        start: Option<&Configuration>,
        flaws: Flaws,
        seed: u64,
    ) -> Result<Self, PlantError> {
        let status = connection.status(STATUS_TIMEOUT)?;
        let model = robot_of(&status.robot)?;
        let straight = Configuration::straight(model.section_count());
        Ok(Self {
            driver: connection.driver(interface)?,
            interface,
            sections: status.robot.sections,
            plant: MisbehavingRobot::new(&model, start.unwrap_or(&straight), flaws, seed)?,
            moved_ns: monotonic_ns(),
        })
    }

    /// Replaces the true geometry, also that of the flaws: section length \[m\], cable radius \[m\] and cable
    /// offset \[rad\] of each section, base first.
    ///
    /// # Errors
    /// [`PlantError`].
    pub fn with_geometry(mut self, geometry: &[[f64; 3]]) -> Result<Self, PlantError> {
        let (given, robot) = (geometry.len(), self.sections as usize);
        if given != robot {
            return Err(PlantError::SectionCount { given, robot });
        }
        let truth = true_robot(self.plant.model(), geometry)?;
        self.plant = self.plant.with_truth(truth);
        Ok(self)
    }

    /// Advances the simulation to the present time, then receives new commands.
    ///
    /// The elapsed time belongs to the old commands, because a motor does not know future ones.
    ///
    /// # Errors
    /// When iceoryx2 fails.
    pub fn follow(&mut self) -> Result<DriverUpdate, LinkError> {
        self.advance();
        self.driver.update()
    }

    /// Advances the simulation to the present time. The motors get no new command until the next [`follow`](Self::follow).
    pub fn advance(&mut self) {
        let now_ns = monotonic_ns();
        while self.moved_ns < now_ns {
            let step_ns = STEP_NS.min(now_ns - self.moved_ns);
            self.moved_ns += step_ns;
            self.plant.order(self.order(self.moved_ns));
            self.plant.advance(step_ns as f64 * 1e-9);
        }
    }

    fn order(&self, time_ns: u64) -> MotorOrder {
        if self.interface == Interface::Velocity {
            return MotorOrder::Speeds(self.driver.rates_at(time_ns).cable_speed_m_s);
        }
        let position = self.driver.position_at(time_ns);
        position.map_or(MotorOrder::Stop, |position| {
            MotorOrder::Lengths(position.cable_length_m)
        })
    }

    /// Sends the encoder measurement, if there is one.
    ///
    /// # Errors
    /// When iceoryx2 fails.
    pub fn send_cables(&mut self) -> Result<(), LinkError> {
        let Some(cable_length_m) = self.plant.measure_cables() else {
            return Ok(());
        };
        self.send(&Measurement {
            kind: MeasurementKind::CableLengths.code(),
            cable_length_m,
            ..Measurement::default()
        })
    }

    /// Sends the tip measurement, if there is one.
    ///
    /// # Errors
    /// When iceoryx2 fails.
    pub fn send_tip(&mut self) -> Result<(), LinkError> {
        let Some(position_m) = self.plant.measure_tip() else {
            return Ok(());
        };
        self.send(&Measurement {
            kind: MeasurementKind::TipPose.code(),
            tip_position_m: position_m.into(),
            ..Measurement::default()
        })
    }

    fn send(&self, measurement: &Measurement) -> Result<(), LinkError> {
        self.driver.send(Measurement {
            measured_ns: self.moved_ns,
            sections: self.sections,
            ..*measurement
        })?;
        Ok(())
    }

    /// The simulated robot.
    pub fn plant(&mut self) -> &mut MisbehavingRobot {
        &mut self.plant
    }

    /// The driver of the robot.
    pub fn driver(&self) -> &Driver {
        &self.driver
    }
}
