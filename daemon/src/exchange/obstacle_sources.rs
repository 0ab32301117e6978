//! Supervision of the clients that send obstacles: the heartbeat of perception.
//!
//! A source is a client that has sent an obstacle with a limited lifetime, and must therefore send again. An
//! obstacle whose lifetime is over expires while its source is alive. When the source is dead, the place of
//! the obstacle is unknown, and it must not disappear.
//!
//! A source that has removed its last obstacle may end: none of its obstacles can disappear any more. The watch
//! over a silent one ends when others have taken over or removed all that it left.

use cdcr_shared_types::codes::ObstacleAction;
use cdcr_shared_types::limits::OBSTACLES_MAX;
use cdcr_shared_types::{Obstacle, ObstacleUpdate};

use crate::config::{ObstaclesConfig, SourceSilent, ns};
use crate::obstacles::{KnownObstacle, ObstacleSet};

/// Sources that can be watched at one time: one for each obstacle in the list.
const SOURCES_MAX: usize = OBSTACLES_MAX;

/// All watched sources, with the times of their newest messages.
#[derive(Debug)]
pub(super) struct ObstacleSources {
    /// A source that sends nothing for longer is silent \[ns\]; 0: no source is watched.
    timeout_ns: u64,
    holds: bool,
    sources: Vec<ObstacleSource>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct ObstacleSource {
    sender: u64,
    /// Time at which its newest message was sent \[ns\]: the message describes its obstacles at that time.
    sent_ns: u64,
    /// Begin of its silence \[ns\], shifted by the time without gathers.
    silent_since_ns: u64,
    /// The newest obstacle with a lifetime that it sent. It names the source when all others have expired, too.
    newest_id: u32,
    /// Since its newest message another client has replaced or removed one of its obstacles.
    is_relieved: bool,
}

impl ObstacleSources {
    pub(super) fn new(config: &ObstaclesConfig) -> Self {
        Self {
            timeout_ns: ns(config.source_timeout_ms),
            holds: config.source_silent == SourceSilent::Hold,
            sources: Vec::with_capacity(SOURCES_MAX),
        }
    }

    /// True if the sender of `update` is already watched, need not be watched, or can be added.
    pub(super) fn has_space_for(&self, update: &ObstacleUpdate) -> bool {
        let is_known = self.watched(update.header.sender_id).is_some();
        is_known || !self.begins_source(update) || self.sources.len() < SOURCES_MAX
    }

    /// Registers an update received at `now_ns`. It may have waited since it was sent, and its sender may
    /// have died meanwhile. Clearing the list ends the watch over all sources. Each is watched again from its
    /// next obstacle with a lifetime.
    pub(super) fn note_update(&mut self, update: &ObstacleUpdate, now_ns: u64) {
        let heard = |newest_id| ObstacleSource {
            sender: update.header.sender_id,
            sent_ns: update.header.sent_ns.min(now_ns),
            silent_since_ns: now_ns,
            newest_id,
            is_relieved: false,
        };
        let newest_id = newest_id(update);
        if update.action == ObstacleAction::Clear.code() {
            self.sources.clear();
        } else if let Some(known) = self
            .sources
            .iter_mut()
            .find(|known| known.sender == update.header.sender_id)
        {
            *known = heard(newest_id.unwrap_or(known.newest_id));
        } else if let Some(id) = newest_id.filter(|_| self.timeout_ns > 0)
            && self.sources.len() < SOURCES_MAX
        {
            self.sources.push(heard(id));
        }
    }

    /// Registers whose obstacles `update`, which was accepted, replaces or removes. `before` is the list before it.
    pub(super) fn note_relief(&mut self, update: &ObstacleUpdate, before: &ObstacleSet) {
        let names = |id: u32| given(update).any(|obstacle| obstacle.id == id);
        let sender = update.header.sender_id;
        for source in (self.sources.iter_mut()).filter(|source| source.sender != sender) {
            let is_own = |known: &KnownObstacle| known.source == source.sender && names(known.id);
            source.is_relieved |= names(source.newest_id) || before.iter().any(is_own);
        }
    }

