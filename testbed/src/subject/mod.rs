//! What is measured: a daemon as a real process, in a place of its own.

pub mod asker;
pub mod baseline;
pub mod cyclictest;
pub mod daemon;
pub mod tracking;

use std::time::Duration;

use cdcr_shared_types::codes::LateCause;

pub const ROBOT: &str = "bench";

/// How long a daemon, or whatever else is measured, may take to do what it is asked for: to control its robot, to send a status, to
/// follow, to answer. On a machine that stalls it may wait for the processor.
pub const TIMEOUT: Duration = Duration::from_secs(10);

/// One cycle of whatever was measured, in the terms of its release.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cycle {
    /// The release that it slept for \[ns, `CLOCK_MONOTONIC`\].
    pub due_ns: u64,
    pub wake_ns: u64,
    /// From there to the hand-over of its command \[ns\].
    pub response_ns: u64,
    pub late_start: bool,
    pub deadline_miss: bool,
    pub skipped_periods: u32,
    /// What made it late, or made it skip.
    pub cause: LateCause,
    /// How long its thread waited for the core since the cycle before \[ns\].
    pub run_delay_ns: u64,
}
