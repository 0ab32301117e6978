use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::{LateCause, Mode, Outcome, Reason, timing};

use crate::{counted, events};

/// Severity: the levels of `rcl_interfaces/Log`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Level {
    /// Normal.
    Info = 20,
    /// A request or message was refused, or a cycle was late.
    Warning = 30,
    /// The robot does not move until it is reset.
    Error = 40,
}

/// An event derived from two consecutive records.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Happening {
    /// Text with numbers.
    pub text: String,
    /// Severity.
    pub level: Level,
}

/// Events of a record compared with the previous one: mode, refusals, number of obstacles and lateness.
pub fn happenings(record: &Telemetry, before: Option<&Telemetry>) -> Vec<Happening> {
    let mut found = Vec::new();
    let mut add = |level, text| found.push(Happening { text, level });
    if before.is_none_or(|before| (before.mode, before.reason) != (record.mode, record.reason)) {
        let (mode, reason) = (Mode::text_of(record.mode), Reason::text_of(record.reason));
        let is_latched = [Mode::Faulted, Mode::Stopped]
            .map(Mode::code)
            .contains(&record.mode);
        let level = if is_latched {
            Level::Error
        } else {
            Level::Info
        };
        add(level, format!("{mode}: {reason}"));
    }
    for event in events(record)
        .iter()
        .filter(|event| event.outcome != Outcome::Accepted.code())
    {
        let why = Outcome::text_of(event.outcome);
        add(Level::Warning, format!("refused: {why}"));
    }
    if before.is_some_and(|before| before.obstacle_count != record.obstacle_count) {
        add(Level::Info, counted(record.obstacle_count, "obstacle"));
    }
    let cause = LateCause::try_from(record.scheduling.late_cause).unwrap_or(LateCause::None);
    if cause != LateCause::None {
        let is_miss = record.timing_flags & timing::DEADLINE_MISS != 0;
        let (level, what) = match (is_miss, record.skipped_periods) {
            (true, _) => (Level::Warning, "deadline missed".to_owned()),
            (false, 0) => (Level::Info, "late start".to_owned()),
            (false, skipped) => (Level::Info, counted(skipped, "period") + " skipped"),
        };
        add(level, format!("cycle {}: {what} ({cause})", record.cycle));
    }
    found
}
