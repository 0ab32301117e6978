//! A client that has every command in its hands as soon as it is there.
//!
//! It wakes up a little before each release, looks for the command until it is there, and sleeps again: it
//! is awake when the command comes, and does not hold its core all the time. Whatever else it does, to send
//! and to ask, happens on the same thread at a time that was fixed before, so that no second thread is in
//! the way.

use std::collections::VecDeque;

use anyhow::{Context, Result, ensure};
use cdcr_client::{CommandStream, Connection, TelemetryStream, monotonic_ns};
use cdcr_shared_types::codes::timing;
use cdcr_shared_types::{Command, Location, Status, Telemetry};

use crate::interrupt;
use crate::metric::median;
use crate::subject::TIMEOUT;
use crate::subject::asker::{Answer, Asker};
use crate::subject::place::ROBOT;
use crate::system::thread::sleep_until;

/// The client is awake this long before what it waits for \[ns\]; on a short period a quarter of that.
const EARLY_NS: u64 = 200_000;
/// So long after the release it looks without a rest \[ns\]: a thread that never rests is halted.
const RESTLESS_NS: u64 = 500_000;
const REST_NS: u64 = 20_000;
/// Commands that are remembered until their telemetry comes.
const REMEMBERED: usize = 1024;
/// Records from which the lead of the gather is learned.
const LEAD_RECORDS: usize = 20;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(clippy::struct_field_names, reason = "the unit ends each name")]
pub(super) struct Grid {
    pub(super) origin_ns: u64,
    pub(super) period_ns: u64,
    /// How long before each release the inputs are gathered.
    pub(super) lead_ns: u64,
}

impl Grid {
    pub(super) fn release_ns(&self, cycle: u64) -> u64 {
        self.origin_ns + cycle * self.period_ns
    }

    pub(super) fn cycle_at(&self, time_ns: u64) -> u64 {
        time_ns.saturating_sub(self.origin_ns) / self.period_ns
    }

    /// How long before something a client wakes up for it.
    pub(super) fn early_ns(&self) -> u64 {
        EARLY_NS.min(self.period_ns / 4)
    }
}

/// A cycle, and when its command was in the client's hands; none when it never was.
#[derive(Debug, Clone)]
pub(super) struct Seen {
    pub(super) record: Box<Telemetry>,
    pub(super) received_ns: Option<u64>,
}

/// What came while the client was awake for one release.
#[derive(Debug, Default)]
pub(super) struct Turn {
    pub(super) answers: Vec<Answer>,
    pub(super) seen: Vec<Seen>,
}

/// What is sent with the newest command in hand, or asked. When to act again \[ns\].
pub(super) type Act<'a> = dyn FnMut(Option<&Command>, Option<&mut Asker>) -> Result<u64> + 'a;

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, derive_more::AddAssign)]
pub(super) struct Looks {
    all: u64,
    /// The command was there before its first look.
    late: u64,
}

pub(super) struct Hands {
    pub(super) connection: Connection,
    pub(super) status: Status,
    pub(super) grid: Grid,
    pub(super) looks: Looks,
    /// Who asks, once somebody has to.
    asker: Option<Asker>,
    turns_left: u64,
    commands: CommandStream,
    telemetry: TelemetryStream,
    next: u64,
    newest: Option<Command>,
    received: VecDeque<(u64, u64)>,
}

impl Hands {
    /// Connects. To be called on the thread that watches.
    pub(super) fn open(location: &Location) -> Result<Self> {
        let connection = Connection::open_within(location, ROBOT, TIMEOUT)?;
        let status = connection.status(TIMEOUT)?;
        let mut telemetry = connection.telemetry()?;
        let lead_ns = learn_lead_ns(&mut telemetry)?;
        let grid = Grid {
            origin_ns: status.origin_ns,
            period_ns: status.period_ns,
            lead_ns,
        };
        Ok(Self {
            commands: connection.commands()?,
            telemetry,
            next: grid.cycle_at(monotonic_ns()) + 1,
            connection,
            status,
            grid,
            looks: Looks::default(),
            asker: None,
            turns_left: 0,
            newest: None,
            received: VecDeque::with_capacity(REMEMBERED),
        })
    }

    pub(super) fn length_m(&self) -> f64 {
        cdcr_client::section_lengths_m(&self.status.robot)
            .iter()
            .sum()
    }

    pub(super) fn open_asker(&mut self, location: &Location) -> Result<()> {
        self.asker = Some(Asker::open(location, ROBOT, self.connection.sender_id())?);
        Ok(())
    }

    /// When the request was sent that has no answer yet.
    pub(super) fn waits_since_ns(&self) -> Option<u64> {
        self.asker.as_ref()?.waits_since_ns()
    }

    /// Begins something that is done after so many releases, and what a stall may take. What came while nobody watched
    /// is no measurement.
    pub(super) fn begin(&mut self, turns: u64) -> Result<()> {
        self.turns_left = turns + 1000;
        while self.telemetry.try_next()?.is_some() {}
        self.receive()?;
        self.received.clear();
        self.next = self.grid.cycle_at(monotonic_ns()) + 1;
        Ok(())
    }

