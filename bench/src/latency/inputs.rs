//! Something is sent → the first command that uses it is in the client's hands.

use std::collections::VecDeque;

use anyhow::{Result, ensure};
use cdcr_client::{Driver, ObstacleSender, ReferenceFeed, events, monotonic_ns};
use cdcr_shared_types::codes::{
    EventKind, MeasurementKind, MeasurementState, Mode, Outcome, Reason,
};
use cdcr_shared_types::{Command, InputEvent, Measurement, Obstacle, Telemetry};

use super::hands::{Errand, Grid, Hands, Seen};
use super::leg::{Leg, Way};
use super::phase::Phases;
use super::round::{Passage, Round};
use super::scene;

/// So many of each kind are sent before one counts: ports map memory, caches fill.
pub(super) const WARM_UP: usize = 10;
/// Releases until a daemon must know the robot of its driver.
const AWAKE_TURNS: u64 = 2000;
/// What was sent so long ago and has shown no effect never will \[ns\].
const FORGOTTEN_NS: u64 = 1_000_000_000;

pub(super) enum Source {
    /// A reference chunk that replaces the one before.
    Reference {
        feed: ReferenceFeed,
        length_m: f64,
    },
    /// A small sphere that nobody comes near to.
    Obstacle {
        sender: ObstacleSender,
        length_m: f64,
    },
    Measurement {
        driver: Box<Driver>,
        sections: u32,
    },
}

#[derive(Debug, Clone, Copy)]
struct Sent {
    sequence: u64,
    stamp_ns: u64,
    counts: bool,
}

/// One source, and what became of what it sent.
struct Line {
    source: Source,
    sent: VecDeque<Sent>,
    count: usize,
    recorded: usize,
}

/// Sends from each source in turn, each second period, at phases spread over the period.
pub(super) struct Inputs {
    lines: Vec<Line>,
    gap: u64,
    grid: Grid,
    sender_id: u64,
    samples: usize,
    phases: Phases,
    turn: usize,
    due_ns: u64,
}

impl Source {
    fn way(&self) -> Way {
        match self {
            Self::Reference { .. } => Way::REFERENCE,
            Self::Obstacle { .. } => Way::OBSTACLE,
            Self::Measurement { .. } => Way::MEASUREMENT,
        }
    }

    /// Sends the message number `index`. Its sequence and stamp.
    fn send(&self, index: u32, newest: Option<&Command>) -> Result<(u64, u64)> {
        let header = match self {
            Self::Reference { feed, length_m } => {
                scene::send(feed, scene::on_circle(index, *length_m))?
            }
            Self::Obstacle { sender, length_m } => sender.upsert(&[Obstacle {
                id: 1,
                start_m: [0.0, 0.0, -10.0 * length_m],
                radius_m: 0.01 * length_m,
                measured_ns: monotonic_ns(),
                ..Obstacle::default()
            }])?,
            Self::Measurement { driver, sections } => {
                let measured_ns = monotonic_ns();
                let header = driver.send(Measurement {
                    measured_ns,
                    kind: MeasurementKind::Configuration.code(),
                    sections: *sections,
                    bend_rad: newest.map_or([0.0; _], |command| command.bend_target_rad),
                    ..Measurement::default()
                })?;
                return Ok((header.sequence, measured_ns));
            }
        };
        Ok((header.sequence, header.sent_ns))
    }

    fn event_kind(&self) -> Option<EventKind> {
        match self {
            Self::Reference { .. } => Some(EventKind::Reference),
            Self::Obstacle { .. } => Some(EventKind::Obstacles),
            Self::Measurement { .. } => None,
        }
    }
}

impl Line {
    fn new(source: Source) -> Self {
        Self {
            source,
            sent: VecDeque::new(),
            count: 0,
            recorded: 0,
        }
    }

    fn send(&mut self, newest: Option<&Command>) -> Result<()> {
        let (sequence, stamp_ns) = self.source.send(self.count as u32, newest)?;
        self.count += 1;
        self.sent.push_back(Sent {
            sequence,
            stamp_ns,
            counts: self.count > WARM_UP,
        });
        let is_forgotten = |sent: &Sent| sent.stamp_ns + FORGOTTEN_NS < stamp_ns;
        while self.sent.front().is_some_and(is_forgotten) {
            self.sent.pop_front();
        }
        Ok(())
    }

    /// What the record says of the messages of this line, with the gather that took each.
    fn taken(&mut self, sender_id: u64, record: &Telemetry) -> Result<Vec<(Sent, u64)>> {
        let Some(kind) = self.source.event_kind() else {
            return Ok(self.measured(record).into_iter().collect());
        };
        let is_ours =
            |event: &&InputEvent| event.kind == kind.code() && event.sender_id == sender_id;
        let mut taken = Vec::new();
        for event in events(record).iter().filter(is_ours) {
            ensure!(
                event.outcome == Outcome::Accepted.code(),
                "the daemon refused what the bench sent ({}): {}",
                kind.text(),
                Outcome::text_of(event.outcome)
            );
            let at = self
                .sent
                .iter()
                .position(|sent| sent.sequence == event.sequence);
            let sent = at.and_then(|at| self.sent.remove(at));
            taken.extend(sent.map(|sent| (sent, event.judged_ns)));
        }
        Ok(taken)
    }

