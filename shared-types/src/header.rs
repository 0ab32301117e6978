use crate::message::message;

message! {
    /// The first field of every message: who, which, when.
    ///
    /// A receiver drops what is not newer than what it has (`sequence`), notices loss by gaps, and
    /// judges freshness by `sent_ns`. The daemon refuses an obstacle update or a measurement that is not newer than the last of
    /// its writer (port), and a chunk that is not newer than the last one accepted of its client. A request is carried out as it
    /// comes.
    #[derive(Eq)]
    pub struct Header "cdcr.Header.v1" {
        /// Identity of the sender: drawn at random when a process connects, never 0.
        sender_id: u64,
        /// Number of this message among those of the sender on this service: 1, 2, 3, …
        sequence: u64,
        /// Time of sending \[ns, `CLOCK_MONOTONIC`\].
        sent_ns: u64,
    }
}