    /// Ends the watch over each silent source whose obstacles other clients have replaced or removed, so that
    /// none of those in `known` is its own.
    pub(super) fn unwatch_relieved(&mut self, known: &ObstacleSet, now_ns: u64) {
        let timeout_ns = self.timeout_ns;
        self.sources.retain(|source| {
            let is_silent = now_ns.saturating_sub(source.silent_since_ns) > timeout_ns;
            let is_left = |known: &KnownObstacle| known.source == source.sender;
            !(source.is_relieved && is_silent) || known.iter().any(is_left)
        });
    }

    /// Ends the watch over `sender`, which has removed obstacles, if none of those left in `known` is its
    /// own. Expired obstacles do not count: their source was alive after their end.
    pub(super) fn unwatch_if_empty(&mut self, sender: u64, known: &ObstacleSet, now_ns: u64) {
        let is_left =
            |known: &KnownObstacle| known.source == sender && !self.is_expired(known, now_ns);
        if !known.iter().any(is_left) {
            self.sources.retain(|source| source.sender != sender);
        }
    }

    /// Excludes the `paused_ns` after `before_ns`, a time without gathers, from the silence of sources that
    /// were not silent before.
    pub(super) fn extend(&mut self, before_ns: u64, paused_ns: u64) {
        for source in &mut self.sources {
            if before_ns.saturating_sub(source.silent_since_ns) <= self.timeout_ns {
                source.silent_since_ns += paused_ns;
            }
        }
    }

    /// The source that is silent at `now_ns` since the earliest time, and that time \[ns\].
    pub(super) fn silent(&self, now_ns: u64) -> Option<(u64, u64)> {
        let earliest = (self.sources.iter()).min_by_key(|source| source.silent_since_ns)?;
        let since_ns = earliest.silent_since_ns;
        let is_silent = now_ns.saturating_sub(since_ns) > self.timeout_ns;
        is_silent.then_some((earliest.sender, since_ns))
    }

    /// True if a source is silent at `now_ns` and the robot has to hold.
    pub(super) fn requires_hold(&self, now_ns: u64) -> bool {
        self.holds && self.silent(now_ns).is_some()
    }

    /// True if `known` is expired at `now_ns`: its lifetime is over, and its source, if watched, has sent a
    /// message since without renewing it.
    pub(super) fn is_expired(&self, known: &KnownObstacle, now_ns: u64) -> bool {
        let sent_since = |source: &ObstacleSource| !known.is_known_at(source.sent_ns);
        !known.is_known_at(now_ns) && self.watched(known.source).is_none_or(sent_since)
    }

    /// The obstacle for the cycles until the next gather: an obstacle of a watched source does not expire by
    /// itself.
    pub(super) fn hand_over(&self, known: &KnownObstacle, now_ns: u64) -> KnownObstacle {
        if self.watched(known.source).is_some() && !self.is_expired(known, now_ns) {
            known.kept(now_ns)
        } else {
            *known
        }
    }

    fn watched(&self, sender: u64) -> Option<&ObstacleSource> {
        self.sources.iter().find(|source| source.sender == sender)
    }

    fn begins_source(&self, update: &ObstacleUpdate) -> bool {
        self.timeout_ns > 0 && newest_id(update).is_some()
    }
}

/// The last obstacle with a lifetime that `update` inserts or replaces.
fn newest_id(update: &ObstacleUpdate) -> Option<u32> {
    let is_upsert = update.action == ObstacleAction::Upsert.code();
    let with_lifetime = given(update).filter(|obstacle| is_upsert && obstacle.lifetime_ns > 0);
    with_lifetime.last().map(|obstacle| obstacle.id)
}

fn given(update: &ObstacleUpdate) -> impl Iterator<Item = &Obstacle> {
    update.obstacles.iter().take(update.count as usize)
}

#[cfg(test)]
mod tests {
    use cdcr_shared_types::Header;

    use super::*;
    use crate::convert;

    const MS: u64 = 1_000_000;

    fn sources(source_silent: SourceSilent) -> ObstacleSources {
        ObstacleSources::new(&ObstaclesConfig {
            source_timeout_ms: 100.0,
            source_silent,
        })
    }

