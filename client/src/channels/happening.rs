use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::{LateCause, Mode, Outcome, Reason, timing};

use crate::request::PoseDifference;
use crate::{counted, events};

/// Severity: the levels of `rcl_interfaces/Log`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Level {
    /// A normal event, such as a change of mode by a request.
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
    /// How serious it is.
    pub level: Level,
}

/// Events of a record compared with the previous one: mode, refusals, number of obstacles and lateness.
pub fn happenings(record: &Telemetry, before: Option<&Telemetry>) -> Vec<Happening> {
    let mut found = Vec::new();
    let mut add = |level, text| found.push(Happening { text, level });
    if before.is_none_or(|before| (before.mode, before.reason) != (record.mode, record.reason)) {
        let (mode, reason) = (Mode::text_of(record.mode), Reason::text_of(record.reason));
        let level = if Mode::is_latched(record.mode) {
            Level::Error
        } else {
            Level::Info
        };
        add(level, format!("{mode}: {reason}"));
    }
    if let Some(pose) = before.and_then(|before| accepted_pose(record, before)) {
        let text =
            format!("the reset accepted a pose that differs from that of the last command{pose}");
        add(Level::Warning, text);
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

/// The difference of a pose that the reset in this cycle accepted.
fn accepted_pose(record: &Telemetry, before: &Telemetry) -> Option<PoseDifference> {
    let [was_latched, is_latched] = [before, record].map(|record| Mode::is_latched(record.mode));
    (was_latched && !is_latched && record.pose_differs != 0)
        .then(|| PoseDifference::of_errors(&record.following_error_rad))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reset_that_accepts_another_pose_is_a_warning() {
        let record = |mode: Mode, differs: bool| {
            let mut record = Telemetry {
                mode: mode.code(),
                pose_differs: u32::from(differs),
                ..Telemetry::default()
            };
            record.following_error_rad[1] = 0.834;
            record
        };
        let stopped = record(Mode::Stopped, true);
        for (mode, differs, warnings) in [
            (Mode::Holding, true, 1),
            (Mode::Holding, false, 0),
            (Mode::Stopped, true, 0),
        ] {
            let found = happenings(&record(mode, differs), Some(&stopped));
            let warned = found.iter().filter(|found| {
                found.level == Level::Warning
                    && found.text.ends_with("command: section 2 by 0.83 rad")
            });
            assert_eq!(warned.count(), warnings, "{found:?}");
        }
    }
}
