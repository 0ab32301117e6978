use iceoryx2::prelude::ZeroCopySend;

/// The first field of every message: who, which, when.
///
/// A receiver drops what is not newer than what it has (`sequence`), notices loss by gaps, and
/// judges freshness by `sent_ns`. The daemon refuses an obstacle update or a measurement that is not newer than the last of
/// its writer (port), and a chunk that is not newer than the last one accepted of its client. A request is carried out as it
/// comes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ZeroCopySend)]
#[type_name("cdcr.Header.v1")]
pub struct Header {
    /// Identity of the sender: drawn at random when a process connects, never 0.
    pub sender_id: u64,
    /// Number of this message among those of the sender on this service: 1, 2, 3, …
    pub sequence: u64,
    /// Time of sending \[ns, `CLOCK_MONOTONIC`\].
    pub sent_ns: u64,
}