    fn update(sender_id: u64, action: ObstacleAction, lifetimes_ms: &[u64]) -> ObstacleUpdate {
        let mut update = ObstacleUpdate {
            header: Header {
                sender_id,
                ..Header::default()
            },
            action: action.code(),
            count: lifetimes_ms.len() as u32,
            ..ObstacleUpdate::default()
        };
        for (obstacle, lifetime_ms) in update.obstacles.iter_mut().zip(lifetimes_ms) {
            obstacle.lifetime_ns = lifetime_ms * MS;
        }
        update
    }

    fn note_update(
        sources: &mut ObstacleSources,
        sender: u64,
        action: ObstacleAction,
        lifetimes_ms: &[u64],
        at_ns: u64,
    ) {
        let mut update = update(sender, action, lifetimes_ms);
        update.header.sent_ns = at_ns;
        sources.note_update(&update, at_ns);
    }

    fn known(source: u64, lifetime_ms: u64) -> KnownObstacle {
        let message = Obstacle {
            lifetime_ns: lifetime_ms * MS,
            ..Obstacle::default()
        };
        let obstacle = convert::obstacle(&message, 0).unwrap();
        KnownObstacle { source, ..obstacle }
    }

    #[test]
    fn only_who_sends_obstacles_with_a_lifetime_is_watched() {
        let mut sources = sources(SourceSilent::Hold);
        note_update(&mut sources, 1, ObstacleAction::Upsert, &[0, 0], 0);
        note_update(&mut sources, 2, ObstacleAction::Remove, &[5], 0);
        assert!(!sources.requires_hold(10_000 * MS));
        note_update(&mut sources, 3, ObstacleAction::Upsert, &[0, 50], 0);
        assert!(!sources.requires_hold(100 * MS) && sources.requires_hold(100 * MS + 1));
        // Any message counts as a sign of life.
        note_update(&mut sources, 3, ObstacleAction::Upsert, &[], 500 * MS);
        assert!(!sources.requires_hold(600 * MS) && sources.requires_hold(601 * MS));
        // Messages of another source do not count.
        note_update(&mut sources, 4, ObstacleAction::Upsert, &[50], 600 * MS);
        assert!(sources.requires_hold(601 * MS));
        assert_eq!(sources.silent(600 * MS), None);
        assert_eq!(sources.silent(10_000 * MS), Some((3, 500 * MS)));
        // An operator's clear ends the watch.
        note_update(&mut sources, 9, ObstacleAction::Clear, &[], 700 * MS);
        assert!(!sources.requires_hold(10_000 * MS));
    }

    #[test]
    fn without_a_timeout_nobody_is_watched() {
        let mut sources = ObstacleSources::new(&ObstaclesConfig::default());
        note_update(&mut sources, 1, ObstacleAction::Upsert, &[50], 0);
        assert!(!sources.requires_hold(u64::MAX));
        assert!(sources.is_expired(&known(1, 50), 50 * MS));
        assert_eq!(sources.hand_over(&known(1, 50), 0), known(1, 50));
    }

    #[test]
    fn an_obstacle_expires_when_its_source_lives_and_does_not_renew_it() {
        for rule in [SourceSilent::Hold, SourceSilent::Keep] {
            let mut sources = sources(rule);
            note_update(&mut sources, 1, ObstacleAction::Upsert, &[50], 0);
            let known = known(1, 50);
            // Until the source sends again, it may be dead.
            for now_ns in [49 * MS, 50 * MS, 90 * MS, 10_000 * MS] {
                assert!(!sources.is_expired(&known, now_ns), "{now_ns}");
                assert_eq!(sources.hand_over(&known, now_ns).expires_ns, None);
            }
            assert_eq!(
                sources.requires_hold(10_000 * MS),
                rule == SourceSilent::Hold
            );
            note_update(&mut sources, 1, ObstacleAction::Upsert, &[], 49 * MS);
            assert!(!sources.is_expired(&known, 90 * MS));
            note_update(&mut sources, 1, ObstacleAction::Upsert, &[], 60 * MS);
            assert!(sources.is_expired(&known, 60 * MS));
            assert_eq!(sources.hand_over(&known, 60 * MS), known);
        }
    }

