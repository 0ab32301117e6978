//! Latency from sending a message until the client receives the first command that uses it, or its answer.

use std::collections::HashMap;

use anyhow::{Result, bail, ensure};
use cdcr_client::{Driver, ObstacleSender, ReferenceFeed, events, monotonic_ns};
use cdcr_shared_types::codes::{
    EventKind, MeasurementKind, MeasurementState, Mode, Outcome, Reason, RequestKind, timing,
};
use cdcr_shared_types::{Measurement, Obstacle, Telemetry};

use super::leg::Round;
use super::{early_ns, scene};
use crate::metric::median;
use crate::subject::phases::Phases;
use crate::subject::watcher::{Seen, Watcher};

/// Messages of each kind before the first one counts: ports map memory, caches fill.
pub(super) const WARM_UP: usize = 10;
const LEAD_RECORDS: usize = 20;
/// Messages without an effect that are tolerated in addition to the samples.
const SPARE: usize = 500;
pub(super) enum Sender {
    Reference(ReferenceFeed),
    Obstacle(Box<ObstacleSender>),
    Measurement(Box<Driver>),
    /// A request without an effect while the robot follows: to renew the lease, or to track.
    Request(RequestKind),
}

impl Sender {
    fn way(&self) -> &'static str {
        match self {
            Self::Reference(_) => "reference.command",
            Self::Obstacle(_) => "obstacle.command",
            Self::Measurement(_) => "measurement.command",
            Self::Request(RequestKind::Track) => "track.answer",
            Self::Request(_) => "lease.answer",
        }
    }

    fn is_request(&self) -> bool {
        matches!(self, Self::Request(_))
    }

    /// Returns the identification of the message in a record, and its time stamp.
    pub(super) fn send(&self, index: usize, watcher: &mut Watcher) -> Result<(u64, u64)> {
        let length_m = scene::length_m(watcher);
        let header = match self {
            Self::Reference(feed) => scene::send(feed, scene::on_circle(index, length_m))?,
            Self::Obstacle(sender) => sender.upsert(&[Obstacle {
                id: 1,
                start_m: [0.0, 0.0, -10.0 * length_m],
                radius_m: 0.01 * length_m,
                measured_ns: monotonic_ns(),
                ..Obstacle::default()
            }])?,
            Self::Measurement(driver) => {
                let newest = watcher.newest.as_ref();
                let measured_ns = monotonic_ns();
                driver.send(Measurement {
                    measured_ns,
                    kind: MeasurementKind::Configuration.code(),
                    sections: watcher.status.robot.sections,
                    bend_rad: newest.map_or([0.0; _], |command| command.bend_target_rad),
                    ..Measurement::default()
                })?;
                return Ok((measured_ns, measured_ns));
            }
            Self::Request(kind) => return watcher.ask(*kind),
        };
        Ok((header.sequence, header.sent_ns))
    }

    /// Messages of this sender in the record: identification, gather that took it, outcome.
    fn taken(&self, sender_id: u64, record: &Telemetry) -> Vec<(u64, u64, u32)> {
        let (kind, request) = match self {
            Self::Reference(_) => (EventKind::Reference, None),
            Self::Obstacle(_) => (EventKind::Obstacles, None),
            Self::Request(kind) => (EventKind::Request, Some(*kind)),
            // The measurement that the record's cycle was the first to use.
            Self::Measurement(_) if record.measurement_state == MeasurementState::Used.code() => {
                let (measured_ns, outcome) = (record.measurement.measured_ns, Outcome::Accepted);
                return vec![(measured_ns, record.gather_ns, outcome.code())];
            }
            Self::Measurement(_) => return Vec::new(),
        };
        let is_of_cycle = request == Some(RequestKind::Track);
        let ours = events(record).iter().filter(|event| {
            event.kind == kind.code()
                && event.sender_id == sender_id
                && request.is_none_or(|request| event.detail == request.code())
        });
        let taken = ours.map(|event| {
            let gather_ns = [event.evaluated_ns, record.gather_ns][usize::from(is_of_cycle)];
            (event.sequence, gather_ns, event.outcome)
        });
        taken.collect()
    }
}

struct SentInputs {
    sender: Sender,
    sent: HashMap<u64, Sent>,
    count: usize,
    recorded: usize,
}

struct Sent {
    stamp_ns: u64,
    counts: bool,
    answered_ns: Option<u64>,
}

impl SentInputs {
    fn send(&mut self, watcher: &mut Watcher) -> Result<()> {
        let (key, stamp_ns) = self.sender.send(self.count, watcher)?;
        self.count += 1;
        let sent = Sent {
            stamp_ns,
            counts: self.count > WARM_UP,
            answered_ns: None,
        };
        self.sent.insert(key, sent);
        Ok(())
    }

