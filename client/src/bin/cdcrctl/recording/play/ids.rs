use std::collections::BTreeSet;

use cdcr_shared_types::codes::ObstacleAction;
use cdcr_shared_types::{Obstacle, ObstacleUpdate};

/// Which obstacles a replay has added, and which it must not touch.
#[derive(Debug, Default)]
pub(super) struct Ids {
    /// Added by this replay, and neither removed by it nor replaced by another client.
    added: BTreeSet<u32>,
    /// Obstacles of others among those of the recording.
    others: BTreeSet<u32>,
    recorded: BTreeSet<u32>,
}

impl Ids {
    /// For a recording with obstacles `recorded`, beside `live` ones.
    pub(super) fn new(recorded: BTreeSet<u32>, live: &[Obstacle]) -> Self {
        let live = live.iter().map(|obstacle| obstacle.id);
        Self {
            added: BTreeSet::new(),
            others: live.filter(|id| recorded.contains(id)).collect(),
            recorded,
        }
    }

    /// Those of the recording that others have in use.
    pub(super) fn in_use(&self) -> Vec<u32> {
        self.others.iter().copied().collect()
    }

    /// Registers obstacles to be inserted. Leaves out those of others.
    pub(super) fn add(&mut self, obstacles: &mut Vec<Obstacle>) {
        obstacles.retain(|obstacle| !self.others.contains(&obstacle.id));
        self.added.extend(obstacles.iter().map(|it| it.id));
    }

    /// Those of `ids` that this replay has added: they are to be removed.
    pub(super) fn remove(&mut self, ids: impl IntoIterator<Item = u32>) -> Vec<u32> {
        let is_added = |id: &u32| self.added.remove(id);
        ids.into_iter().filter(is_added).collect()
    }

    /// All that this replay has added: they are to be removed.
    pub(super) fn take_all(&mut self) -> Vec<u32> {
        std::mem::take(&mut self.added).into_iter().collect()
    }

    /// Registers an update of another client. Returns the ids that are its own from now on.
    pub(super) fn see(&mut self, update: &ObstacleUpdate) -> Vec<u32> {
        if update.action != ObstacleAction::Upsert.code() {
            return Vec::new();
        }
        let given = update.obstacles.iter().take(update.count as usize);
        let recorded = given
            .map(|obstacle| obstacle.id)
            .filter(|id| self.recorded.contains(id));
        let mut taken = Vec::new();
        for id in recorded {
            self.added.remove(&id);
            if self.others.insert(id) {
                taken.push(id);
            }
        }
        taken
    }
}

/// Ids as a list, between them `separator`.
pub(super) fn listed(ids: &[u32], separator: &str) -> String {
    let ids: Vec<_> = ids.iter().map(u32::to_string).collect();
    ids.join(separator)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn obstacles(ids: &[u32]) -> Vec<Obstacle> {
        let with_id = |&id: &u32| Obstacle {
            id,
            ..Obstacle::default()
        };
        ids.iter().map(with_id).collect()
    }

    fn added(ids: &mut Ids, wanted: &[u32]) -> Vec<u32> {
        let mut sent = obstacles(wanted);
        ids.add(&mut sent);
        sent.iter().map(|obstacle| obstacle.id).collect()
    }

    #[test]
    fn only_what_the_replay_has_added_is_replaced_or_removed() {
        let mut ids = Ids::new(BTreeSet::from([1, 2, 3, 4]), &obstacles(&[1, 5]));
        assert_eq!(ids.in_use(), [1]);
        assert_eq!(added(&mut ids, &[1, 2, 3, 4]), [2, 3, 4]);
        assert_eq!(ids.remove([1, 2, 5]), [2]);
        assert_eq!(ids.remove([2]), [0; 0], "already removed");
        // Another client declares 3 and 6 meanwhile, and refreshes 1.
        let mut update = ObstacleUpdate {
            count: 3,
            ..ObstacleUpdate::default()
        };
        update.obstacles[..3].copy_from_slice(&obstacles(&[3, 6, 1]));
        assert_eq!(ids.see(&update), [3]);
        assert_eq!(ids.see(&update), [0; 0]);
        assert_eq!(added(&mut ids, &[3, 2]), [2]);
        assert_eq!((ids.take_all(), ids.take_all()), (vec![2, 4], vec![]));
    }
}
