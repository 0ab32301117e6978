use crate::message::message;
use crate::{Header, SolverSettings};

message! {
    /// A request to the daemon. It lives in the memory of one daemon: the one that follows a daemon that was killed knows nothing of it,
    /// unless its client, still waiting for an answer, sends it again, as the client library does. A daemon refuses a request about
    /// anything but a stop that was sent more than 1 s before ([`Outcome::Stale`](crate::codes::Outcome::Stale)).
    pub struct Request "cdcr.Request.v1" {
        /// Sender, sequence, time. The sender's identity is what a lease is bound to.
        header: Header,
        /// [`codes::RequestKind`](crate::codes::RequestKind).
        kind: u32 [code RequestKind],
        /// Zero.
        reserved: u32 [reserved],
        /// Read by a settings request only.
        settings: SolverSettings,
    }

    /// The daemon's answer: accepted, or why not.
    pub struct Response "cdcr.Response.v1" {
        /// The daemon, sequence, time.
        header: Header,
        /// `header.sequence` of the request.
        request_sequence: u64,
        /// Newest cycle when it was answered: the one that carried it out, or, for a lease or settings, the
        /// one before it takes effect.
        cycle: u64,
        /// [`codes::Outcome`](crate::codes::Outcome).
        outcome: u32 [code Outcome],
        /// [`codes::Mode`](crate::codes::Mode) after the request.
        mode: u32 [code Mode],
        /// Holder of the reference lease after the request; 0: nobody.
        lease_holder: u64,
        /// How long the lease still runs \[ns\].
        lease_left_ns: u64,
    }
}
