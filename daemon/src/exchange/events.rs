use std::collections::VecDeque;

use cdcr_shared_types::codes::{EventKind, Outcome};
use cdcr_shared_types::limits::EVENTS_MAX;
use cdcr_shared_types::{Header, InputEvent};

use crate::convert::Refused;

/// Events not yet reported, and the counts of all outcomes.
#[derive(Debug)]
pub(super) struct Events {
    queue: VecDeque<(u64, InputEvent)>,
    refusals_left: usize,
    outcomes: [u64; Outcome::COUNT],
    dropped: u64,
}

/// Events that can wait for a record. Accepted messages are few per gather: only a cycle thread that stalls
/// for seconds fills the queue.
const QUEUE_MAX: usize = 1024;
/// Refused measurements and requests that one gather reports individually; all are counted. A flood of
/// refused messages must not displace accepted ones. References and obstacles are few per gather: each is
/// reported.
pub(super) const REFUSALS_PER_GATHER: usize = 4;

impl Events {
    pub(super) fn new() -> Self {
        Self {
            queue: VecDeque::with_capacity(QUEUE_MAX),
            refusals_left: REFUSALS_PER_GATHER,
            outcomes: [0; Outcome::COUNT],
            dropped: 0,
        }
    }

    /// Lets a new gather report refusals again.
    pub(super) fn begin_gather(&mut self) {
        self.refusals_left = REFUSALS_PER_GATHER;
    }

    /// Counts a message by its outcome, and reports it.
    pub(super) fn note(
        &mut self,
        gather: u64,
        kind: EventKind,
        header: &Header,
        evaluated_ns: u64,
        result: Result<u32, Refused>,
    ) {
        let (outcome, detail) = match result {
            Ok(detail) => (Outcome::Accepted, detail),
            Err(Refused { outcome, detail }) => (outcome, detail),
        };
        self.count(outcome);
        let may_be_many = matches!(kind, EventKind::Measurement | EventKind::Request);
        if result.is_err() && may_be_many {
            if self.refusals_left == 0 {
                return;
            }
            self.refusals_left -= 1;
        }
        if self.queue.len() == QUEUE_MAX {
            self.dropped += 1;
        } else {
            let event = InputEvent {
                sender_id: header.sender_id,
                sequence: header.sequence,
                evaluated_ns,
                kind: kind.code(),
                outcome: outcome.code(),
                detail,
                gathers_ago: 0,
            };
            self.queue.push_back((gather, event));
        }
    }

    /// Counts an outcome without reporting it.
    pub(super) fn count(&mut self, outcome: Outcome) {
        self.outcomes[outcome.code() as usize] += 1;
    }

    /// Removes the events known to a cycle with the inputs of gather `newest`, as many as one record holds.
    pub(super) fn report(&mut self, newest: u64) -> ([InputEvent; EVENTS_MAX], usize) {
        let mut events = [InputEvent::default(); EVENTS_MAX];
        let mut count = 0;
        while count < EVENTS_MAX
            && let Some((gather, event)) = self.queue.front()
            && *gather <= newest
        {
            let gathers_ago = (newest - gather) as u32;
            events[count] = InputEvent {
                gathers_ago,
                ..*event
            };
            self.queue.pop_front();
            count += 1;
        }
        (events, count)
    }

    /// Events lost because no record could hold them.
    pub(super) fn dropped(&self) -> u64 {
        self.dropped
    }

    pub(super) fn outcomes(&self) -> &[u64; Outcome::COUNT] {
        &self.outcomes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn note(events: &mut Events, gather: u64, sequence: u64, result: Result<u32, Refused>) {
        let header = Header {
            sender_id: 1,
            sequence,
            sent_ns: 0,
        };
        events.note(gather, EventKind::Measurement, &header, 5, result);
    }

    #[test]
    fn records_get_what_their_gather_knew_and_the_rest_waits() {
        let mut events = Events::new();
        for sequence in 0..28 {
            note(&mut events, 1, sequence, Ok(0));
        }
        note(&mut events, 2, 99, Ok(0));
        assert_eq!(events.report(1).1, EVENTS_MAX);
        let (reported, count) = events.report(3);
        let late: Vec<_> = reported[..count]
            .iter()
            .map(|e| (e.sequence, e.gathers_ago))
            .collect();
        assert_eq!(late, [(24, 2), (25, 2), (26, 2), (27, 2), (99, 1)]);
    }

    #[test]
    fn a_flood_of_refusals_is_counted_but_not_reported_in_full() {
        let mut events = Events::new();
        for sequence in 0..1000 {
            note(
                &mut events,
                1,
                sequence,
                Err(Refused::whole(Outcome::NoLease)),
            );
        }
        note(&mut events, 1, 7, Ok(0));
        assert_eq!(events.outcomes()[Outcome::NoLease.code() as usize], 1000);
        let (reported, count) = events.report(1);
        assert_eq!(count, REFUSALS_PER_GATHER + 1);
        assert_eq!(
            reported[REFUSALS_PER_GATHER].outcome,
            Outcome::Accepted.code()
        );
    }
}