    /// Sleeps until the next release, `before_ns` before it at the latest, and looks until its command is there, and the answer
    /// that the gather before it can have given. Acts at `due_ns`, as soon as nothing waits for an answer.
    pub(super) fn turn(
        &mut self,
        before_ns: u64,
        due_ns: &mut u64,
        act: &mut Act<'_>,
    ) -> Result<Turn> {
        interrupt::check()?;
        ensure!(
            self.turns_left > 0,
            "the daemon did not answer as it should: the machine stalls, or the configuration keeps the robot \
             from following its reference"
        );
        self.turns_left -= 1;
        let release_ns = self.grid.release_ns(self.next);
        let wake_ns = release_ns.saturating_sub(before_ns);
        if *due_ns < wake_ns && self.waits_since_ns().is_none() {
            sleep_until(*due_ns);
            *due_ns = act(self.newest.as_ref(), self.asker.as_mut())?;
        }
        sleep_until(wake_ns);
        let answers = self.watch(release_ns, due_ns, act)?;
        let seen = self.read_records()?;
        self.next = (self.next + 1).max(self.grid.cycle_at(monotonic_ns()) + 1);
        Ok(Turn { answers, seen })
    }

    fn watch(
        &mut self,
        release_ns: u64,
        due_ns: &mut u64,
        act: &mut Act<'_>,
    ) -> Result<Vec<Answer>> {
        let give_up_ns = release_ns + self.grid.period_ns / 2;
        let was_there = self.receive()?;
        self.looks.all += 1;
        self.looks.late += u64::from(was_there);
        let mut answers = Vec::new();
        loop {
            let is_there = self.receive()?;
            let now_ns = monotonic_ns();
            if *due_ns <= now_ns && self.waits_since_ns().is_none() {
                *due_ns = act(self.newest.as_ref(), self.asker.as_mut())?;
            }
            if let Some(asker) = &mut self.asker {
                answers.extend(asker.look()?);
            }
            // The gather may come late, and take what was sent until shortly before the release.
            let has_all = self
                .waits_since_ns()
                .is_none_or(|sent_ns| sent_ns >= release_ns);
            if (is_there && has_all) || now_ns > give_up_ns {
                return Ok(answers);
            }
            if now_ns > release_ns + RESTLESS_NS {
                sleep_until(now_ns + REST_NS);
            }
        }
    }

    /// Takes the commands that are there. Whether that of the watched cycle is among all that came.
    fn receive(&mut self) -> Result<bool> {
        while let Some(command) = self.commands.try_next()? {
            let received_ns = monotonic_ns();
            if self.received.len() == REMEMBERED {
                self.received.pop_front();
            }
            self.received.push_back((command.cycle, received_ns));
            self.newest = Some(command);
        }
        let newest = self.newest.as_ref();
        Ok(newest.is_some_and(|newest| newest.cycle >= self.next))
    }

    fn read_records(&mut self) -> Result<Vec<Seen>> {
        let mut seen = Vec::new();
        while let Some(record) = self.telemetry.try_next()? {
            let is_older = |(cycle, _): &(u64, u64)| *cycle < record.cycle;
            while self.received.front().is_some_and(is_older) {
                self.received.pop_front();
            }
            let received = self
                .received
                .front()
                .filter(|(cycle, _)| *cycle == record.cycle);
            let received_ns = received.map(|(_, received_ns)| *received_ns);
            seen.push(Seen {
                record: Box::new(record),
                received_ns,
            });
        }
        Ok(seen)
    }
}

/// The daemon does not tell how long before a release it gathers; its records do. The median: a single gather
/// may be late, and a single cycle may sleep for an old release.
fn learn_lead_ns(telemetry: &mut TelemetryStream) -> Result<u64> {
    let mut leads_ns = Vec::with_capacity(LEAD_RECORDS);
    for _ in 0..LEAD_RECORDS {
        interrupt::check()?;
        let record = telemetry
            .next_within(TIMEOUT)?
            .context("the daemon sends no telemetry")?;
        leads_ns.extend(lead_ns(&record).map(|lead_ns| lead_ns as f64));
    }
    Ok(median(leads_ns).unwrap_or(0.0) as u64)
}

/// How long before the release that its cycle slept for a record's inputs were gathered; an old gather says
/// nothing.
fn lead_ns(record: &Telemetry) -> Option<u64> {
    let is_fresh = record.timing_flags & timing::STALE_INPUTS == 0;
    let lead_ns = record.due_ns.saturating_sub(record.gather_ns);
    is_fresh.then_some(lead_ns.min(record.period_ns))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lead_is_that_before_the_release_that_was_slept_for() {
        let record = Telemetry {
            release_ns: 25_000_000,
            due_ns: 5_000_000,
            gather_ns: 4_800_000,
            period_ns: 5_000_000,
            ..Telemetry::default()
        };
        assert_eq!(lead_ns(&record), Some(200_000));
        let stale = Telemetry {
            timing_flags: timing::STALE_INPUTS,
            ..record
        };
        assert_eq!(lead_ns(&stale), None);
    }
}