    /// The measurement that the record's cycle used for the first time.
    fn measured(&mut self, record: &Telemetry) -> Option<(Sent, u64)> {
        if record.measurement_state != MeasurementState::Used.code() {
            return None;
        }
        let measured_ns = record.measurement.measured_ns;
        let at = self
            .sent
            .iter()
            .position(|sent| sent.stamp_ns == measured_ns)?;
        self.sent.remove(at).map(|sent| (sent, record.gather_ns))
    }
}

impl Inputs {
    /// `samples` of each source that count.
    pub(super) fn new(hands: &Hands, sources: Vec<Source>, samples: usize) -> Self {
        let grid = hands.grid;
        let mut inputs = Self {
            gap: 2 / sources.len().clamp(1, 2) as u64,
            lines: sources.into_iter().map(Line::new).collect(),
            grid,
            sender_id: hands.connection.sender_id(),
            samples,
            phases: Phases::default(),
            turn: 0,
            due_ns: 0,
        };
        inputs.plan();
        inputs
    }

    fn plan(&mut self) {
        let now_ns = monotonic_ns();
        let planned = self.grid.cycle_at(self.due_ns) + self.gap;
        let cycle = planned.max(self.grid.cycle_at(now_ns) + 1);
        self.due_ns = self.grid.release_ns(cycle) + self.phases.next_ns(self.grid.period_ns);
    }
}

impl Errand for Inputs {
    fn due_ns(&self) -> u64 {
        self.due_ns
    }

    fn act(&mut self, newest: Option<&Command>) -> Result<()> {
        let line = self.turn % self.lines.len();
        self.lines[line].send(newest)?;
        self.turn += 1;
        self.plan();
        Ok(())
    }

    fn look(&mut self, _release_ns: u64) -> Result<bool> {
        Ok(true)
    }

    fn seen(&mut self, cycle: &Seen<'_>, round: &mut Round) -> Result<()> {
        let record = cycle.record;
        let follows = record.mode == Mode::Tracking.code();
        for line in &mut self.lines {
            let taken = line.taken(self.sender_id, record)?;
            for (sent, gather_ns) in taken.into_iter().filter(|(sent, _)| sent.counts) {
                ensure!(
                    follows,
                    "the robot no longer follows its reference: {}",
                    Reason::text_of(record.reason)
                );
                // A command that never came, because the client was away too long, is no latency.
                let Some(received_ns) = cycle.received_ns else {
                    round.unmeasured.without_command += 1;
                    continue;
                };
                line.recorded += 1;
                let passage = Passage {
                    sent_ns: sent.stamp_ns,
                    gather_ns,
                    received_ns,
                };
                round.record_way(line.source.way(), &passage);
            }
        }
        let counts = self.lines.iter().all(|line| line.count > WARM_UP);
        if counts
            && follows
            && self
                .lines
                .iter()
                .any(|line| line.source.event_kind().is_some())
        {
            record_command(cycle, round);
        }
        Ok(())
    }

    fn is_done(&self) -> bool {
        self.lines.iter().all(|line| line.recorded >= self.samples)
    }

    fn turns(&self) -> u64 {
        2 * self.gap * (self.lines.len() * (self.samples + WARM_UP)) as u64 + 1000
    }
}

fn record_command(cycle: &Seen<'_>, round: &mut Round) {
    let Some(received_ns) = cycle.received_ns else {
        round.unmeasured.without_command += 1;
        return;
    };
    let record = cycle.record;
    for (leg, from_ns) in [
        (Leg::CommandRelease, record.due_ns),
        (Leg::CommandHandover, record.handed_over_ns),
        (Leg::CommandHop, record.command.header.sent_ns),
    ] {
        round.record(leg, received_ns.saturating_sub(from_ns));
    }
}

/// Measures until the daemon knows the robot and holds it.
pub(super) struct Awakening {
    source: Source,
    due_ns: u64,
    period_ns: u64,
    is_awake: bool,
}

impl Awakening {
    pub(super) fn new(source: Source, grid: &Grid) -> Self {
        Self {
            source,
            due_ns: 0,
            period_ns: grid.period_ns,
            is_awake: false,
        }
    }

    pub(super) fn into_source(self) -> Source {
        self.source
    }
}

impl Errand for Awakening {
    fn due_ns(&self) -> u64 {
        self.due_ns
    }

    fn act(&mut self, newest: Option<&Command>) -> Result<()> {
        self.source.send(0, newest)?;
        self.due_ns = monotonic_ns() + self.period_ns;
        Ok(())
    }

    fn look(&mut self, _release_ns: u64) -> Result<bool> {
        Ok(true)
    }

    fn seen(&mut self, cycle: &Seen<'_>, _round: &mut Round) -> Result<()> {
        self.is_awake |= cycle.record.mode == Mode::Holding.code();
        Ok(())
    }

    fn is_done(&self) -> bool {
        self.is_awake
    }

    fn turns(&self) -> u64 {
        AWAKE_TURNS
    }
}
