//! The two robots that a cycle can have: one simulated inside the daemon, one behind a driver.

use cdcr_controller::estimator::Measurement;
use cdcr_controller::plant::KinematicPlant;
use cdcr_controller::robot::BendRates;

use crate::handover::{CycleInputs, TimedMeasurement};

/// The robot, simulated or real, as the cycle sees it.
///
/// Both methods are called once in each cycle by the cycle thread, so they neither allocate, lock nor
/// call the system.
pub trait RobotLink {
    /// The newest measurement for the release at `release_ns`; none when there is none yet.
    fn measure(&mut self, release_ns: u64, inputs: &CycleInputs) -> Option<TimedMeasurement>;

    /// The rates that hold from the release at `release_ns` on.
    fn command(&mut self, release_ns: u64, rates: &BendRates);
}

/// The ideal kinematic robot. Commands take effect at the release of their cycle, and its state is
/// known exactly at each release.
#[derive(Debug)]
pub struct SimulatedRobot {
    plant: KinematicPlant,
    now_ns: Option<u64>,
}

impl SimulatedRobot {
    /// A simulated robot.
    pub fn new(plant: KinematicPlant) -> Self {
        Self {
            plant,
            now_ns: None,
        }
    }
}

impl RobotLink for SimulatedRobot {
    fn measure(&mut self, release_ns: u64, _: &CycleInputs) -> Option<TimedMeasurement> {
        let before_ns = self.now_ns.replace(release_ns).unwrap_or(release_ns);
        self.plant.advance((release_ns - before_ns) as f64 * 1e-9);
        Some(TimedMeasurement {
            measurement: Measurement::Configuration(*self.plant.configuration()),
            measured_ns: release_ns,
        })
    }

    fn command(&mut self, _: u64, rates: &BendRates) {
        self.plant.command(rates);
    }
}

/// A driver process: its measurements come with the inputs, and the exchange publishes the commands.
#[derive(Debug, Default)]
pub struct DriverLink;

impl RobotLink for DriverLink {
    fn measure(&mut self, _: u64, inputs: &CycleInputs) -> Option<TimedMeasurement> {
        inputs.measurement
    }

    fn command(&mut self, _: u64, _: &BendRates) {}
}
