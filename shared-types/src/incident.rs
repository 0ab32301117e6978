use crate::message::message;
use crate::{Header, Telemetry};

message! {
    /// A bad cycle, kept in full: it started late, missed its deadline, skipped periods, or began a fault. A cycle that
    /// is bad only because the previous one ran past its release belongs to the incident of that cycle.
    ///
    /// The daemon keeps the newest [`INCIDENTS_MAX`](crate::limits::INCIDENTS_MAX) of them. A client that opens the
    /// service receives these, oldest first, and then each new one.
    pub struct Incident "cdcr.Incident.v14" {
        /// The daemon, number of the incident, time of publication.
        header: Header,
        /// Time that the hypervisor kept our core from the machine within `steal_window_ns` before the
        /// publication \[ns\], in steps of 10 ms.
        steal_ns: u64,
        /// Length of that window \[ns\], which ends just before the publication; 0: it could not be read.
        steal_window_ns: u64,
        /// The record of the cycle, as its readers received it, except `scheduling.late_cause`: where steal of at least a
        /// tick and half of the lateness explains it, the daemon puts platform in place of load, stall or compute. The
        /// telemetry service keeps the cause as first seen.
        telemetry: Telemetry,
    }
}
