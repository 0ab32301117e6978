//! Obstacles around the robot with their times, in a set of fixed size.
//!
//! Invariant: nothing here allocates or knows a message. A set is one value that is copied as a whole.

use cdcr_controller::nmpc::OBSTACLES_MAX;
use cdcr_controller::robot::Obstacle;
use nalgebra::Vector3;

/// An obstacle with its identity and its times.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownObstacle {
    /// Chosen by the sender.
    pub id: u32,
    /// The sender; 0: unknown.
    pub source: u64,
    /// The obstacle at `measured_ns`.
    pub obstacle: Obstacle,
    /// Time of the measurement \[ns\].
    pub measured_ns: u64,
    /// Time at which it expires \[ns\]; `None`: only when it is removed.
    pub expires_ns: Option<u64>,
}

impl KnownObstacle {
    pub fn is_known_at(&self, time_ns: u64) -> bool {
        self.expires_ns
            .is_none_or(|expires_ns| time_ns < expires_ns)
    }

    /// The obstacle at `time_ns`, at constant velocity. `None` if it has expired by then, or is farther away
    /// than an [`Obstacle`] can be: a thousand kilometres.
    pub fn advanced_to(&self, time_ns: u64) -> Option<Self> {
        let age_s = time_ns.wrapping_sub(self.measured_ns).cast_signed() as f64 * 1e-9;
        let moved = self.obstacle.moved(age_s);
        let (radius_m, velocity_m_s) = (moved.radius_m(), moved.velocity_m_s());
        let obstacle = Obstacle::new(*moved.shape(), radius_m, velocity_m_s).ok()?;
        self.is_known_at(time_ns).then_some(Self {
            obstacle,
            measured_ns: time_ns,
            ..*self
        })
    }
}

impl KnownObstacle {
    /// The obstacle without an end. Its source has predicted its place until `expires_ns`: if that is before
    /// `now_ns`, it rests from then on.
    #[must_use]
    pub fn kept(&self, now_ns: u64) -> Self {
        let Some(expires_ns) = self.expires_ns else {
            return *self;
        };
        let endless = Self {
            expires_ns: None,
            ..*self
        };
        if now_ns <= expires_ns {
            return endless;
        }
        let moved = endless.advanced_to(expires_ns).unwrap_or(endless);
        let standing = Obstacle::new(
            *moved.obstacle.shape(),
            moved.obstacle.radius_m(),
            Vector3::zeros(),
        );
        Self {
            obstacle: standing.unwrap_or(moved.obstacle),
            ..moved
        }
    }
}

/// The set has no space for another obstacle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the limit of {OBSTACLES_MAX} obstacles is reached; remove some first")]
pub struct SetIsFull;

/// Obstacles by their ids, at most [`OBSTACLES_MAX`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObstacleSet {
    /// The first `count` are obstacles: a cycle reads no more of this memory than it needs.
    slots: [Option<KnownObstacle>; OBSTACLES_MAX],
    count: usize,
}

impl Default for ObstacleSet {
    fn default() -> Self {
        Self {
            slots: [None; OBSTACLES_MAX],
            count: 0,
        }
    }
}

impl ObstacleSet {
    /// Inserts an obstacle, or replaces the one with its id. A full set remains unchanged.
    pub fn upsert(&mut self, obstacle: KnownObstacle) -> Result<(), SetIsFull> {
        let same = self.iter().position(|known| known.id == obstacle.id);
        let at = same.unwrap_or(self.count);
        *self.slots.get_mut(at).ok_or(SetIsFull)? = Some(obstacle);
        self.count = self.count.max(at + 1);
        Ok(())
    }

    /// Replaces the content by the first [`OBSTACLES_MAX`] of `known`, whose ids differ.
    pub fn fill(&mut self, known: impl IntoIterator<Item = KnownObstacle>) {
        self.count = 0;
        for (slot, known) in self.slots.iter_mut().zip(known) {
            *slot = Some(known);
            self.count += 1;
        }
    }

    /// Removes the obstacle with this id, if there is one.
    pub fn remove(&mut self, id: u32) {
        self.retain(|known| known.id != id);
    }

    /// Removes those expired at `time_ns`.
    pub fn expire(&mut self, time_ns: u64) {
        self.retain(|known| known.is_known_at(time_ns));
    }

    /// Keeps the obstacles for which `keep` is true. Writes nothing if it is true for all.
    pub fn retain(&mut self, keep: impl Fn(&KnownObstacle) -> bool) {
        if !self.iter().all(&keep) {
            *self = self.iter().copied().filter(keep).collect();
        }
    }

    /// Each obstacle at `time_ns`, except those omitted by [`KnownObstacle::advanced_to`].
    pub fn iter_at(&self, time_ns: u64) -> impl Iterator<Item = KnownObstacle> {
        self.iter()
            .filter_map(move |known| known.advanced_to(time_ns))
    }

