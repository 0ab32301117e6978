use cdcr_shared_types as wire;
use cdcr_shared_types::codes::Outcome;
use cdcr_shared_types::limits::EVENTS_MAX;

use super::CycleRecord;
use crate::rt::attribution::Scheduling;
use crate::rt::record_ring::Sent;

/// A cycle on its way to those who watch: what it did, and what the exchange knows of it.
#[derive(Debug)]
pub struct CycleReport {
    /// Its number; those that found no room leave gaps.
    pub number: u64,
    /// What the scheduler did to the cycle thread since the look before; none where the kernel does not tell.
    pub scheduling: Option<Scheduling>,
    /// Whoever is done with it gives it back ([`ReporterEnds::used`](super::ReporterEnds)).
    pub record: Sent<CycleRecord>,
    /// Its command as it was published, or would have been.
    pub command: wire::Command,
    /// From the hand-over of the record until the command was out \[ns\].
    pub publish_ns: u64,
    /// What clients have to do with it.
    pub inputs: InputReport,
}

/// What the exchange took in until a cycle.
#[derive(Debug)]
pub struct InputReport {
    /// What was taken or refused and belongs to this record; the first `event_count` count.
    pub events: [wire::InputEvent; EVENTS_MAX],
    pub event_count: usize,
    /// Events lost so far because no record took them.
    pub dropped_events: u64,
    /// How often each outcome was given so far.
    pub outcomes: [u64; Outcome::COUNT],
    /// How long the newest gather took \[ns\].
    pub gather_took_ns: u64,
    /// Who holds the reference lease; 0: nobody.
    pub lease_holder: u64,
    /// Time of the reference's last point \[ns\]; 0: there is none.
    pub reference_end_ns: u64,
    /// Points of the reference that are still ahead.
    pub reference_points: u32,
    pub obstacles_refused: u64,
}
