use cdcr_shared_types as wire;
use cdcr_shared_types::codes::Outcome;
use cdcr_shared_types::limits::EVENTS_MAX;

use super::CycleRecord;
use crate::rt::attribution::Scheduling;
use crate::rt::record_ring::Sent;

/// A cycle's record with the data of the exchange, for monitoring clients.
#[derive(Debug)]
pub struct CycleReport {
    /// Number of the record; lost reports leave gaps.
    pub number: u64,
    /// Scheduler statistics of the cycle thread since the previous reading; `None` if the kernel does not
    /// provide them.
    pub scheduling: Option<Scheduling>,
    /// The last reader returns it ([`ReporterEnds::used`](super::ReporterEnds)).
    pub record: Sent<CycleRecord>,
    /// The command as it was published, or would have been.
    pub command: wire::Command,
    /// Time from the hand-over of the record until the command was published \[ns\].
    pub publish_ns: u64,
    /// Messages of clients up to this cycle.
    pub inputs: InputReport,
}

/// Measurements of the tip that the exchange refused.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RefusedTips {
    pub count: u64,
    /// Why the newest of them was refused; accepted: there is none.
    pub newest: Outcome,
    /// A measurement of the tip was accepted since.
    pub is_over: bool,
    /// Distance of the measured tip from where the newest refused first bends placed it \[m\]; 0: none was refused for it.
    pub contradiction_m: f64,
}

impl Default for RefusedTips {
    fn default() -> Self {
        Self {
            count: 0,
            newest: Outcome::Accepted,
            is_over: false,
            contradiction_m: 0.0,
        }
    }
}

/// Messages and requests processed by the exchange up to a cycle.
#[derive(Debug)]
pub struct InputReport {
    /// Accepted or refused messages that belong to this record; the first `event_count` are valid.
    pub events: [wire::InputEvent; EVENTS_MAX],
    pub event_count: usize,
    /// Duration of the newest gather \[ns\].
    pub gather_took_ns: u64,
    pub status: InputStatus,
}

/// What the exchange has of its clients and has refused so far, for the status.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct InputStatus {
    /// Events lost so far because no record could hold them.
    pub dropped_events: u64,
    /// Number of messages by outcome so far.
    pub outcomes: [u64; Outcome::COUNT],
    /// Holder of the reference lease; 0: none.
    pub lease_holder: u64,
    /// Time of the reference's last point \[ns\]; 0: no reference.
    pub reference_end_ns: u64,
    /// Points of the reference in the future.
    pub reference_points: u32,
    /// Obstacle updates refused since the start.
    pub obstacles_refused: u64,
    /// The source of obstacles that is silent since the earliest time, and that time \[ns\].
    pub silent_source: Option<(u64, u64)>,
    pub refused_tips: RefusedTips,
    /// The driver has sent tips, and neither bends nor cables.
    pub driver_measures_tip_only: bool,
    /// Smallest safe distance that a client may set \[m\].
    pub safe_distance_min_m: f64,
}
