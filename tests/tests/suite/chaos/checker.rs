//! Reads every record, command and status over its own connection, and checks the invariants on each.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use cdcr_client::{CommandStream, Connection, Stream, TelemetryStream};
use cdcr_shared_types::codes::Outcome;
use cdcr_shared_types::{Command, Status, Telemetry};
use cdcr_tests::record::robot_of;
use cdcr_tests::{TIMEOUT, wait_status};

use crate::chaos::records::{Records, Seen};
use crate::chaos::{CheckResult, ensure};

/// The newest record, for the position of the robot, and whether the run has seen everything required.
#[derive(Debug)]
pub(crate) struct View {
    newest: Mutex<Option<Box<Telemetry>>>,
    has_seen_enough: AtomicBool,
    /// Number of started `cdcrctl stop`.
    stops: AtomicU64,
    duration: Duration,
}

impl View {
    /// For a run with this nominal duration.
    pub(crate) fn new(duration: Duration) -> Self {
        Self {
            newest: Mutex::default(),
            has_seen_enough: AtomicBool::new(false),
            stops: AtomicU64::new(0),
            duration,
        }
    }

    pub(crate) fn newest(&self) -> Option<Box<Telemetry>> {
        let newest = self.newest.lock().unwrap_or_else(PoisonError::into_inner);
        newest.clone()
    }

    pub(crate) fn has_seen_enough(&self) -> bool {
        self.has_seen_enough.load(Ordering::Relaxed)
    }

    /// Call it before `cdcrctl stop` is started.
    pub(crate) fn count_stop(&self) {
        self.stops.fetch_add(1, Ordering::Relaxed);
    }

    fn show(&self, record: &Telemetry) {
        let mut newest = self.newest.lock().unwrap_or_else(PoisonError::into_inner);
        match newest.as_mut() {
            Some(shown) => **shown = *record,
            None => *newest = Some(Box::new(*record)),
        }
    }
}

/// The streams and the previous messages.
pub(crate) struct Checker<'a> {
    connection: Connection,
    telemetry: TelemetryStream,
    commands: CommandStream,
    statuses: Stream<Status>,
    view: &'a View,
    records: Records,
    command: Option<Command>,
    status: Status,
}

impl<'a> Checker<'a> {
    pub(crate) fn new(connection: Connection, view: &'a View) -> Self {
        // The first status may come before the grid is known.
        let status = wait_status(&connection, |status| status.origin_ns > 0);
        Self {
            telemetry: connection.telemetry().unwrap(),
            commands: connection.commands().unwrap(),
            statuses: connection.statuses().unwrap(),
            connection,
            view,
            records: Records::new(
                robot_of(&status.robot),
                status.link,
                status.period_ns,
                status.origin_ns,
            ),
            command: None,
            status,
        }
    }

    /// Checks until `ending`; sets it when an invariant is broken.
    pub(crate) fn run(mut self, ending: &AtomicBool) -> Result<Seen, String> {
        while !ending.load(Ordering::Relaxed) {
            let drained = self.drain();
            if drained.is_err() {
                ending.store(true, Ordering::Relaxed);
            }
            drained?;
            let is_enough = self.records.seen.missing(self.view.duration).is_none();
            self.view
                .has_seen_enough
                .store(is_enough, Ordering::Relaxed);
            std::thread::sleep(Duration::from_millis(2));
        }
        self.drain()?;
        self.records.finish()?;
        self.compare_counts()?;
        Ok(self.records.seen)
    }

    fn drain(&mut self) -> CheckResult {
        let lost = |error: cdcr_client::LinkError| error.to_string();
        let stops = self.view.stops.load(Ordering::Relaxed);
        self.records.may_have_signals(stops);
        while let Some(record) = self.telemetry.try_next().map_err(lost)? {
            self.records.check(&record)?;
            self.view.show(&record);
        }
        while let Some(command) = self.commands.try_next().map_err(lost)? {
            self.check_command(&command)
                .map_err(|broken| format!("{broken}\nin {command:#?}"))?;
            self.command = Some(command);
        }
        while let Some(status) = self.statuses.try_next().map_err(lost)? {
            self.check_status(&status)?;
        }
        Ok(())
    }

    fn check_command(&mut self, command: &Command) -> CheckResult {
        self.records.seen.commands += 1;
        if let Some(before) = &self.command {
            let forward = command.header.sequence > before.header.sequence
                && command.cycle > before.cycle
                && command.header.sent_ns >= before.header.sent_ns;
            ensure(forward, || format!("commands go back, from {before:?}"))?;
        }
        self.records.check_command(command)
    }

    fn check_status(&mut self, status: &Status) -> CheckResult {
        self.records.seen.statuses += 1;
        let before = &self.status;
        for (what, before, now) in [
            (
                "header.sequence",
                before.header.sequence,
                status.header.sequence,
            ),
            ("cycles", before.cycles, status.cycles),
            ("faults", before.faults, status.faults),
            (
                "deadline misses",
                before.deadline_misses,
                status.deadline_misses,
            ),
            (
                "skipped periods",
                before.skipped_periods,
                status.skipped_periods,
            ),
            ("budget hits", before.budget_hits, status.budget_hits),
            (
                "refused obstacles",
                before.obstacles_refused,
                status.obstacles_refused,
            ),
            (
                "guarded cycles",
                before.clearance_guarded,
                status.clearance_guarded,
            ),
            (
                "dropped records",
                before.dropped_records,
                status.dropped_records,
            ),
        ] {
            ensure(now >= before, || {
                format!("{what} of the status goes from {before} to {now}")
            })?;
        }
        for (code, (before, now)) in before.outcomes.iter().zip(status.outcomes).enumerate() {
            ensure(now >= *before, || format!("outcome {code} is counted down"))?;
        }
        self.records.seen.counted_faults = status.faults;
        for (outcome, count) in Outcome::ALL.iter().zip(status.outcomes) {
            self.records.seen.outcomes.insert(outcome.text(), count);
        }
        self.status = *status;
        Ok(())
    }

    /// The status counts every observed fault. It may count more: a reset in the cycle of a fault hides the
    /// fault from the records.
    fn compare_counts(&mut self) -> CheckResult {
        let (seen, begin) = (self.records.seen.entered_faults, Instant::now());
        loop {
            let status = self.connection.status(TIMEOUT);
            self.check_status(&status.map_err(|error| error.to_string())?)?;
            let counted = self.records.seen.counted_faults;
            if counted >= seen {
                return Ok(());
            }
            ensure(begin.elapsed() < TIMEOUT, || {
                format!("{seen} faults were seen, and {counted} are counted")
            })?;
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}
