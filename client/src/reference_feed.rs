use cdcr_shared_types::codes::{ChunkMode, Interpolation};
use cdcr_shared_types::limits::CHUNK_POINTS_MAX;
use cdcr_shared_types::{Header, ReferenceChunk, ReferencePoint};

use crate::LinkError;
use crate::outlet::Outlet;

/// Sends reference chunks. Its user must hold the [`Lease`](crate::Lease), otherwise the daemon refuses them.
///
/// The daemon's decision on each chunk is an event in the telemetry, identified by the header that
/// [`send`](Self::send) returns.
#[derive(Debug)]
pub struct ReferenceFeed {
    pub(crate) outlet: Outlet<ReferenceChunk>,
}

impl ReferenceFeed {
    /// Sends one chunk. The append chunks of one connection have consecutive numbers, as the daemon requires.
    ///
    /// # Errors
    /// When there are no points or more than [`CHUNK_POINTS_MAX`], or iceoryx2 fails.
    pub fn send(
        &self,
        mode: ChunkMode,
        interpolation: Interpolation,
        points: &[ReferencePoint],
    ) -> Result<Header, LinkError> {
        let count = points.len();
        if !(1..=CHUNK_POINTS_MAX).contains(&count) {
            return Err(LinkError::ChunkPoints { count });
        }
        let mut chunk = ReferenceChunk {
            mode: mode.code(),
            interpolation: interpolation.code(),
            count: count as u32,
            ..ReferenceChunk::default()
        };
        chunk.points[..count].copy_from_slice(points);
        self.outlet.send(chunk)
    }
}