    /// The obstacles, always in the same order.
    pub fn iter(&self) -> impl Iterator<Item = &KnownObstacle> {
        self.slots[..self.count].iter().flatten()
    }

    pub fn count(&self) -> usize {
        self.count
    }
}

/// The first [`OBSTACLES_MAX`] obstacles, whose ids differ.
impl FromIterator<KnownObstacle> for ObstacleSet {
    fn from_iter<I: IntoIterator<Item = KnownObstacle>>(known: I) -> Self {
        let mut set = Self::default();
        set.fill(known);
        set
    }
}

#[cfg(test)]
mod tests {
    use cdcr_controller::robot::Shape;
    use nalgebra::Vector3;

    use super::*;

    const MS: u64 = 1_000_000;

    fn ball(id: u32, lifetime_ms: Option<u64>) -> KnownObstacle {
        let shape = Shape::Sphere {
            centre_m: Vector3::new(0.1, 0.0, 0.3),
        };
        KnownObstacle {
            id,
            source: 0,
            obstacle: Obstacle::new(shape, 0.02, Vector3::new(0.5, 0.0, -0.25)).unwrap(),
            measured_ns: 1000 * MS,
            expires_ns: lifetime_ms.map(|ms| (1000 + ms) * MS),
        }
    }

    fn ids(set: &ObstacleSet) -> Vec<u32> {
        set.iter().map(|known| known.id).collect()
    }

    #[test]
    fn an_id_is_known_once_and_removed_once() {
        let mut set = ObstacleSet::default();
        for id in [7, 8, 7, 9] {
            set.upsert(ball(id, None)).unwrap();
        }
        assert_eq!(ids(&set), [7, 8, 9]);
        set.remove(8);
        set.remove(8);
        assert_eq!((ids(&set), set.count()), (vec![7, 9], 2));
    }

    #[test]
    fn a_full_set_replaces_but_takes_no_more() {
        let mut set = ObstacleSet::default();
        for id in 0..64 {
            set.upsert(ball(id, None)).unwrap();
        }
        let before = set;
        assert_eq!(set.upsert(ball(64, None)), Err(SetIsFull));
        assert_eq!(set, before);
        set.upsert(ball(3, Some(1))).unwrap();
        set.remove(10);
        set.upsert(ball(64, None)).unwrap();
        assert_eq!(set.count(), 64);
    }

    #[test]
    fn lifetimes_count_from_the_stamp() {
        let mut set = ObstacleSet::default();
        set.upsert(ball(1, Some(30))).unwrap();
        set.upsert(ball(2, None)).unwrap();
        let ids_at = |set: &ObstacleSet, time_ns| ids(&set.iter_at(time_ns).collect());
        assert_eq!(ids_at(&set, 1030 * MS - 1), [1, 2]);
        assert_eq!(ids_at(&set, 1030 * MS), [2]);
        set.expire(1030 * MS);
        assert_eq!(ids(&set), [2]);
        assert_eq!(ids_at(&set, u64::MAX / 4), [0; 0], "gone to far away");
    }

    #[test]
    fn a_kept_obstacle_stands_where_its_source_saw_it_last() {
        let known = ball(1, Some(200));
        let place = |known: &KnownObstacle, time_ns| match known
            .advanced_to(time_ns)
            .unwrap()
            .obstacle
            .shape()
        {
            Shape::Sphere { centre_m } => *centre_m,
            Shape::Capsule { .. } => panic!("a ball"),
        };
        // Moves within its predicted time.
        let moving = known.kept(1100 * MS);
        assert_eq!(place(&moving, 1150 * MS), place(&known, 1150 * MS));
        let last = Vector3::new(0.2, 0.0, 0.25);
        let standing = known.kept(1300 * MS);
        for time_ns in [1200 * MS, 1300 * MS, 90_000 * MS] {
            assert!((place(&standing, time_ns) - last).norm() < 1e-15);
        }
        assert_eq!(ball(1, None).kept(1300 * MS), ball(1, None));
    }

    #[test]
    fn obstacles_move_from_their_stamp_to_the_release() {
        let known = ball(1, None);
        let centre = |time_ns| match known.advanced_to(time_ns).unwrap().obstacle.shape() {
            Shape::Sphere { centre_m } => *centre_m,
            Shape::Capsule { .. } => panic!("a ball"),
        };
        let later = centre(1200 * MS) - Vector3::new(0.2, 0.0, 0.25);
        let earlier = centre(999 * MS) - Vector3::new(0.0995, 0.0, 0.30025);
        assert!(later.norm() < 1e-15 && earlier.norm() < 1e-15);
        assert_eq!(known.advanced_to(1200 * MS).unwrap().measured_ns, 1200 * MS);
    }
}
