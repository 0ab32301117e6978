//! A request is sent → its answer is in the client's hands.
//!
//! The exchange answers a renewal of the lease in the gather that takes it; the cycle decides a request
//! about the mode, and the exchange answers it after the command of that cycle has left. The daemon's last look,
//! between the gather and the release, takes requests, too: then `grid` is 0 for a request to track, and
//! `machinery` is the whole; a renewal of the lease has waited until that look.
//!
//! The port here looks without rest; the connection of `cdcr_client` looks each millisecond.

use std::collections::VecDeque;

use anyhow::{Result, ensure};
use cdcr_client::{events, monotonic_ns};
use cdcr_shared_types::Command;
use cdcr_shared_types::codes::{EventKind, Outcome, RequestKind};

use super::asker::{Answer, Asker};
use super::hands::{Errand, Grid, Hands, Seen};
use super::inputs::WARM_UP;
use super::leg::Way;
use super::phase::Phases;
use super::round::{Passage, Round};

/// What is asked in turn: nothing that changes anything while the robot follows.
const KINDS: [RequestKind; 2] = [RequestKind::AcquireLease, RequestKind::Track];
const GAP: u64 = 2;

/// Asks each second period, at phases spread over the period.
pub(super) struct Requests {
    asker: Asker,
    grid: Grid,
    samples: usize,
    phases: Phases,
    asked: usize,
    recorded: [usize; KINDS.len()],
    answered: VecDeque<Answer>,
    due_ns: u64,
}

impl Requests {
    /// `samples` of each kind that count.
    pub(super) fn new(hands: &Hands, asker: Asker, samples: usize) -> Self {
        let mut requests = Self {
            asker,
            grid: hands.grid,
            samples,
            phases: Phases::default(),
            asked: 0,
            recorded: [0; KINDS.len()],
            answered: VecDeque::new(),
            due_ns: 0,
        };
        requests.plan();
        requests
    }

    pub(super) fn into_asker(self) -> Asker {
        self.asker
    }

    fn plan(&mut self) {
        let cycle = self.grid.cycle_at(self.due_ns) + GAP;
        let cycle = cycle.max(self.grid.cycle_at(monotonic_ns()) + 1);
        self.due_ns = self.grid.release_ns(cycle) + self.phases.next_ns(self.grid.period_ns);
    }
}

impl Errand for Requests {
    fn awake_before_ns(&self, grid: &Grid) -> u64 {
        grid.lead_ns + grid.early_ns()
    }

    fn due_ns(&self) -> u64 {
        // One at a time: a daemon that was late answers first.
        if self.asker.waits_since_ns().is_some() {
            u64::MAX
        } else {
            self.due_ns
        }
    }

    fn act(&mut self, _newest: Option<&Command>) -> Result<()> {
        self.asker.ask(KINDS[self.asked % KINDS.len()])?;
        self.asked += 1;
        self.plan();
        Ok(())
    }

    fn look(&mut self, release_ns: u64) -> Result<bool> {
        let Some(answer) = self.asker.look()? else {
            let waits_since_ns = self.asker.waits_since_ns();
            // The gather may come late, and take what was sent until shortly before the release.
            return Ok(waits_since_ns.is_none_or(|sent_ns| sent_ns >= release_ns));
        };
        ensure!(
            answer.response.outcome == Outcome::Accepted.code(),
            "cannot {}: {}",
            answer.kind,
            Outcome::text_of(answer.response.outcome)
        );
        if self.asked > WARM_UP * KINDS.len() {
            self.answered.push_back(answer);
        }
        Ok(true)
    }

    fn seen(&mut self, cycle: &Seen<'_>, round: &mut Round) -> Result<()> {
        for event in events(cycle.record) {
            let is_it = |answer: &Answer| {
                event.kind == EventKind::Request.code()
                    && event.sender_id == self.asker.sender_id()
                    && event.sequence == answer.sequence
                    && event.detail == answer.kind.code()
            };
            let Some(at) = self.answered.iter().position(is_it) else {
                continue;
            };
            let Some(answer) = self.answered.remove(at) else {
                continue;
            };
            let (kind, way, gather_ns) = if answer.kind == RequestKind::AcquireLease {
                (0, Way::LEASE, event.judged_ns)
            } else {
                (1, Way::TRACK, cycle.record.gather_ns)
            };
            self.recorded[kind] += 1;
            let passage = Passage {
                sent_ns: answer.sent_ns,
                gather_ns,
                received_ns: answer.received_ns,
            };
            round.record_way(way, &passage);
        }
        Ok(())
    }

    fn is_done(&self) -> bool {
        self.recorded
            .iter()
            .all(|recorded| *recorded >= self.samples)
            && self.asker.waits_since_ns().is_none()
    }

    fn turns(&self) -> u64 {
        2 * GAP * (KINDS.len() * (self.samples + WARM_UP)) as u64 + 1000
    }
}
