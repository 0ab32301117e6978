//! A client that receives every command as soon as it is there, like the driver of a robot.
//!
//! It sleeps until shortly before each release, polls for the command, and sleeps again. Therefore it is
//! awake when the command comes, without occupying its core all the time. While commands are missing, it
//! pauses between polls: with real time, it has priority over the daemon's reporter, whose records it waits
//! for. All other work, sending and asking, is done between releases on the same thread, so that no second
//! thread interferes.

use std::collections::VecDeque;

use anyhow::{Context, Result, ensure};
use cdcr_client::{CommandStream, Connection, TelemetryStream, monotonic_ns};
use cdcr_shared_types::codes::{Mode, RequestKind};
use cdcr_shared_types::{Command, Location, Status, Telemetry};

use super::asker::{Answer, Asker};
use super::{ROBOT, TIMEOUT};
use crate::interrupt;
use crate::system::thread::sleep_until;

/// Time after the release during which it polls for an answer without a pause \[ns\]. Limited, because the
/// kernel throttles a real-time thread that never sleeps.
const RESTLESS_NS: u64 = 500_000;
const REST_NS: u64 = 20_000;
/// Commands kept until their telemetry comes.
const REMEMBERED: usize = 1024;
/// Longest time without a record of the daemon \[ns\].
const SILENCE_NS: u64 = 2_000_000_000;

/// A cycle, and when its command was received; `None` if it was not.
#[derive(Debug, Clone)]
pub struct Seen {
    pub record: Box<Telemetry>,
    pub received_ns: Option<u64>,
}

impl Seen {
    pub fn is_in(&self, mode: Mode) -> bool {
        self.record.mode == mode.code()
    }
}

/// Polls for a command after a release.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, derive_more::AddAssign)]
pub struct PollCounts {
    all: u64,
    /// Commands that were there before the first poll.
    late: u64,
}

pub struct Watcher {
    pub connection: Connection,
    pub status: Status,
    /// Time by which it wakes up before each release \[ns\].
    pub before_ns: u64,
    pub polls: PollCounts,
    /// Cycles that have not been taken yet.
    pub seen: Vec<Seen>,
    pub answers: Vec<Answer>,
    pub newest: Option<Command>,
    /// Client for requests, opened at the first one.
    asker: Option<Asker>,
    commands: CommandStream,
    pub telemetry: TelemetryStream,
    next: u64,
    is_awake: bool,
    received: VecDeque<(u64, u64)>,
    last_record_ns: u64,
}

impl Watcher {
    /// Connects. Call it on the thread that watches.
    pub fn open(location: &Location, early_ns: u64) -> Result<Self> {
        let connection = Connection::open_within(location, ROBOT, TIMEOUT)?;
        let status = connection.status(TIMEOUT)?;
        let mut watcher = Self {
            before_ns: early_ns.min(status.period_ns / 4),
            polls: PollCounts::default(),
            seen: Vec::new(),
            answers: Vec::new(),
            newest: None,
            asker: None,
            commands: connection.commands()?,
            telemetry: connection.telemetry()?,
            next: 0,
            is_awake: false,
            received: VecDeque::with_capacity(REMEMBERED),
            last_record_ns: 0,
            connection,
            status,
        };
        watcher.begin()?;
        Ok(watcher)
    }

    pub fn release_ns(&self, cycle: u64) -> u64 {
        self.status.origin_ns + cycle * self.status.period_ns
    }

    pub fn cycle_at(&self, time_ns: u64) -> u64 {
        time_ns.saturating_sub(self.status.origin_ns) / self.status.period_ns
    }

    pub fn open_asker(&mut self, location: &Location) -> Result<()> {
        self.asker = Some(Asker::open(location, ROBOT, self.connection.sender_id())?);
        Ok(())
    }

    /// Sends a request, one at a time. Returns its sequence number and time stamp.
    pub fn ask(&mut self, kind: RequestKind) -> Result<(u64, u64)> {
        self.asker.as_mut().context("nobody asks")?.ask(kind)
    }

