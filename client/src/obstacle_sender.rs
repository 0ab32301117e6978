use cdcr_shared_types::codes::{ObstacleAction, ObstacleShape};
use cdcr_shared_types::limits::OBSTACLES_MAX;
use cdcr_shared_types::{Header, Obstacle, ObstacleUpdate, RobotDescription};

use crate::outlet::Outlet;
use crate::{LinkError, section_lengths_m};

/// An obstacle farther away than this, in robot lengths, is taken for one in millimetres: they give a factor of a thousand.
const FAR: f64 = 30.0;

/// Sends obstacles to the daemon. Any client may send; all clients share the ids.
///
/// [`TelemetryStream::outcome_on`](crate::TelemetryStream::outcome_on) returns the outcome of a message. Keep
/// the sender until then: dropping it discards messages that the daemon has not received yet.
///
/// A restarted daemon knows no obstacles; the same sender reaches it.
#[derive(Debug)]
pub struct ObstacleSender {
    pub(crate) outlet: Outlet<ObstacleUpdate>,
    /// Of the time when this port was opened, if it was known.
    pub(crate) robot: Option<RobotDescription>,
}

impl ObstacleSender {
    /// Inserts obstacles, or replaces those with the same ids.
    ///
    /// # Errors
    /// When there are more than [`OBSTACLES_MAX`], one is probably in millimetres, or iceoryx2 fails: it is farther away than
    /// thirty robot lengths, or its radius is larger than the robot and the base is inside. Then nothing is sent, and the
    /// daemon keeps what it knows.
    pub fn upsert(&self, obstacles: &[Obstacle]) -> Result<Header, LinkError> {
        if let Some(robot) = &self.robot {
            let reach_m: f64 = section_lengths_m(robot).iter().sum();
            // A sensor may see the robot or its mounting as an obstacle around the base.
            let may_be_meant = |obstacle: &Obstacle| {
                obstacle.radius_m <= reach_m && distance_from_base_m(obstacle) < 0.0
            };
            for obstacle in obstacles.iter().filter(|it| !may_be_meant(it)) {
                check_place(obstacle, robot)?;
            }
        }
        self.upsert_anywhere(obstacles)
    }

    /// As [`upsert`](Self::upsert), wherever the obstacles are.
    ///
    /// # Errors
    /// When there are more than [`OBSTACLES_MAX`], or iceoryx2 fails.
    pub fn upsert_anywhere(&self, obstacles: &[Obstacle]) -> Result<Header, LinkError> {
        self.send(ObstacleAction::Upsert, obstacles)
    }

    /// Removes obstacles by id. If the daemon monitors a client's obstacles with lifetimes
    /// (`obstacles.source_timeout_ms`), the client removes them all before it ends; otherwise the robot
    /// holds.
    ///
    /// # Errors
    /// As [`upsert_anywhere`](Self::upsert_anywhere).
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

/// Refuses an obstacle that is probably in millimetres: it is farther away than thirty robot lengths, or the base is inside.
///
/// # Errors
/// [`LinkError::Misplaced`], with the reason.
pub fn check_place(obstacle: &Obstacle, robot: &RobotDescription) -> Result<(), LinkError> {
    let from_base_m = distance_from_base_m(obstacle);
    let reach_m: f64 = section_lengths_m(robot).iter().sum();
    let place = if from_base_m > FAR * reach_m {
        format!("is {from_base_m:.1} m away")
    } else if from_base_m < 0.0 {
        format!("contains the base, which is {:.3} m inside", -from_base_m)
    } else {
        return Ok(());
    };
    let id = obstacle.id;
    Err(LinkError::Misplaced {
        cause: format!("obstacle {id} {place}, and the robot is {reach_m:.2} m long"),
    })
}

/// Distance of the surface from the base; negative: the base is inside \[m\].
fn distance_from_base_m(obstacle: &Obstacle) -> f64 {
    let is_capsule = obstacle.shape == ObstacleShape::Capsule.code();
    let end_m = if is_capsule {
        obstacle.end_m
    } else {
        obstacle.start_m
    };
    distance_m(obstacle.start_m, end_m) - obstacle.radius_m
}

/// Distance of a segment from the base, the origin \[m\].
fn distance_m(start: [f64; 3], end: [f64; 3]) -> f64 {
    let dot = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let along: [f64; 3] = std::array::from_fn(|i| end[i] - start[i]);
    let squared = dot(along, along);
    let part = if squared > 0.0 {
        (-dot(start, along) / squared).clamp(0.0, 1.0)
    } else {
        0.0
    };
    let nearest: [f64; 3] = std::array::from_fn(|i| start[i] + part * along[i]);
    dot(nearest, nearest).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn is_placed(start_m: [f64; 3], end_m: Option<[f64; 3]>, radius_m: f64) -> bool {
        let mut robot = RobotDescription {
            sections: 3,
            ..RobotDescription::default()
        };
        for section in &mut robot.section[..3] {
            section.length_m = 0.3;
        }
        let shape = match end_m {
            Some(_) => ObstacleShape::Capsule,
            None => ObstacleShape::Sphere,
        };
        let obstacle = Obstacle {
            shape: shape.code(),
            start_m,
            end_m: end_m.unwrap_or_default(),
            radius_m,
            ..Obstacle::default()
        };
        check_place(&obstacle, &robot).is_ok()
    }

    #[test]
    fn metres_that_look_like_millimetres_are_refused() {
        for (at, radius_m, is_legal) in [
            ([0.0, 0.17, 0.22], 0.02, true),
            ([0.0, 170.0, 220.0], 20.0, false),
            ([70.0, 0.0, 0.0], 20.0, false),
            // A wall, and a machine across the hall.
            ([0.0, 0.0, -1000.0], 999.9, true),
            ([8.0, 0.0, 0.0], 1.0, true),
            // Only the radius is in mm: the base is inside.
            ([0.5, 0.6, 0.1], 20.0, false),
        ] {
            assert_eq!(is_placed(at, None, radius_m), is_legal, "{at:?}");
        }
        let far = [50.0, 0.0, 0.0];
        assert!(
            is_placed(far, Some([0.3, 0.0, 0.0]), 0.1),
            "one end is near"
        );
        let through = is_placed([0.5, 0.0, 0.0], Some([-0.5, 0.0, 0.0]), 0.02);
        assert!(!through, "the base is inside");
    }
}
