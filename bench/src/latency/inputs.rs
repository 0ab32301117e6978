//! Something is sent → the first command that uses it, or the answer to it, is in the client's hands.
//!
//! The exchange answers a renewal of the lease in the gather that takes it; the cycle decides a request
//! about the mode, and the exchange answers it after the command of that cycle has left.

use std::collections::VecDeque;

use anyhow::{Result, ensure};
use cdcr_client::{Driver, ObstacleSender, ReferenceFeed, events, monotonic_ns};
use cdcr_shared_types::codes::{
    EventKind, MeasurementKind, MeasurementState, Mode, Outcome, Reason, RequestKind,
};
use cdcr_shared_types::{Command, Measurement, Obstacle, Telemetry};

use super::hands::{Hands, Seen};
use super::leg::Leg;
use super::round::{Passage, Round};
use super::scene;
use crate::subject::asker::Asker;

/// So many of each kind are sent before one counts: ports map memory, caches fill.
pub(super) const WARM_UP: usize = 10;
/// What was sent so long ago and has shown no effect never will \[ns\].
const FORGOTTEN_NS: u64 = 1_000_000_000;
/// Fractional part of the golden ratio: its multiples fill the circle more evenly than those of any other
/// number, however many of them are taken.
const GOLDEN: f64 = 0.618_033_988_749_894_9;

/// Moments that are spread evenly over the period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Phases {
    taken: u32,
}

impl Phases {
    /// The next one, as a part of `period_ns`.
    pub(super) fn next_ns(&mut self, period_ns: u64) -> u64 {
        self.taken += 1;
        ((f64::from(self.taken) * GOLDEN).fract() * period_ns as f64) as u64
    }
}

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
    /// A request that changes nothing while the robot follows: to renew the lease, or to track.
    Request(RequestKind),
}

impl Source {
    fn way(&self) -> Leg {
        match self {
            Self::Reference { .. } => Leg::ReferenceCommand,
            Self::Obstacle { .. } => Leg::ObstacleCommand,
            Self::Measurement { .. } => Leg::MeasurementCommand,
            Self::Request(RequestKind::Track) => Leg::TrackAnswer,
            Self::Request(_) => Leg::LeaseAnswer,
        }
    }

    /// Sends the message number `index`. Its sequence and stamp.
    pub(super) fn send(
        &self,
        index: u32,
        newest: Option<&Command>,
        asker: Option<&mut Asker>,
    ) -> Result<(u64, u64)> {
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
            Self::Request(kind) => {
                ensure!(asker.is_some(), "nobody asks");
                return asker.map_or(Ok((0, 0)), |asker| asker.ask(*kind));
            }
        };
        Ok((header.sequence, header.sent_ns))
    }

    /// The event that a record tells of it, and its detail.
    fn event(&self) -> Option<(EventKind, Option<RequestKind>)> {
        match self {
            Self::Reference { .. } => Some((EventKind::Reference, None)),
            Self::Obstacle { .. } => Some((EventKind::Obstacles, None)),
            Self::Measurement { .. } => None,
            Self::Request(kind) => Some((EventKind::Request, Some(*kind))),
        }
    }
}

#[derive(Debug, Clone, Copy)]
struct Sent {
    sequence: u64,
    stamp_ns: u64,
    counts: bool,
    received_ns: Option<u64>,
}

/// One source, and what became of what it sent.
struct Line {
    source: Source,
    sent: VecDeque<Sent>,
    count: usize,
    recorded: usize,
}

impl Line {
    fn send(&mut self, newest: Option<&Command>, asker: Option<&mut Asker>) -> Result<()> {
        let (sequence, stamp_ns) = self.source.send(self.count as u32, newest, asker)?;
        self.count += 1;
        self.sent.push_back(Sent {
            sequence,
            stamp_ns,
            counts: self.count > WARM_UP,
            received_ns: None,
        });
        self.sent
            .retain(|sent| sent.stamp_ns + FORGOTTEN_NS >= stamp_ns);
        Ok(())
    }

    fn remove(&mut self, is_it: impl Fn(&Sent) -> bool) -> Option<Sent> {
        let at = self.sent.iter().position(is_it)?;
        self.sent.remove(at)
    }