    pub fn waits_for_answer(&self) -> bool {
        self.waits_since_ns().is_some()
    }

    fn waits_since_ns(&self) -> Option<u64> {
        self.asker.as_ref()?.waits_since_ns()
    }

    /// Starts anew, and discards what came while nothing was watched.
    pub fn begin(&mut self) -> Result<()> {
        while self.telemetry.try_next()?.is_some() {}
        self.receive()?;
        self.received.clear();
        self.last_record_ns = monotonic_ns();
        self.go_on();
        Ok(())
    }

    pub fn watch_until(&mut self, time_ns: u64) -> Result<()> {
        while monotonic_ns() < time_ns {
            self.watch(time_ns)?;
        }
        Ok(())
    }

    pub fn watch_release(&mut self) -> Result<()> {
        while !self.watch(u64::MAX)? {}
        Ok(())
    }

    /// Watches one release until `time_ns` at most. Returns whether the release is over.
    pub fn watch(&mut self, time_ns: u64) -> Result<bool> {
        interrupt::check()?;
        let release_ns = self.release_ns(self.next);
        let wake_ns = release_ns.saturating_sub(self.before_ns);
        sleep_until(wake_ns.min(time_ns));
        if wake_ns >= time_ns || !self.catch(release_ns, time_ns)? {
            return Ok(false);
        }
        self.read_records()?;
        let silent_ns = monotonic_ns().saturating_sub(self.last_record_ns);
        let silent_s = silent_ns / 1_000_000_000;
        ensure!(
            silent_ns < SILENCE_NS,
            "the daemon has sent no record for {silent_s} s"
        );
        self.go_on();
        Ok(true)
    }

    fn go_on(&mut self) {
        self.next = (self.next + 1).max(self.cycle_at(monotonic_ns()) + 1);
        self.is_awake = false;
    }

    /// Polls for the command of a release, and for the answer of the gather before it, until both are there
    /// or the next release is near.
    fn catch(&mut self, release_ns: u64, time_ns: u64) -> Result<bool> {
        let next_wake_ns = release_ns + self.status.period_ns - self.before_ns;
        if !self.is_awake {
            self.is_awake = true;
            self.polls.all += 1;
            self.polls.late += u64::from(self.receive()?);
        }
        loop {
            let is_there = self.receive()?;
            let now_ns = monotonic_ns();
            if let Some(asker) = &mut self.asker {
                self.answers.extend(asker.poll()?);
            }
            // A late gather may take messages sent until shortly before the release.
            let sent_ns = self.waits_since_ns();
            let has_all = sent_ns.is_none_or(|sent_ns| sent_ns >= release_ns);
            if (is_there && has_all) || now_ns + REST_NS >= next_wake_ns {
                return Ok(true);
            }
            if now_ns >= time_ns {
                return Ok(false);
            }
            let rests = is_there || self.asker.is_some() || !self.has_command_before();
            if rests && now_ns > release_ns + RESTLESS_NS {
                sleep_until(now_ns + REST_NS);
            }
        }
    }

    /// Whether the command of the previous release came, so that the next one is expected.
    fn has_command_before(&self) -> bool {
        let newest = self.newest.as_ref();
        newest.is_some_and(|newest| newest.cycle + 1 >= self.next)
    }

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

    fn read_records(&mut self) -> Result<()> {
        while let Some(record) = self.telemetry.try_next()? {
            self.last_record_ns = monotonic_ns();
            // The daemon sends the command before the record.
            self.receive()?;
            let is_older = |(cycle, _): &(u64, u64)| *cycle < record.cycle;
            while self.received.front().is_some_and(is_older) {
                self.received.pop_front();
            }
            let received = self.received.front().copied();
            let received = received.filter(|(cycle, _)| *cycle == record.cycle);
            self.seen.push(Seen {
                record: Box::new(record),
                received_ns: received.map(|(_, received_ns)| received_ns),
            });
        }
        Ok(())
    }
}
