//! Consecutive records, each checked against the invariants and counted.

use std::collections::BTreeMap;
use std::time::Duration;

use cdcr_client::{events, obstacles};
use cdcr_controller::robot::Robot;
use cdcr_shared_types::codes::{MeasurementState, Mode, Outcome, Reason, guard};
use cdcr_shared_types::{Command, Telemetry};

use crate::chaos::integral::Integral;
use crate::chaos::modes::{ModeWatch, place};
use crate::chaos::{CheckResult, KINDS_TAKE, clearance, ensure, grid, limits, ramp};

/// Counts of the checks.
#[derive(Debug, Default)]
pub(crate) struct Seen {
    pub(crate) records: u64,
    pub(crate) commands: u64,
    pub(crate) statuses: u64,
    /// Records lost on the way or inside the daemon.
    pub(crate) gaps: u64,
    pub(crate) skipped_periods: u64,
    pub(crate) deadline_misses: u64,
    /// Records with obstacles whose clearances were recomputed, and those with a command changed by the
    /// guard.
    pub(crate) with_obstacles: u64,
    pub(crate) guarded: u64,
    /// Records by name of the mode, and changes of the mode.
    pub(crate) modes: BTreeMap<&'static str, u64>,
    pub(crate) changes: BTreeMap<String, u64>,
    /// Records with a command changed by a limit, by its name.
    pub(crate) limited: BTreeMap<&'static str, u64>,
    /// Records of tracking cycles with a moving robot.
    pub(crate) tracked_moving: u64,
    /// Records that used a tip measurement in addition to bends or cables.
    pub(crate) with_tip_beside: u64,
    /// Input messages by outcome.
    pub(crate) outcomes: BTreeMap<&'static str, u64>,
    /// Faults that began in a record, also counted by the daemon.
    pub(crate) entered_faults: u64,
    pub(crate) counted_faults: u64,
}

impl Seen {
    /// Missing parts of a run of this length. It needs records for half of its cycles, every mode, and
    /// tracking and obstacles in one record of fifty. A long run also needs every kind of bad message.
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
            let evaluated = self.outcomes.get(kind.text()).copied();
            (kind.text(), evaluated.unwrap_or(0), 0)
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

/// The records of one robot, and the previous ones.
#[derive(Debug)]
pub(crate) struct Records {
    robot: Robot,
    period_s: f64,
    origin_ns: u64,
    /// Whether its cables have play: a ramp then continues along the path of the motors, independent of the
    /// cables.
    has_play: bool,
    before: Option<Box<Telemetry>>,
    integral: Integral,
    modes: ModeWatch,
    pub(crate) seen: Seen,
}

impl Records {
    /// `link`: the kind of robot of the daemon, as in its status.
    pub(crate) fn new(robot: Robot, link: u32, period_ns: u64, origin_ns: u64) -> Self {
        Self {
            robot,
            period_s: period_ns as f64 * 1e-9,
            origin_ns,
            has_play: false,
            before: None,
            integral: Integral::new(link),
            modes: ModeWatch::default(),
            seen: Seen::default(),
        }
    }

    /// The same for a robot with play in its cables.
    pub(crate) fn with_play(self, has_play: bool) -> Self {
        Self { has_play, ..self }
    }

    /// Checks the invariants on the next record.
    pub(crate) fn check(&mut self, record: &Telemetry) -> CheckResult {
        self.check_record(record)
            .map_err(|broken| format!("{broken}\nin {}", describe(record)))?;
        self.before = Some(Box::new(*record));
        Ok(())
    }

    /// Sets the number of started `cdcrctl stop`.
    pub(crate) fn may_have_signals(&mut self, most: u64) {
        self.modes.may_have_signals(most);
    }

    /// The newest record.
    pub(crate) fn newest(&self) -> Option<&Telemetry> {
        self.before.as_deref()
    }

    /// Checks the invariants on one command.
    pub(crate) fn check_command(&self, command: &Command) -> CheckResult {
        limits::check(&self.robot, command, self.period_s)
    }

    /// Checks the changes that still wait for their cause.
    pub(crate) fn finish(&mut self) -> CheckResult {
        self.modes.finish()
    }

    fn check_record(&mut self, record: &Telemetry) -> CheckResult {
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
        if !(self.has_play && clearance::is_ramp(record)) {
            clearance::check(&self.robot, record, self.period_s)?;
        }
        ramp::check(record, self.period_s)?;
        let before = self.before.as_deref().filter(|_| is_neighbour);
        if let Some(before) = before {
            ramp::check_rest(before, record)?;
        }
        self.integral.check(before, record)?;
        self.modes.look(record, is_neighbour)?;
        self.note(record, is_neighbour)
    }

    fn note(&mut self, record: &Telemetry, is_neighbour: bool) -> CheckResult {
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
        let tip_is_used = record.tip_state == MeasurementState::Used.code();
        seen.with_tip_beside += u64::from(tip_is_used);
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
}

fn change(from: Mode, to: Mode, reason: Reason) -> String {
    format!("{from} → {to} ({reason})")
}

/// The parts of a record that explain a broken invariant; the whole record fills many pages.
pub(crate) fn describe(record: &Telemetry) -> String {
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
