use cdcr_shared_types::codes::ObstacleAction;
use cdcr_shared_types::limits::OBSTACLES_MAX;
use cdcr_shared_types::{Header, Obstacle, ObstacleUpdate};

use crate::LinkError;
use crate::outlet::Outlet;

/// Sends obstacles to the daemon. Any client may send; all clients share the ids.
///
/// [`TelemetryStream::outcome_on`](crate::TelemetryStream::outcome_on) returns the outcome of a message. Keep
/// the sender until then: dropping it discards messages that the daemon has not received yet.
///
/// A restarted daemon knows no obstacles; the same sender reaches it.
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

    /// Removes obstacles by id. If the daemon monitors a client's obstacles with lifetimes
    /// (`obstacles.source_timeout_ms`), the client removes them all before it ends; otherwise the robot
    /// holds.
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
