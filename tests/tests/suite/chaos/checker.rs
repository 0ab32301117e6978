//! Reads every record, every command and every status with a connection of its own, and holds each to the
//! invariants.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use cdcr_client::{CommandStream, Connection, Stream, TelemetryStream, events, obstacles};
use cdcr_controller::robot::Robot;
use cdcr_shared_types::codes::{Mode, Outcome, Reason, guard};
use cdcr_shared_types::{Command, Status, Telemetry};
use cdcr_tests::record::robot_of;
use cdcr_tests::{PATIENCE, wait_status};

use crate::chaos::modes::{ModeWatch, place};
use crate::chaos::{KINDS_TAKE, Verdict, clearance, ensure, grid, limits, ramp};

/// The newest record, for those who want to know where the robot is; and whether the run has seen all that it must.
#[derive(Debug)]
pub(crate) struct View {
    newest: Mutex<Option<Box<Telemetry>>>,
    has_seen_enough: AtomicBool,
    duration: Duration,
}

impl View {
    /// For a run that is meant to last for `duration`.
    pub(crate) fn new(duration: Duration) -> Self {
        Self {
            newest: Mutex::default(),
            has_seen_enough: AtomicBool::new(false),
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

    fn show(&self, record: &Telemetry) {
        let mut newest = self.newest.lock().unwrap_or_else(PoisonError::into_inner);
        match newest.as_mut() {
            Some(shown) => **shown = *record,
            None => *newest = Some(Box::new(*record)),
        }
    }
}

/// What was checked.
#[derive(Debug, Default)]
pub(crate) struct Seen {
    pub(crate) records: u64,
    pub(crate) commands: u64,
    pub(crate) statuses: u64,
    /// Records that were lost on the way, or inside the daemon.
    pub(crate) gaps: u64,
    pub(crate) skipped_periods: u64,
    pub(crate) deadline_misses: u64,
    /// Records with obstacles whose clearances were computed again, and those of which the guard changed the command.
    pub(crate) with_obstacles: u64,
    pub(crate) guarded: u64,
    /// Records in a mode, by its name, and changes of the mode.
    pub(crate) modes: BTreeMap<&'static str, u64>,
    pub(crate) changes: BTreeMap<String, u64>,
    /// Records in which a limit changed the command, by its name.
    pub(crate) limited: BTreeMap<&'static str, u64>,
    /// Records of tracking cycles whose robot moved.
    pub(crate) tracked_moving: u64,
    /// Input messages by what became of them.
    pub(crate) outcomes: BTreeMap<&'static str, u64>,
    entered_faults: u64,
    counted_faults: u64,
}

impl Seen {
    /// What a run of this length must still see: as many records as half of its cycles, every mode, a robot that tracks
    /// and meets obstacles in one record of fifty; and in a long one every kind of bad message.
    pub(crate) fn missing(&self, duration: Duration) -> Option<String> {
        let meant = duration.as_secs() * 200;
        let counts = [
            ("records", self.records, meant / 2),
            ("commands", self.commands, meant / 3),
            ("statuses", self.statuses, duration.as_secs()),
            (
                "records of tracking",
                self.tracked_moving,
                self.records / 50,
            ),
            (
                "records with obstacles",
                self.with_obstacles,
                self.records / 50,
            ),
            ("guarded records", self.guarded, 0),
        ];
        let modes = [
            Mode::Holding,
            Mode::Tracking,
            Mode::Homing,
            Mode::Stopped,
            Mode::Faulted,
        ]
        .map(|mode| (mode.text(), self.in_mode(mode), 0));
        let kinds = [
            Outcome::Accepted,
            Outcome::NotFinite,
            Outcome::NoLease,
            Outcome::InThePast,
            Outcome::BufferFull,
        ];
        let kinds = kinds.map(|kind| {
            let judged = self.outcomes.get(kind.text()).copied();
            (kind.text(), judged.unwrap_or(0), 0)
        });
        let is_long = duration >= KINDS_TAKE;
        let kinds = kinds.into_iter().filter(|_| is_long);
        let mut all = counts.into_iter().chain(modes).chain(kinds);
        let (what, seen, least) = all.find(|(_, seen, least)| seen <= least)?;
        Some(format!(
            "{what}: only {seen}, and more than {least} are due"
        ))
    }

    pub(crate) fn in_mode(&self, mode: Mode) -> u64 {
        self.modes.get(mode.text()).copied().unwrap_or(0)
    }
}

/// The streams and what came before.
pub(crate) struct Checker<'a> {
    connection: Connection,
    telemetry: TelemetryStream,
    commands: CommandStream,
    statuses: Stream<Status>,
    view: &'a View,
    robot: Robot,
    period_s: f64,
    origin_ns: u64,
    before: Option<Box<Telemetry>>,
    command: Option<Command>,
    status: Status,
    modes: ModeWatch,
    seen: Seen,
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
            robot: robot_of(&status.robot),
            period_s: status.period_ns as f64 * 1e-9,
            origin_ns: status.origin_ns,
            before: None,
            command: None,
            status,
            modes: ModeWatch::default(),
            seen: Seen::default(),
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
            let is_enough = self.seen.missing(self.view.duration).is_none();
            self.view
                .has_seen_enough
                .store(is_enough, Ordering::Relaxed);
            std::thread::sleep(Duration::from_millis(2));
        }
        self.drain()?;
        self.modes.finish()?;
        self.compare_counts()?;
        Ok(self.seen)
    }

    fn drain(&mut self) -> Verdict {
        let lost = |error: cdcr_client::LinkError| error.to_string();
        while let Some(record) = self.telemetry.try_next().map_err(lost)? {
            self.check_record(&record)
                .map_err(|broken| format!("{broken}\nin {}", describe(&record)))?;
            self.view.show(&record);
            self.before = Some(Box::new(record));
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

    fn check_record(&mut self, record: &Telemetry) -> Verdict {
        let is_neighbour = match &self.before {
            Some(before) => grid::check_pair(before, record)?,
            None => true,
        };
        grid::check(record, self.origin_ns)?;
        let fingerprint = self.robot.fingerprint();
        ensure(record.robot.fingerprint == fingerprint, || {
            "it is another robot".to_owned()
        })?;
        limits::check_record(&self.robot, record, self.period_s)?;
        clearance::check(&self.robot, record, self.period_s)?;
        ramp::check(record, self.period_s)?;
        self.modes.look(record, is_neighbour)?;
        self.note(record, is_neighbour)
    }

    fn note(&mut self, record: &Telemetry, is_neighbour: bool) -> Verdict {
        let (mode, reason) = place(record)?;
        let seen = &mut self.seen;
        seen.records += 1;
        seen.gaps += u64::from(!is_neighbour);
        seen.skipped_periods = record.skipped_periods_total;
        seen.deadline_misses = record.deadline_misses_total;
        seen.with_obstacles += u64::from(record.obstacle_count > 0);
        seen.guarded += u64::from(record.guard_flags & guard::CLEARANCE != 0);
        *seen.modes.entry(mode.text()).or_default() += 1;
        let moves = record
            .command
            .bend_rate_rad_s
            .iter()
            .any(|rate| *rate != 0.0);
        seen.tracked_moving += u64::from(mode == Mode::Tracking && moves);
        for (name, _) in guard::set(record.guard_flags) {
            *seen.limited.entry(name).or_default() += 1;
        }
        let before = self.before.as_deref().map(place).transpose()?;
        if let Some((from, _)) = before
            && from != mode
        {
            *seen.changes.entry(change(from, mode, reason)).or_default() += 1;
            seen.entered_faults += u64::from(mode == Mode::Faulted);
        }
        Ok(())
    }

    fn check_command(&mut self, command: &Command) -> Verdict {
        self.seen.commands += 1;
        if let Some(before) = &self.command {
            let forward = command.header.sequence > before.header.sequence
                && command.cycle > before.cycle
                && command.header.sent_ns >= before.header.sent_ns;
            ensure(forward, || format!("commands go back, from {before:?}"))?;
        }
        limits::check(&self.robot, command, self.period_s)
    }

    fn check_status(&mut self, status: &Status) -> Verdict {
        self.seen.statuses += 1;
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
        self.seen.counted_faults = status.faults;
        for (outcome, count) in Outcome::ALL.iter().zip(status.outcomes) {
            self.seen.outcomes.insert(outcome.text(), count);
        }
        self.status = *status;
        Ok(())
    }

    /// A fault that was seen is counted, as soon as a status tells. More may be counted: a reset in the cycle of a fault
    /// hides it.
    fn compare_counts(&mut self) -> Verdict {
        let (seen, begin) = (self.seen.entered_faults, Instant::now());
        loop {
            let status = self.connection.status(PATIENCE);
            self.check_status(&status.map_err(|error| error.to_string())?)?;
            let counted = self.seen.counted_faults;
            if counted >= seen {
                return Ok(());
            }
            ensure(begin.elapsed() < PATIENCE, || {
                format!("{seen} faults were seen, and {counted} are counted")
            })?;
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

fn change(from: Mode, to: Mode, reason: Reason) -> String {
    format!("{from} → {to} ({reason})")
}

/// What a broken invariant can be understood by; the whole record fills many pages.
fn describe(record: &Telemetry) -> String {
    let width = 2 * record.robot.sections as usize;
    format!(
        "cycle {}, record {}, {} ({}), limits hit: {:#b}\nbend     {:?}\nbefore   {:?}\nrates    {:?}\n\
         target   {:?}\nmeasured {:?}\nsafe distance {} m, clearance {} m, obstacles {:#?}\nevents {:#?}",
        record.cycle,
        record.header.sequence,
        Mode::text_of(record.mode),
        Reason::text_of(record.reason),
        record.guard_flags,
        &record.bend_rad[..width],
        &record.previous_rate_rad_s[..width],
        &record.command.bend_rate_rad_s[..width],
        &record.command.bend_target_rad[..width],
        &record.measurement.bend_rad[..width],
        record.settings.safe_distance_m,
        record.clearance_m,
        obstacles(record),
        events(record),
    )
}
