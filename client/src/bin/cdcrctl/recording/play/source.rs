use std::collections::{BTreeMap, BTreeSet};

use cdcr_client::{events, obstacles};
use cdcr_shared_types::codes::{EventKind, Mode, ObstacleAction, Outcome, Reason};
use cdcr_shared_types::limits::OBSTACLES_MAX;
use cdcr_shared_types::{ObstacleUpdate, ReferenceChunk, Telemetry};

use crate::recording::file::{RecordedMessage, Recording};

/// Time by which the recording is read ahead \[ns\]: the outcome of a message follows the message.
pub(super) const READ_AHEAD_NS: u64 = 1_000_000_000;

/// A replayed step, with the time of the first cycle where the step contains times \[ns\].
#[derive(Debug)]
pub(super) enum Step {
    Chunk(Box<ReferenceChunk>, u64),
    Obstacles(Box<ObstacleUpdate>, u64),
    Track,
    Hold,
}

/// A recording as steps in the order of their times, without refused messages.
pub(super) struct RecordedSteps {
    pub(super) recording: Recording,
    first: Option<First>,
    /// Messages before the first cycle: their times are relative to it.
    early: Vec<RecordedMessage>,
    /// Steps by the time since the first cycle and the order in the file: references, and all others.
    references: BTreeMap<(u64, u64), Step>,
    others: BTreeMap<(u64, u64), Step>,
    count: u64,
    /// Time of the newest cycle since the first \[ns\].
    read_ns: u64,
    is_tracking: bool,
    is_ended: bool,
}

#[derive(Debug, Clone, Copy)]
struct First {
    release_ns: u64,
    fingerprint: u64,
}

impl RecordedSteps {
    pub(super) fn new(recording: Recording) -> Self {
        Self {
            recording,
            first: None,
            early: Vec::new(),
            references: BTreeMap::new(),
            others: BTreeMap::new(),
            count: 0,
            read_ns: 0,
            is_tracking: false,
            is_ended: false,
        }
    }

    /// Fingerprint in the first cycle.
    pub(super) fn robot_fingerprint(&self) -> Option<u64> {
        self.first.map(|first| first.fingerprint)
    }

    /// Ids of all obstacles that the steps insert, from here to the end.
    pub(super) fn obstacle_ids(mut self) -> anyhow::Result<BTreeSet<u32>> {
        let mut ids = BTreeSet::new();
        let mut since_ns = 0;
        while !self.is_over(since_ns) {
            // A message may follow the last cycle.
            since_ns = if self.is_ended {
                u64::MAX / 2
            } else {
                self.read_ns
            };
            self.read_to(since_ns + READ_AHEAD_NS)?;
            while let Some(step) = self.due(since_ns, 0) {
                if let Step::Obstacles(update, _) = step
                    && update.action == ObstacleAction::Upsert.code()
                {
                    let used = update.obstacles.iter().take(update.count as usize);
                    ids.extend(used.map(|obstacle| obstacle.id));
                }
            }
        }
        Ok(ids)
    }

    /// Reads up to the first cycle at `since_ns` after the first one.
    pub(super) fn read_to(&mut self, since_ns: u64) -> anyhow::Result<()> {
        while !self.is_ended && (self.first.is_none() || self.read_ns < since_ns) {
            match self.recording.next_message()? {
                None => self.is_ended = true,
                Some(message) => self.take(message),
            }
        }
        Ok(())
    }

    /// The next due step; references are due `lead_ns` early.
    pub(super) fn due(&mut self, since_ns: u64, lead_ns: u64) -> Option<Step> {
        let pop = |steps: &mut BTreeMap<(u64, u64), Step>, until_ns: u64| {
            let entry = steps.first_entry()?;
            (entry.key().0 <= until_ns).then(|| entry.remove())
        };
        pop(&mut self.references, since_ns + lead_ns).or_else(|| pop(&mut self.others, since_ns))
    }

    pub(super) fn is_over(&self, since_ns: u64) -> bool {
        let is_empty = self.references.is_empty() && self.others.is_empty();
        self.is_ended && is_empty && since_ns >= self.read_ns
    }

    fn take(&mut self, message: RecordedMessage) {
        let Some(first) = self.first else {
            match message {
                RecordedMessage::Telemetry(record) => self.begin(&record),
                RecordedMessage::Reference(_) | RecordedMessage::Obstacles(_) => {
                    self.early.push(message);
                }
                RecordedMessage::Status(_) | RecordedMessage::Incident(_) => {}
            }
            return;
        };
        match message {
            RecordedMessage::Telemetry(record) => self.take_record(&record, first.release_ns),
            RecordedMessage::Reference(chunk) => {
                let since_ns = chunk.header.sent_ns.saturating_sub(first.release_ns);
                let key = (since_ns, self.number());
                let step = Step::Chunk(chunk, first.release_ns);
                self.references.insert(key, step);
            }
            RecordedMessage::Obstacles(update) => {
                let since_ns = update.header.sent_ns.saturating_sub(first.release_ns);
                let step = Step::Obstacles(update, first.release_ns);
                self.insert(since_ns, step);
            }
            RecordedMessage::Status(_) | RecordedMessage::Incident(_) => {}
        }
    }

    /// Starts with the first cycle, and the obstacles that it knew.
    fn begin(&mut self, record: &Telemetry) {
        self.first = Some(First {
            release_ns: record.release_ns,
            fingerprint: record.robot.fingerprint,
        });
        let known = obstacles(record);
        if !known.is_empty() {
            let mut update = Box::<ObstacleUpdate>::default();
            let count = known.len().min(OBSTACLES_MAX);
            update.count = count as u32;
            update.obstacles[..count].copy_from_slice(&known[..count]);
            self.insert(0, Step::Obstacles(update, record.release_ns));
        }
        self.take_record(record, record.release_ns);
        for message in std::mem::take(&mut self.early) {
            self.take(message);
        }
    }

    fn take_record(&mut self, record: &Telemetry, first_ns: u64) {
        self.read_ns = record.release_ns.saturating_sub(first_ns);
        for event in events(record) {
            if event.outcome != Outcome::Accepted.code() {
                self.refuse(event.kind, (event.sender_id, event.sequence));
            }
        }
        let is_tracking = record.mode == Mode::Tracking.code();
        if is_tracking && !self.is_tracking {
            self.insert(self.read_ns, Step::Track);
        }
        // At the end of a reference, the daemon leaves tracking by itself again.
        if self.is_tracking && !is_tracking && record.reason != Reason::ReferenceEnded.code() {
            self.insert(self.read_ns, Step::Hold);
        }
        self.is_tracking = is_tracking;
    }

    /// Removes a message that the daemon refused.
    fn refuse(&mut self, kind: u32, of: (u64, u64)) {
        if kind == EventKind::Reference.code() {
            self.references.retain(|_, step| match step {
                Step::Chunk(chunk, _) => (chunk.header.sender_id, chunk.header.sequence) != of,
                _ => true,
            });
        } else if kind == EventKind::Obstacles.code() {
            self.others.retain(|_, step| match step {
                Step::Obstacles(update, _) => {
                    (update.header.sender_id, update.header.sequence) != of
                }
                _ => true,
            });
        }
    }

    fn insert(&mut self, since_ns: u64, step: Step) {
        let key = (since_ns, self.number());
        self.others.insert(key, step);
    }

    fn number(&mut self) -> u64 {
        self.count += 1;
        self.count
    }
}