    /// What the record says of the messages of this line, with the gather that took each.
    fn taken(&mut self, sender_id: u64, record: &Telemetry) -> Result<Vec<(Sent, u64)>> {
        let Some((kind, request)) = self.source.event() else {
            // The measurement that the record's cycle used for the first time.
            let is_used = record.measurement_state == MeasurementState::Used.code();
            let measured_ns = record.measurement.measured_ns;
            let sent = self.remove(|sent| is_used && sent.stamp_ns == measured_ns);
            return Ok(sent
                .map(|sent| (sent, record.gather_ns))
                .into_iter()
                .collect());
        };
        let mut taken = Vec::new();
        for event in events(record) {
            let is_ours = event.kind == kind.code()
                && event.sender_id == sender_id
                && request.is_none_or(|request| event.detail == request.code());
            let Some(sent) = self.remove(|sent| is_ours && sent.sequence == event.sequence) else {
                continue;
            };
            ensure!(
                event.outcome == Outcome::Accepted.code(),
                "the daemon refused what the bench sent ({}): {}",
                kind.text(),
                Outcome::text_of(event.outcome)
            );
            let is_of_cycle = request == Some(RequestKind::Track);
            let gather_ns = if is_of_cycle {
                record.gather_ns
            } else {
                event.judged_ns
            };
            taken.push((sent, gather_ns));
        }
        Ok(taken)
    }
}

/// Sends from each source in turn, at phases spread over the period, until `samples` of each count; requests one at a time.
pub(super) fn measure(
    hands: &mut Hands,
    sources: Vec<Source>,
    samples: usize,
    round: &mut Round,
) -> Result<()> {
    let asks = matches!(sources[..], [Source::Request(_), ..]);
    let line = |source| Line {
        source,
        sent: VecDeque::new(),
        count: 0,
        recorded: 0,
    };
    let mut lines: Vec<Line> = sources.into_iter().map(line).collect();
    // Periods from one message to the next: of every source one in each second period.
    let gap = if asks || lines.len() == 1 { 2 } else { 1 };
    let (grid, sender_id) = (hands.grid, hands.connection.sender_id());
    // An answer may come as soon as the inputs are gathered.
    let before_ns = grid.early_ns() + if asks { grid.lead_ns } else { 0 };
    let mut phases = Phases::default();
    let mut plan = |due_ns: u64| {
        let planned = grid.cycle_at(due_ns) + gap;
        let cycle = planned.max(grid.cycle_at(monotonic_ns()) + 1);
        grid.release_ns(cycle) + phases.next_ns(grid.period_ns)
    };
    hands.begin(2 * gap * (lines.len() * (samples + WARM_UP)) as u64)?;
    let (mut planned_ns, mut number, count) = (plan(0), 0, lines.len());
    let mut due_ns = planned_ns;
    while hands.waits_since_ns().is_some() || lines.iter().any(|line| line.recorded < samples) {
        let turn = hands.turn(before_ns, &mut due_ns, &mut |newest, asker| {
            lines[number % count].send(newest, asker)?;
            number += 1;
            planned_ns = plan(planned_ns);
            Ok(planned_ns)
        })?;
        for answer in turn.answers {
            answer.accepted()?;
            let mut all = lines.iter_mut().flat_map(|line| &mut line.sent);
            if let Some(sent) = all.find(|sent| sent.sequence == answer.sequence) {
                sent.received_ns = Some(answer.received_ns);
            }
        }
        for seen in &turn.seen {
            take(seen, &mut lines, sender_id, round)?;
        }
    }
    Ok(())
}

/// What a cycle says of the messages of all lines.
fn take(cycle: &Seen, lines: &mut [Line], sender_id: u64, round: &mut Round) -> Result<()> {
    let record = &cycle.record;
    let follows = record.mode == Mode::Tracking.code();
    let mut is_simulated = true;
    for line in lines {
        let is_asked = matches!(line.source, Source::Request(_));
        is_simulated &= line.source.event().is_some() && !is_asked && line.count > WARM_UP;
        let taken = line.taken(sender_id, record)?;
        for (sent, gather_ns) in taken.into_iter().filter(|(sent, _)| sent.counts) {
            let why = record.reason;
            ensure!(
                follows,
                "the robot no longer follows its reference: {}",
                Reason::text_of(why)
            );
            let received_ns = if is_asked {
                sent.received_ns
            } else {
                cycle.received_ns
            };
            // A command that never came, because the client was away too long, is no latency.
            let Some(received_ns) = received_ns else {
                round.unmeasured.without_command += u64::from(!is_asked);
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
    if is_simulated && follows {
        record_command(cycle, round);
    }
    Ok(())
}

fn record_command(cycle: &Seen, round: &mut Round) {
    let Some(received_ns) = cycle.received_ns else {
        round.unmeasured.without_command += 1;
        return;
    };
    let record = &cycle.record;
    for (leg, from_ns) in [
        (Leg::CommandRelease, record.due_ns),
        (Leg::CommandHandover, record.handed_over_ns),
        (Leg::CommandHop, record.command.header.sent_ns),
    ] {
        round.record(leg, received_ns.saturating_sub(from_ns));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_tenth_of_the_period_gets_its_share() {
        let mut phases = Phases::default();
        let mut tenths = [0; 10];
        for _ in 0..200 {
            tenths[phases.next_ns(10) as usize] += 1;
        }
        let shares = 18..=22;
        assert!(
            tenths.iter().all(|count| shares.contains(count)),
            "{tenths:?}"
        );
    }
}
