use iceoryx2::prelude::ZeroCopySend;

use crate::{Header, SolverSettings};

/// A request to the daemon.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, ZeroCopySend)]
#[type_name("cdcr.Request.v1")]
pub struct Request {
    /// Sender, sequence, time. The sender's identity is what a lease is bound to.
    pub header: Header,
    /// [`codes::RequestKind`](crate::codes::RequestKind).
    pub kind: u32,
    /// Zero.
    pub reserved: u32,
    /// Read by a settings request only.
    pub settings: SolverSettings,
}

/// The daemon's answer: accepted, or why not.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, ZeroCopySend)]
#[type_name("cdcr.Response.v1")]
pub struct Response {
    /// The daemon, sequence, time.
    pub header: Header,
    /// `header.sequence` of the request.
    pub request_sequence: u64,
    /// Newest cycle when it was answered: the one that carried it out, or, for a lease or settings, the
    /// one before it takes effect.
    pub cycle: u64,
    /// [`codes::Outcome`](crate::codes::Outcome).
    pub outcome: u32,
    /// [`codes::Mode`](crate::codes::Mode) after the request.
    pub mode: u32,
    /// Holder of the reference lease after the request; 0: nobody.
    pub lease_holder: u64,
    /// How long the lease still runs \[ns\].
    pub lease_left_ns: u64,
}
