use std::collections::BTreeSet;

use cdcr_client::obstacles;
use cdcr_shared_types::{Obstacle, Telemetry};

use super::unknown_text;

/// So many sent ids are remembered: a feed that runs for days may have a new one for each obstacle that it sees.
const SENT_MAX: usize = 10_000;
/// So many removed ids are named.
const NAMED_MAX: usize = 20;

/// The removed ids that nobody had: the daemon does not report which it knew.
#[derive(Debug)]
pub(super) struct Removals {
    /// What the daemon knew by the newest record; `None` before the first.
    known: Option<BTreeSet<u32>>,
    /// What this program sent and has not removed: such an obstacle may have expired. `None`: it sent too many.
    sent: Option<BTreeSet<u32>>,
    unknown: BTreeSet<u32>,
}

impl Default for Removals {
    fn default() -> Self {
        Self {
            known: None,
            sent: Some(BTreeSet::new()),
            unknown: BTreeSet::new(),
        }
    }
}

impl Removals {
    pub(super) fn see(&mut self, record: &Telemetry) {
        self.known = Some(obstacles(record).iter().map(|known| known.id).collect());
    }

    pub(super) fn sent(&mut self, obstacles: &[Obstacle]) {
        let Some(sent) = &mut self.sent else {
            return;
        };
        sent.extend(obstacles.iter().map(|known| known.id));
        if sent.len() > SENT_MAX {
            self.sent = None;
        }
    }

    /// The daemon has removed these, after the newest record.
    pub(super) fn removed(&mut self, ids: &[u32]) {
        let (Some(known), Some(sent)) = (&self.known, &mut self.sent) else {
            return;
        };
        for id in ids.iter().collect::<BTreeSet<_>>() {
            let was_known = sent.remove(id) || known.contains(id);
            // One more than is named shows that there are others.
            if !was_known && self.unknown.len() <= NAMED_MAX {
                self.unknown.insert(*id);
            }
        }
    }

    /// Names the removed ids that nobody had, if there were some.
    pub(super) fn text(&self) -> Option<String> {
        let named: Vec<_> = self.unknown.iter().copied().take(NAMED_MAX).collect();
        let text = unknown_text(&named, &[])?;
        let others = if self.unknown.len() > NAMED_MAX {
            ", nor with others that were removed"
        } else {
            ""
        };
        Some(format!("{text}{others}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(ids: &[u32]) -> Telemetry {
        let mut record = Telemetry {
            obstacle_count: ids.len() as u32,
            ..Telemetry::default()
        };
        for (obstacle, id) in record.obstacles.iter_mut().zip(ids) {
            obstacle.id = *id;
        }
        record
    }

    fn obstacle(id: u32) -> Obstacle {
        Obstacle {
            id,
            ..Obstacle::default()
        }
    }

    #[test]
    fn a_removed_id_is_named_if_neither_the_daemon_nor_this_program_had_it() {
        let mut removals = Removals::default();
        // Nothing is known of what the daemon knows.
        removals.removed(&[8]);
        removals.see(&seen(&[1]));
        removals.sent(&[obstacle(2)]);
        removals.removed(&[1, 2, 2]);
        assert_eq!(removals.text(), None);
        // It was removed already.
        removals.see(&seen(&[]));
        removals.removed(&[2, 9, 9]);
        let text = removals.text();
        assert_eq!(
            text.as_deref(),
            Some("no obstacle with id 2, 9 was known to the daemon")
        );
    }

    #[test]
    fn a_feed_of_days_keeps_few_ids() {
        let mut removals = Removals::default();
        removals.see(&seen(&[]));
        for id in 0..1000 {
            removals.removed(&[id]);
        }
        assert_eq!(removals.unknown.len(), NAMED_MAX + 1);
        let text = removals.text().expect("unknown");
        assert!(
            text.contains("18, 19 was known to the daemon, nor with others"),
            "{text}"
        );
        for id in 0..20_000 {
            removals.sent(&[obstacle(id)]);
            removals.removed(&[id]);
        }
        assert_eq!(removals.sent, Some(BTreeSet::new()));
        // These expire: what was sent is not told any more from what nobody had.
        for id in 0..20_000 {
            removals.sent(&[obstacle(id)]);
        }
        assert_eq!(removals.sent, None);
        removals.removed(&[30_000]);
        assert!(!removals.unknown.contains(&30_000));
    }
}
