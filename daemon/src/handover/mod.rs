//! Data exchanged between the threads, and the lock-free channels that carry them.
//!
//! ```text
//!  exchange ── CycleInputs (newest only: triple buffer) ────► cycle
//!  exchange ── CycleRequest (all: ring) ──────────────► cycle
//!  exchange ◄── CycleRecord (all, the newest always: `record_ring`, drops counted) ── cycle
//!  reporter ◄── CycleReport (all: ring, drops counted) ── exchange
//!  reload ── ChangedSettings (of a reloaded configuration: ring) ──► exchange
//!  supervisor ◄── Summary (all: ring, drops counted) ──── reporter
//!  supervisor ◄── Incident (bad cycles in full: ring, drops counted) ── reporter
//!  status thread ◄── Status (newest only: triple buffer), Incident (ring) ── supervisor
//! ```
//!
//! Invariant: this module is below the threads and knows nothing of their use of the data.

mod channels;
mod fault_place;
mod inputs;
mod policy;
mod record;
mod report;
mod shared;
mod summary;
mod tip_rejection;

pub use channels::{
    Channels, CycleEnds, ExchangeEnds, REQUESTS_PER_CYCLE, REQUESTS_WAITING, ReporterEnds,
    StatusThreadEnds, SupervisorEnds, channels,
};
pub use fault_place::FaultPlace;
pub use inputs::{CycleAnswer, CycleInputs, CycleRequest, TimedMeasurement};
pub(crate) use policy::approach_limits;
pub use policy::{ChangedSettings, Policy, RuntimeSettings};
pub use record::{CycleFacts, CycleRecord, MeasurementUse};
pub use report::{CycleReport, InputReport, InputStatus, RefusedTips};
pub use shared::Shared;
pub use summary::Summary;
pub use tip_rejection::{TipCause, TipRejection};
