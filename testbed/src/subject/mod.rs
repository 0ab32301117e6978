//! The measured programs: a daemon as a real process in a private place, and the programs beside it.

pub mod asker;
pub mod baseline;
pub mod cyclictest;
pub mod daemon;
pub mod phases;
pub mod service_manager;
pub mod stop;
pub mod tracking;
pub mod transport;
pub mod watcher;

use std::time::Duration;

use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::{LateCause, timing};

pub const ROBOT: &str = "bench";

/// Time limit for a measured program to react: to control its robot, send a status, follow or answer. Long,
/// because on a machine that stalls the program may wait for the processor.
pub const TIMEOUT: Duration = Duration::from_secs(10);

/// One cycle of a measured program, relative to its release.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cycle {
    /// Release that the cycle slept for \[ns, `CLOCK_MONOTONIC`\].
    pub due_ns: u64,
    pub wake_ns: u64,
    /// Response time: from the release to the hand-over of the command \[ns\].
    pub response_ns: u64,
    pub late_start: bool,
    pub deadline_miss: bool,
    pub skipped_periods: u32,
    /// Cause of a late start, miss or skip.
    pub cause: LateCause,
    /// Time that the thread waited for the core since the cycle before \[ns\].
    pub run_delay_ns: u64,
}

impl Cycle {
    /// The cycle of a daemon's record.
    pub fn from_record(record: &Telemetry) -> Self {
        let has = |flag: u32| record.timing_flags & flag != 0;
        let since_due_ns = |time_ns: u64| time_ns.saturating_sub(record.due_ns);
        let cause = LateCause::try_from(record.scheduling.late_cause);
        Self {
            due_ns: record.due_ns,
            wake_ns: since_due_ns(record.start_ns),
            response_ns: since_due_ns(record.handed_over_ns),
            late_start: has(timing::LATE_START),
            deadline_miss: has(timing::DEADLINE_MISS),
            skipped_periods: record.skipped_periods,
            cause: cause.unwrap_or(LateCause::None),
            run_delay_ns: record.scheduling.run_delay_ns,
        }
    }
}
