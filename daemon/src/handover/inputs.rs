use cdcr_controller::estimator::Measurement;
use cdcr_controller::reference::ReferenceWindow;
use cdcr_controller::safety::{LeaseState, Refusal, Request};

use super::Settings;
use crate::obstacles::ObstacleSet;

/// A measurement with its time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimedMeasurement {
    pub measurement: Measurement,
    /// When \[ns\].
    pub measured_ns: u64,
}

/// Everything that one gather found out, as one consistent whole.
#[derive(Debug, Clone)]
pub struct CycleInputs {
    /// Number of the gather; 0: there was none yet.
    pub gather: u64,
    /// Its time \[ns\].
    pub gather_ns: u64,
    /// The reference on the grid.
    pub window: ReferenceWindow,
    pub lease: LeaseState,
    /// Its number: leases are counted as they are acquired.
    pub lease_number: u32,
    /// Stops that were asked for so far. When it has grown, the cycle stops whatever else waits in the ring.
    pub stops: u64,
    /// Times that the machine slept (suspend to memory or disk) so far. When it has grown, the cycle stops.
    pub suspends: u64,
    /// The source of the obstacles is silent, and the configuration wants the robot to hold then.
    pub obstacle_source_silent: bool,
    /// The driver's newest measurement of bends or cables; of the tip where it measures nothing else.
    pub measurement: Option<TimedMeasurement>,
    /// Its newest measurement of the tip beside those.
    pub tip: Option<TimedMeasurement>,
    /// Processes that measured the tip so far. When it has grown, another sensor does.
    pub tip_sensors: u64,
    /// The obstacles, each at its own stamp.
    pub obstacles: ObstacleSet,
    /// What the exchange took of the core in a period, of late \[ns\].
    pub exchange_ns: u64,
    /// Times that the cycle thread lost its core while it ran, until its newest record. When it has grown, the time that
    /// the newest cycle took is not its own.
    pub interruptions: u64,
    /// The settings in force, checked.
    pub settings: Settings,
    /// Grows with each change of the settings.
    pub settings_revision: u64,
}

impl CycleInputs {
    /// Before the first gather.
    pub fn new(settings: Settings) -> Self {
        Self {
            gather: 0,
            gather_ns: 0,
            window: ReferenceWindow::default(),
            lease: LeaseState::Free,
            lease_number: 0,
            stops: 0,
            suspends: 0,
            obstacle_source_silent: false,
            measurement: None,
            tip: None,
            tip_sensors: 0,
            obstacles: ObstacleSet::default(),
            exchange_ns: 0,
            interruptions: 0,
            settings,
            settings_revision: 0,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CycleRequest {
    /// Its ticket: the exchange finds the waiting client by it.
    pub ticket: u64,
    pub request: Request,
    /// When its client sent it \[ns\].
    pub asked_ns: u64,
    /// Of a stop: how many were asked for until then, itself among them. It may come before the inputs that count it.
    pub stops: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CycleAnswer {
    pub ticket: u64,
    /// Taken, or why not.
    pub outcome: Result<(), Refusal>,
}
