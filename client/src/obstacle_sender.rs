use cdcr_shared_types::codes::ObstacleAction;
use cdcr_shared_types::limits::OBSTACLES_MAX;
use cdcr_shared_types::{Header, Obstacle, ObstacleUpdate};

use crate::LinkError;
use crate::outlet::Outlet;

/// Tells the daemon about obstacles. Any client may; ids are shared among all.
///
/// [`TelemetryStream::outcome_on`](crate::TelemetryStream::outcome_on) tells what became of a message.
/// Keep the sender until then: with it goes what the daemon has not yet taken in.
///
/// A daemon that is started again knows no obstacle; the sender reaches it as it is.
#[derive(Debug)]
pub struct ObstacleSender {
    pub(crate) outlet: Outlet<ObstacleUpdate>,
}

impl ObstacleSender {
    /// Inserts obstacles, or replaces those with the same ids.
    ///
    /// # Errors
    /// When there are more than [`OBSTACLES_MAX`], or iceoryx2 fails.
    pub fn upsert(&self, obstacles: &[Obstacle]) -> Result<Header, LinkError> {
        self.send(ObstacleAction::Upsert, obstacles)
    }

    /// Removes obstacles by their ids. A client whose obstacles have lifetimes, which the daemon watches (`obstacles.source_timeout_ms`),
    /// removes them all before it ends; else the robot holds.
    ///
    /// # Errors
    /// As [`upsert`](Self::upsert).
    pub fn remove(&self, ids: &[u32]) -> Result<Header, LinkError> {
        let with_id = |&id: &u32| Obstacle {
            id,
            ..Obstacle::default()
        };
        let obstacles: Vec<_> = ids.iter().map(with_id).collect();
        self.send(ObstacleAction::Remove, &obstacles)
    }

    /// Removes all obstacles.
    ///
    /// # Errors
    /// When iceoryx2 fails.
    pub fn clear(&self) -> Result<Header, LinkError> {
        self.send(ObstacleAction::Clear, &[])
    }

    fn send(&self, action: ObstacleAction, obstacles: &[Obstacle]) -> Result<Header, LinkError> {
        let count = obstacles.len();
        if count > OBSTACLES_MAX {
            return Err(LinkError::Obstacles { count });
        }
        let mut update = ObstacleUpdate {
            action: action.code(),
            count: count as u32,
            ..ObstacleUpdate::default()
        };
        update.obstacles[..count].copy_from_slice(obstacles);
        self.outlet.send(update)
    }
}
