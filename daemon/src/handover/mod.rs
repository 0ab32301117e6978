//! What the threads hand to each other, and the lock-free channels between them.
//!
//! ```text
//!  exchange ── CycleInputs (newest counts: triple buffer) ──► cycle
//!  exchange ── CycleRequest (every one: ring) ──────────────► cycle
//!  exchange ◄── CycleRecord (every one, the newest for sure: `record_ring`, drops counted) ── cycle
//!  reporter ◄── CycleReport (every one: ring, drops counted) ── exchange
//!  reload ── ChangedSettings (of a configuration that was read again: ring) ──► exchange
//!  supervisor ◄── Summary (every one: ring, drops counted) ──── reporter
//!  supervisor ◄── Incident (bad cycles whole: ring, drops counted) reporter
//!  status desk ◄── Status (newest counts: triple buffer), Incident (ring) ── supervisor
//! ```
//!
//! It lies below the threads: it must not know what any of them does with these things.

mod channels;
mod inputs;
mod policy;
mod record;
mod report;
mod shared;
mod summary;

pub use channels::{
    Channels, CycleEnds, ExchangeEnds, REQUESTS_PER_CYCLE, REQUESTS_WAITING, ReporterEnds,
    StatusDeskEnds, SupervisorEnds, channels,
};
pub use inputs::{CycleAnswer, CycleInputs, CycleRequest, TimedMeasurement};
pub use policy::{ChangedSettings, Policy, Settings};
pub use record::{CycleFacts, CycleRecord, MeasurementUse};
pub use report::{CycleReport, InputReport};
pub use shared::Shared;
pub use summary::Summary;