    fn take(&mut self, cycle: &Seen, sender_id: u64, round: &mut Round) -> Result<()> {
        for (key, gather_ns, outcome) in self.sender.taken(sender_id, &cycle.record) {
            let Some(sent) = self.sent.remove(&key) else {
                continue;
            };
            let way = self.sender.way();
            if outcome != Outcome::Accepted.code() {
                let why = Outcome::text_of(outcome);
                bail!("the daemon rejected a message of the benchmark ({way}): {why}");
            }
            if !sent.counts {
                continue;
            }
            let why = Reason::text_of(cycle.record.reason);
            let follows = cycle.is_in(Mode::Tracking);
            ensure!(follows, "the robot no longer follows its reference: {why}");
            let is_request = self.sender.is_request();
            let received_ns = [cycle.received_ns, sent.answered_ns][usize::from(is_request)];
            // Without its command, because the client was away too long, there is no latency.
            let Some(received_ns) = received_ns else {
                round.without_command += u64::from(!is_request);
                continue;
            };
            self.recorded += 1;
            round.record_way(way, [sent.stamp_ns, gather_ns, received_ns]);
        }
        Ok(())
    }
}

/// Sends from each sender in turn, at phases spread over the period, until each has `samples`. Requests are
/// sent one at a time. `lead_ns`: time from the gather to the release.
pub(super) fn measure(
    watcher: &mut Watcher,
    lead_ns: u64,
    senders: Vec<Sender>,
    samples: usize,
    round: &mut Round,
) -> Result<()> {
    watcher.before_ns = early_ns(watcher);
    if senders.iter().any(Sender::is_request) {
        // An answer may come right after the gather.
        watcher.before_ns += lead_ns;
    }
    let is_sent = |sender: &Sender| matches!(sender, Sender::Reference(_) | Sender::Obstacle(_));
    let is_simulated = senders.iter().all(is_sent);
    // Periods between two messages: each sender sends in every second period; an answer takes two.
    let gap = if is_simulated { 1 } else { 2 };
    let line = |sender| SentInputs {
        sender,
        sent: HashMap::new(),
        count: 0,
        recorded: 0,
    };
    let mut lines: Vec<SentInputs> = senders.into_iter().map(line).collect();
    let (mut phases, mut cycle) = (Phases::default(), 0);
    watcher.begin()?;
    for number in 0..2 * lines.len() * (samples + WARM_UP) + SPARE {
        cycle = (cycle + gap).max(watcher.cycle_at(monotonic_ns()) + 1);
        let phase_ns = phases.next_ns(watcher.status.period_ns);
        let due_ns = watcher.release_ns(cycle) + phase_ns;
        let until_ns = |is_waiting| if is_waiting { u64::MAX } else { due_ns };
        // Only between releases: other work while waiting for a command would delay its receipt.
        while watcher.watch(until_ns(watcher.waits_for_answer()))? {
            take(watcher, &mut lines, is_simulated, round)?;
        }
        if lines.iter().all(|line| line.recorded >= samples) {
            return Ok(());
        }
        let count = lines.len();
        lines[number % count].send(watcher)?;
    }
    bail!(
        "the daemon did not answer in time: the machine stalls, or the configuration keeps the robot from following \
         its reference"
    )
}

fn take(
    watcher: &mut Watcher,
    lines: &mut [SentInputs],
    is_simulated: bool,
    round: &mut Round,
) -> Result<()> {
    for answer in watcher.answers.drain(..) {
        answer.accepted()?;
        let mut all = lines.iter_mut();
        if let Some(sent) = all.find_map(|line| line.sent.get_mut(&answer.sequence)) {
            sent.answered_ns = Some(answer.received_ns);
        }
    }
    for seen in watcher.seen.drain(..) {
        for line in &mut *lines {
            line.take(&seen, watcher.connection.sender_id(), round)?;
        }
        let is_warm = lines.iter().all(|line| line.count > WARM_UP);
        if is_simulated && is_warm && seen.is_in(Mode::Tracking) {
            record_command(&seen, round);
        }
    }
    Ok(())
}

fn record_command(cycle: &Seen, round: &mut Round) {
    let Some(received_ns) = cycle.received_ns else {
        round.without_command += 1;
        return;
    };
    let record = &cycle.record;
    for (leg, from_ns) in [
        ("command.release", record.due_ns),
        ("command.handover", record.handed_over_ns),
        ("command.hop", record.command.header.sent_ns),
    ] {
        round.record(leg, received_ns.saturating_sub(from_ns));
    }
}

/// Estimates the lead of the gather from records, because the status does not contain it. The median, because
/// a single gather may be late and a single cycle may sleep for an old release.
pub(super) fn learn_lead_ns(watcher: &mut Watcher) -> Result<u64> {
    for _ in 0..LEAD_RECORDS {
        watcher.watch_release()?;
    }
    let records = watcher.seen.drain(..).map(|seen| seen.record);
    let fresh = records.filter(|record| record.timing_flags & timing::STALE_INPUTS == 0);
    let lead_ns = |record: Box<Telemetry>| record.due_ns.saturating_sub(record.gather_ns);
    let leads_ns = fresh.map(|record| record.period_ns.min(lead_ns(record)) as f64);
    Ok(median(leads_ns).unwrap_or(0.0) as u64)
}
