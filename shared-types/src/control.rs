use crate::message::message;
use crate::{Header, SolverSettings};

message! {
    /// A request to the daemon. It is lost with a killed daemon, unless its client still waits for an answer and sends
    /// it to the next daemon, as the client library does. Except for a stop, the daemon rejects a request that was sent
    /// more than 1 s before ([`Outcome::Stale`](crate::codes::Outcome::Stale)).
    pub struct Request "cdcr.Request.v3" {
        /// Sender, sequence, time. A lease is bound to the sender's identity.
        header: Header,
        /// [`codes::RequestKind`](crate::codes::RequestKind).
        kind: u32 [code RequestKind],
        /// With a reset: it is also granted where the robot is measured far from where its last command left it; control
        /// begins where it is measured. 0 with every other request.
        accepts_pose: u32 [yes],
        /// Read by a settings request only.
        settings: SolverSettings,
    }

    /// The daemon's response to a request: accepted, or the reason for its rejection.
    pub struct Response "cdcr.Response.v2" {
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
        /// Holder of the reference lease after the request; 0: none.
        lease_holder: u64,
        /// How long the lease still runs \[ns\].
        lease_left_ns: u64,
        /// With the outcome [`PoseDiffers`](crate::codes::Outcome::PoseDiffers): how far this section is measured from
        /// where the last command left it \[rad\]. Otherwise 0.
        pose_difference_rad: f64,
        /// Section with the largest such difference, 1 next to the base; otherwise 0.
        pose_section: u32,
        /// Zero.
        reserved: u32 [reserved],
    }
}