    #[test]
    fn a_source_that_removed_its_last_obstacle_may_end_and_one_with_an_obstacle_left_may_not() {
        let set = |known: &[KnownObstacle]| known.iter().copied().collect::<ObstacleSet>();
        let (short, long) = (known(1, 50), known(1, 5000));
        let removes = |left: &[KnownObstacle], at_ms: u64| {
            let mut sources = sources(SourceSilent::Hold);
            note_update(&mut sources, 1, ObstacleAction::Upsert, &[50, 5000], 0);
            note_update(&mut sources, 2, ObstacleAction::Upsert, &[50], 0);
            note_update(&mut sources, 1, ObstacleAction::Remove, &[0], at_ms * MS);
            sources.unwatch_if_empty(1, &set(left), at_ms * MS);
            let is_watched = sources.watched(1).is_some();
            assert!(sources.watched(2).is_some() && sources.requires_hold(10_000 * MS));
            is_watched
        };
        assert!(!removes(&[], 10));
        assert!(
            !removes(&[known(2, 50), known(0, 50)], 10),
            "another's stay"
        );
        assert!(removes(&[long], 10) && removes(&[short], 10));
        // Its source was alive after the short one expired, and removed the other.
        assert!(removes(&[short], 49) && !removes(&[short], 50));
        assert!(removes(&[short, long], 60));
    }

    #[test]
    fn time_in_which_nobody_listened_does_not_count() {
        let mut sources = sources(SourceSilent::Hold);
        note_update(&mut sources, 1, ObstacleAction::Upsert, &[50], 0);
        sources.extend(90 * MS, 400 * MS);
        assert!(!sources.requires_hold(500 * MS) && sources.requires_hold(501 * MS));
        // A source that was silent before remains silent.
        sources.extend(600 * MS, 900 * MS);
        assert!(sources.requires_hold(601 * MS));
    }

    #[test]
    fn what_a_source_did_not_live_to_see_does_not_expire() {
        let mut sources = sources(SourceSilent::Hold);
        let known = known(1, 50);
        note_update(&mut sources, 1, ObstacleAction::Upsert, &[50], 0);
        // The daemon stalls for longer than the obstacle's lifetime: its source may be alive or dead.
        sources.extend(10 * MS, 400 * MS);
        for now_ns in [51 * MS, 401 * MS, 10_000 * MS] {
            assert!(!sources.is_expired(&known, now_ns), "{now_ns}");
            assert_eq!(sources.hand_over(&known, now_ns).expires_ns, None);
        }
        // The same for a message that waited meanwhile.
        let mut waited = update(1, ObstacleAction::Upsert, &[]);
        waited.header.sent_ns = 49 * MS;
        sources.note_update(&waited, 410 * MS);
        assert!(!sources.is_expired(&known, 410 * MS));
        assert!(!sources.requires_hold(510 * MS) && sources.requires_hold(511 * MS));
        // A time stamp in the future counts as the present.
        waited.header.sent_ns = u64::MAX;
        sources.note_update(&waited, 45 * MS);
        assert!(!sources.is_expired(&known, 10_000 * MS));
        note_update(&mut sources, 1, ObstacleAction::Upsert, &[], 50 * MS);
        assert!(sources.is_expired(&known, 50 * MS));
    }

    #[test]
    fn there_is_room_for_so_many_sources() {
        let mut sources = sources(SourceSilent::Keep);
        for sender in 0..SOURCES_MAX as u64 {
            let update = update(sender, ObstacleAction::Upsert, &[50]);
            assert!(sources.has_space_for(&update));
            sources.note_update(&update, 0);
        }
        assert!(sources.has_space_for(&update(0, ObstacleAction::Upsert, &[50])));
        assert!(!sources.has_space_for(&update(99, ObstacleAction::Upsert, &[50])));
        assert!(sources.has_space_for(&update(99, ObstacleAction::Upsert, &[0])));
    }
}
