//! A client that has every command in its hands as soon as it is there.
//!
//! It wakes up a little before each release, looks for the command until it is there, and sleeps again: it
//! is awake when the command comes, and does not hold its core all the time. Whatever else it does (its
//! errand: sending, asking) happens on the same thread at a time that was fixed before, so that no second
//! thread is in the way.

use std::collections::VecDeque;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use cdcr_client::{CommandStream, Connection, TelemetryStream, monotonic_ns};
use cdcr_shared_types::codes::timing;
use cdcr_shared_types::{Command, Location, Status, Telemetry};

use super::round::Round;
use crate::interrupt;
use crate::metric::median;
use crate::subject::place::ROBOT;
use crate::system::thread::sleep_until;

const TIMEOUT: Duration = Duration::from_secs(5);
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

pub(super) trait Errand {
    /// How long before each release it has to be awake \[ns\].
    fn awake_before_ns(&self, grid: &Grid) -> u64 {
        grid.early_ns()
    }

    fn due_ns(&self) -> u64;

    /// Acts: its time has come. `newest` is the newest command.
    fn act(&mut self, newest: Option<&Command>) -> Result<()>;

    /// Looks for what it waits for. Whether nothing is missing that the gather before the release at
    /// `release_ns` can have taken.
    fn look(&mut self, release_ns: u64) -> Result<bool>;

    fn seen(&mut self, cycle: &Seen<'_>, round: &mut Round) -> Result<()>;

    fn is_done(&self) -> bool;

    /// Releases after which it must be done: more than it needs, and what a stall may take.
    fn turns(&self) -> u64;
}

/// A cycle, and when its command was in the client's hands; none when it never was.
#[derive(Debug, Clone, Copy)]
pub(super) struct Seen<'a> {
    pub(super) record: &'a Telemetry,
    pub(super) received_ns: Option<u64>,
}

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
            newest: None,
            received: VecDeque::with_capacity(REMEMBERED),
        })
    }

    pub(super) fn length_m(&self) -> f64 {
        cdcr_client::section_lengths_m(&self.status.robot)
            .iter()
            .sum()
    }

    pub(super) fn run(&mut self, errand: &mut impl Errand, round: &mut Round) -> Result<()> {
        self.forget()?;
        let turns = errand.turns();
        for _ in 0..turns {
            if errand.is_done() {
                return Ok(());
            }
            self.turn(errand, round)?;
        }
        ensure!(
            errand.is_done(),
            "the daemon did not answer as it should within {turns} periods: the machine stalls, or the \
             configuration keeps the robot from following its reference"
        );
        Ok(())
    }

    /// What came while nobody watched is no measurement.
    fn forget(&mut self) -> Result<()> {
        while self.telemetry.try_next()?.is_some() {}
        self.receive()?;
        self.received.clear();
        self.next = self.grid.cycle_at(monotonic_ns()) + 1;
        Ok(())
    }

    fn turn(&mut self, errand: &mut impl Errand, round: &mut Round) -> Result<()> {
        interrupt::check()?;
        let release_ns = self.grid.release_ns(self.next);
        let wake_ns = release_ns.saturating_sub(errand.awake_before_ns(&self.grid));
        let due_ns = errand.due_ns();
        if due_ns < wake_ns {
            sleep_until(due_ns);
            errand.act(self.newest.as_ref())?;
        }
        sleep_until(wake_ns);
        self.watch(release_ns, errand)?;
        self.read_records(errand, round)?;
        self.next = (self.next + 1).max(self.grid.cycle_at(monotonic_ns()) + 1);
        Ok(())
    }

    /// Looks until the command of this release is there, and what the errand waits for.
    fn watch(&mut self, release_ns: u64, errand: &mut impl Errand) -> Result<()> {
        let give_up_ns = release_ns + self.grid.period_ns / 2;
        let was_there = self.receive()?;
        self.looks.all += 1;
        self.looks.late += u64::from(was_there);
        loop {
            let is_there = self.receive()?;
            let now_ns = monotonic_ns();
            if errand.due_ns() <= now_ns {
                errand.act(self.newest.as_ref())?;
            }
            let has_all = errand.look(release_ns)?;
            if (is_there && has_all) || now_ns > give_up_ns {
                return Ok(());
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

    fn read_records(&mut self, errand: &mut impl Errand, round: &mut Round) -> Result<()> {
        while let Some(record) = self.telemetry.try_next()? {
            while self
                .received
                .front()
                .is_some_and(|(cycle, _)| *cycle < record.cycle)
            {
                self.received.pop_front();
            }
            let received = self
                .received
                .front()
                .filter(|(cycle, _)| *cycle == record.cycle);
            let seen = Seen {
                received_ns: received.map(|(_, received_ns)| *received_ns),
                record: &record,
            };
            errand.seen(&seen, round)?;
        }
        Ok(())
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
