use iceoryx2::prelude::ZeroCopySend;

use crate::Header;
use crate::limits::CHUNK_POINTS_MAX;

/// One time-stamped pose that the tip shall have.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, ZeroCopySend)]
#[type_name("cdcr.ReferencePoint.v1")]
pub struct ReferencePoint {
    /// When the tip shall be there \[ns, `CLOCK_MONOTONIC`\].
    pub time_ns: u64,
    /// Tip position in the base frame \[m\].
    pub position_m: [f64; 3],
    /// Meaning by `orientation_kind`: unused; tip axis as unit vector (x, y, z, 0); or unit
    /// quaternion (x, y, z, w) base → tip.
    pub orientation: [f64; 4],
    /// [`codes::OrientationKind`](crate::codes::OrientationKind).
    pub orientation_kind: u32,
    /// Zero.
    pub reserved: u32,
}

/// Part of a reference trajectory: up to [`CHUNK_POINTS_MAX`] points, each at least a microsecond after the one before it, also
/// where one chunk is appended to another.
///
/// A chunk is accepted whole or refused whole; the outcome is an
/// [`InputEvent`](crate::InputEvent) in the telemetry. Appended chunks must follow each other without
/// a gap in `header.sequence`, so that a lost chunk ends the trajectory instead of being bridged.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, ZeroCopySend)]
#[type_name("cdcr.ReferenceChunk.v1")]
pub struct ReferenceChunk {
    /// Sender (it must hold the reference lease), sequence, time.
    pub header: Header,
    /// [`codes::ChunkMode`](crate::codes::ChunkMode): append to the trajectory, or begin a new one.
    pub mode: u32,
    /// [`codes::Interpolation`](crate::codes::Interpolation) between the points of this chunk.
    pub interpolation: u32,
    /// Points used, 1 ..= [`CHUNK_POINTS_MAX`].
    pub count: u32,
    /// Zero.
    pub reserved: u32,
    /// The points; only the first `count` are read.
    pub points: [ReferencePoint; CHUNK_POINTS_MAX],
}

impl Default for ReferenceChunk {
    fn default() -> Self {
        Self {
            header: Header::default(),
            mode: 0,
            interpolation: 0,
            count: 0,
            reserved: 0,
            points: [ReferencePoint::default(); CHUNK_POINTS_MAX],
        }
    }
}
