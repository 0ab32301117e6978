use cdcr_shared_types::ObstacleUpdate;
use cdcr_shared_types::codes::{ObstacleAction, Outcome};

use super::obstacle_sources::ObstacleSources;
use crate::config::ObstaclesConfig;
use crate::convert::{self, Refused};
use crate::kept_obstacles::KeptObstacles;
use crate::obstacles::ObstacleSet;

/// The obstacles sent by clients, and their sources.
#[derive(Debug)]
pub(super) struct Obstacles {
    known: ObstacleSet,
    /// Those of them that the next daemon will know.
    kept: KeptObstacles,
    sources: ObstacleSources,
    /// Time at which the newest message that cleared the list was sent \[ns\].
    cleared_ns: u64,
    refused: u64,
}

impl Obstacles {
    pub(super) fn new(config: &ObstaclesConfig) -> Self {
        Self {
            known: ObstacleSet::default(),
            kept: KeptObstacles::default(),
            sources: ObstacleSources::new(config),
            cleared_ns: 0,
            refused: 0,
        }
    }

    /// Begins with the obstacles of the daemon before, and keeps its own for the next.
    pub(super) fn keep(&mut self, kept: KeptObstacles) {
        self.known = kept.read().unwrap_or_default();
        self.kept = kept;
    }

    /// Excludes the `paused_ns` after `paused_since_ns`, a time without gathers, from the silence of the sources.
    pub(super) fn extend(&mut self, paused_since_ns: u64, paused_ns: u64) {
        self.sources.extend(paused_since_ns, paused_ns);
    }

    /// Removes expired obstacles.
    pub(super) fn remove_expired(&mut self, now_ns: u64) {
        let sources = &self.sources;
        self.known
            .retain(|known| !sources.is_expired(known, now_ns));
    }

    /// Accepts or refuses an update as a whole. Returns the number of obstacles after it. `gather_ns` is the
    /// start of the gather.
    pub(super) fn take(
        &mut self,
        update: &ObstacleUpdate,
        is_newer: bool,
        gather_ns: u64,
        now_ns: u64,
    ) -> Result<u32, Refused> {
        let result = if is_newer && !self.is_cleared(update) {
            self.take_newer(update, gather_ns, now_ns)
        } else {
            Err(Refused::whole(Outcome::Stale))
        };
        self.refused += u64::from(result.is_err());
        result
    }

    /// True if the list was cleared after `update` was sent: senders are served in turn, so an update may
    /// wait longer than another sender's clear. An update without a time of sending never counts as older.
    fn is_cleared(&self, update: &ObstacleUpdate) -> bool {
        (1..self.cleared_ns).contains(&update.header.sent_ns)
    }

    fn take_newer(
        &mut self,
        update: &ObstacleUpdate,
        gather_ns: u64,
        now_ns: u64,
    ) -> Result<u32, Refused> {
        let full = Refused::whole(Outcome::BufferFull);
        let updated = if self.sources.has_space_for(update) {
            convert::updated_obstacles(update, &self.known, now_ns)
        } else {
            Err(full)
        };
        // If the list is full, expired obstacles of the sender may occupy it: they are removed once their
        // source is heard.
        let is_full = |refused: &Refused| refused.outcome == full.outcome;
        if updated.as_ref().err().is_none_or(is_full) {
            self.sources.note_update(update, gather_ns);
        }
        let updated = updated?;
        self.sources.note_relief(update, &self.known);
        // Before the sender can learn that it was accepted.
        self.kept.update(&self.known, &updated);
        self.known = updated;
        if update.action == ObstacleAction::Clear.code() {
            self.cleared_ns = self.cleared_ns.max(update.header.sent_ns.min(now_ns));
        }
        if update.action == ObstacleAction::Remove.code() {
            let sender = update.header.sender_id;
            self.sources.unwatch_if_empty(sender, &self.known, now_ns);
        }
        Ok(self.known.count() as u32)
    }

    /// Ends the watch over each silent source whose obstacles other clients have taken over or removed.
    pub(super) fn unwatch_relieved(&mut self, now_ns: u64) {
        self.sources.unwatch_relieved(&self.known, now_ns);
    }

    /// Writes the obstacles for the cycles until the next gather.
    pub(super) fn hand_over(&self, obstacles: &mut ObstacleSet, now_ns: u64) {
        let known = self.known.iter();
        obstacles.fill(known.map(|known| self.sources.hand_over(known, now_ns)));
    }

    /// The source that is silent since the earliest time, and that time \[ns\].
    pub(super) fn silent_source(&self, now_ns: u64) -> Option<(u64, u64)> {
        self.sources.silent(now_ns)
    }

    /// A source is silent, and the robot has to hold.
    pub(super) fn requires_hold(&self, now_ns: u64) -> bool {
        self.sources.requires_hold(now_ns)
    }

    pub(super) fn refused(&self) -> u64 {
        self.refused
    }

    #[cfg(test)]
    pub(super) fn known(&self) -> &ObstacleSet {
        &self.known
    }
}
