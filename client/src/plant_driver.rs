use std::time::Duration;

use cdcr_controller::plant::{Flaws, MisbehavingRobot, MotorOrder, true_robot};
use cdcr_controller::robot::{Configuration, RobotError};
use cdcr_shared_types::Measurement;
use cdcr_shared_types::codes::{Interface, MeasurementKind};
use cdcr_shared_types::counted;

use crate::model::robot_of;
use crate::{Connection, Driver, DriverUpdate, LinkError, monotonic_ns};

/// The motors are moved on in steps of this \[ns\].
const STEP_NS: u64 = 1_000_000;
/// How long the daemon's status is waited for.
const TIMEOUT: Duration = Duration::from_secs(1);

/// A simulated robot behind a driver: [`MisbehavingRobot`] at the ports of a [`Driver`].
///
/// Its motors do what the driver obeys, for as long as that holds, however seldom it is turned.
#[derive(Debug)]
pub struct PlantDriver {
    driver: Driver,
    interface: Interface,
    sections: u32,
    plant: MisbehavingRobot,
    /// Until when the motors have been moved on \[ns\].
    moved_ns: u64,
}

/// Why there is no simulated robot.
#[derive(Debug, thiserror::Error)]
pub enum PlantError {
    /// The daemon is not there.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The flaws make it no robot.
    #[error("invalid robot with these flaws: {0}")]
    Robot(#[from] RobotError),
    /// Another number of sections than the robot has.
    #[error("{} given, but the robot has {robot}", counted(*given, "section"))]
    SectionCount {
        /// Sections that were given.
        given: usize,
        /// Sections of the robot.
        robot: usize,
    },
}

impl PlantDriver {
    /// The robot of the daemon of `connection` with these flaws, whose noise has this seed; bent by `start`, or straight.
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
        let status = connection.status(TIMEOUT)?;
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

    /// The same with sections that have other lengths (m), radii (m) and angles of their cables (rad) than the daemon is configured with, three
    /// numbers for each, base first; whatever the flaws say of the geometry.
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

    /// Moves on to now, and takes the commands that have come.
    ///
    /// The time that has passed belongs to the old commands, because a motor does not know those that come.
    ///
    /// # Errors
    /// When iceoryx2 fails.
    pub fn follow(&mut self) -> Result<DriverUpdate, LinkError> {
        let now_ns = monotonic_ns();
        while self.moved_ns < now_ns {
            let step_ns = STEP_NS.min(now_ns - self.moved_ns);
            self.moved_ns += step_ns;
            self.plant.order(self.order(self.moved_ns));
            self.plant.advance(step_ns as f64 * 1e-9);
        }
        self.driver.update()
    }

    fn order(&self, time_ns: u64) -> MotorOrder {
        if self.interface == Interface::Velocity {
            return MotorOrder::Speeds(self.driver.rates_at(time_ns).cable_speed_m_s);
        }
        let position = self.driver.position_at(time_ns);
        position.map_or(MotorOrder::Stand, |position| {
            MotorOrder::Lengths(position.cable_length_m)
        })
    }

    /// Sends what the encoders say now, if anything.
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

    /// Sends what a sensor of the tip says now, if anything.
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

    /// The robot.
    pub fn plant(&mut self) -> &mut MisbehavingRobot {
        &mut self.plant
    }

    /// Its driver.
    pub fn driver(&self) -> &Driver {
        &self.driver
    }
}
