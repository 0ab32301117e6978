use crate::message::message;

message! {
    /// The first field of every message: sender, sequence and time.
    ///
    /// A receiver drops messages that are not newer than the last one (`sequence`), detects loss by gaps, and evaluates
    /// freshness by `sent_ns`. The daemon rejects an obstacle update or a measurement that is not newer than the last
    /// of its writer (port). It rejects a chunk that is not newer than the last accepted one of its client. A request
    /// is executed whatever its sequence; except for a stop, one whose `sent_ns` is in the future is refused.
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
