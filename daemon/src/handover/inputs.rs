use cdcr_controller::estimator::Measurement;
use cdcr_controller::reference::ReferenceWindow;
use cdcr_controller::safety::{LeaseState, Refusal, Request};

use super::RuntimeSettings;
use crate::obstacles::ObstacleSet;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimedMeasurement {
    pub measurement: Measurement,
    pub measured_ns: u64,
    /// Begin and end of the newest rest of the motors, as the driver states it \[ns\]; 0: it does not.
    pub rested_ns: [u64; 2],
}

/// Results of one gather, consistent with each other.
#[derive(Debug, Clone)]
pub struct CycleInputs {
    /// Number of the gather; 0: none yet.
    pub gather: u64,
    /// Time of the gather \[ns\].
    pub gather_ns: u64,
    /// Reference on the grid.
    pub window: ReferenceWindow,
    pub lease: LeaseState,
    /// Number of leases acquired so far.
    pub lease_number: u32,
    /// Number of stops requested so far. When it grows, the cycle stops, whatever else waits in the ring.
    pub stops: u64,
    /// Number of suspends of the machine (to memory or disk) so far. When it grows, the cycle stops.
    pub suspends: u64,
    /// A source of obstacles is silent, and the configuration requires the robot to hold then.
    pub obstacle_source_silent: bool,
    /// The driver's newest measurement of bends or cables, or of the tip if it measures nothing else.
    pub measurement: Option<TimedMeasurement>,
    /// Number of drivers so far. A new one holds its motors until the commanded position is where it measures them.
    pub drivers: u64,
    /// The newest measurement of the tip in addition to bends or cables.
    pub tip: Option<TimedMeasurement>,
    /// Number of processes that measured the tip so far. It grows with each new sensor.
    pub tip_sensors: u64,
    /// Obstacles, each at its own time stamp.
    pub obstacles: ObstacleSet,
    /// Recent core time of the exchange per period \[ns\].
    pub exchange_ns: u64,
    /// Number of times that the cycle thread lost its core while it ran, up to its newest record. When it
    /// grows, the measured time of the newest cycle includes other work.
    pub interruptions: u64,
    /// Settings in force, validated.
    pub settings: RuntimeSettings,
    /// Grows with each change of the settings.
    pub settings_revision: u64,
}

impl CycleInputs {
    /// Inputs before the first gather.
    pub fn new(settings: RuntimeSettings) -> Self {
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
            drivers: 0,
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
    /// Identifies the waiting client for the exchange.
    pub ticket: u64,
    pub request: Request,
    /// Time at which the client sent the request \[ns\].
    pub asked_ns: u64,
    /// Number of stops requested up to and including this request. A stop may arrive before the inputs that
    /// count it.
    pub stops: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CycleAnswer {
    pub ticket: u64,
    /// Accepted, or the reason of the refusal.
    pub outcome: Result<(), Refusal>,
}
