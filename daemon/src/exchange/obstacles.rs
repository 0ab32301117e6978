use cdcr_shared_types::ObstacleUpdate;
use cdcr_shared_types::codes::{ObstacleAction, Outcome};

use super::obstacle_sources::ObstacleSources;
use crate::config::ObstaclesConfig;
use crate::convert::{self, Refused};
use crate::obstacles::ObstacleSet;

/// The obstacles that clients have told of, and who they are.
#[derive(Debug)]
pub(super) struct Obstacles {
    known: ObstacleSet,
    sources: ObstacleSources,
    /// When the newest message was sent that cleared the list \[ns\].
    cleared_ns: u64,
    refused: u64,
}

impl Obstacles {
    pub(super) fn new(config: &ObstaclesConfig) -> Self {
        Self {
            known: ObstacleSet::default(),
            sources: ObstacleSources::new(config),
            cleared_ns: 0,
            refused: 0,
        }
    }

    /// Nobody listened for `unheard_ns` after `heard_ns`: that is no silence of the sources.
    pub(super) fn extend(&mut self, heard_ns: u64, unheard_ns: u64) {
        self.sources.extend(heard_ns, unheard_ns);
    }

    /// Forgets those that are out of date.
    pub(super) fn let_expire(&mut self, now_ns: u64) {
        let sources = &self.sources;
        self.known
            .retain(|known| !sources.let_expire(known, now_ns));
    }

    /// Takes an update whole, or refuses it whole. Says how many obstacles are known after it. `gather_ns`: when the gather
    /// began.
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

    /// Whether the list was cleared after `update` was sent: senders are served in turn, and it waited longer than another's clear.
    /// One that does not say when it was sent is not older than anything.
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
        let updated = if self.sources.have_room_for(update) {
            convert::updated_obstacles(update, &self.known, now_ns)
        } else {
            Err(full)
        };
        // Where there is no room, its own obstacles that are out of date may take it: they go when their source is heard.
        let is_full = |refused: &Refused| refused.outcome == full.outcome;
        if updated.as_ref().err().is_none_or(is_full) {
            self.sources.hear(update, gather_ns);
        }
        self.known = updated?;
        if update.action == ObstacleAction::Clear.code() {
            self.cleared_ns = self.cleared_ns.max(update.header.sent_ns.min(now_ns));
        }
        if update.action == ObstacleAction::Remove.code() {
            let sender = update.header.sender_id;
            self.sources.let_leave(sender, &self.known, now_ns);
        }
        Ok(self.known.count() as u32)
    }

    /// Fills in the obstacles as the cycles until the next gather see them.
    pub(super) fn hand_over(&self, obstacles: &mut ObstacleSet, now_ns: u64) {
        let known = self.known.iter();
        obstacles.fill(known.map(|known| self.sources.hand_over(known, now_ns)));
    }

    /// Whether the robot has to hold, because a source is silent.
    pub(super) fn want_hold(&self, now_ns: u64) -> bool {
        self.sources.want_hold(now_ns)
    }

    pub(super) fn refused(&self) -> u64 {
        self.refused
    }

    #[cfg(test)]
    pub(super) fn known(&self) -> &ObstacleSet {
        &self.known
    }
}
