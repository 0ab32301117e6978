use crate::Header;
use crate::limits::CHUNK_POINTS_MAX;
use crate::message::message;

message! {
    /// One time-stamped pose of the reference for the tip.
    pub struct ReferencePoint "cdcr.ReferencePoint.v1" {
        /// When the tip shall be there \[ns, `CLOCK_MONOTONIC`\].
        time_ns: u64,
        /// Tip position in the base frame \[m\].
        position_m: [f64; 3],
        /// Meaning by `orientation_kind`: unused; tip axis, or preferred one, as unit vector (x, y, z, 0); or unit
        /// quaternion (x, y, z, w) base → tip.
        orientation: [f64; 4],
        /// [`codes::OrientationKind`](crate::codes::OrientationKind).
        orientation_kind: u32 [code OrientationKind],
        /// Zero.
        reserved: u32 [reserved],
    }

    /// Part of a reference trajectory: up to [`CHUNK_POINTS_MAX`] points. Each is at least a microsecond after the
    /// previous one, also across appended chunks.
    ///
    /// A chunk is accepted or rejected as a whole; the telemetry reports the outcome as an
    /// [`InputEvent`](crate::InputEvent). Appended chunks must follow each other without a gap in `header.sequence`, so
    /// that a lost chunk ends the trajectory instead of being bridged.
    pub struct ReferenceChunk "cdcr.ReferenceChunk.v1" {
        /// Sender (it must hold the reference lease), sequence, time.
        header: Header,
        /// [`codes::ChunkMode`](crate::codes::ChunkMode): append to the trajectory, or begin a new one.
        mode: u32 [code ChunkMode],
        /// [`codes::Interpolation`](crate::codes::Interpolation) between the points of this chunk.
        interpolation: u32 [code Interpolation],
        /// Points used, 1 ..= [`CHUNK_POINTS_MAX`].
        count: u32 [length],
        /// Zero.
        reserved: u32 [reserved],
        /// The points; only the first `count` are read.
        points: [ReferencePoint; CHUNK_POINTS_MAX] [used 1 count],
    }
}
