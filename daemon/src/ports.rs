//! What a cycle needs from outside. Each method says what it owes.

use std::ops::RangeInclusive;

use cdcr_controller::estimator::Measurement;
use cdcr_controller::robot::BendRates;

use crate::rt::handoff::CycleInputs;

/// Time.
pub trait Clock {
    /// Now \[ns\]. Never goes back; costs tens of nanoseconds; no system call on the platforms that
    /// matter (vDSO).
    fn now_ns(&self) -> u64;

    /// Returns at `time_ns` or later, at once when it has passed. The only call of the cycle that may
    /// block.
    fn sleep_until(&self, time_ns: u64);

    /// For how long the calling thread has had a core so far \[ns\]. A system call. A clock that nobody runs by need not
    /// say it.
    fn on_core_ns(&self) -> u64 {
        0
    }

    /// For how long the machine has slept so far (suspended), in which time [`now_ns`](Self::now_ns) stood still: least
    /// and most \[ns\]. No system call either. A clock of a machine that never sleeps need not say it.
    fn slept_ns(&self) -> RangeInclusive<u64> {
        0..=0
    }
}

/// A measurement with its time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimedMeasurement {
    /// What was measured.
    pub measurement: Measurement,
    /// When \[ns\].
    pub measured_ns: u64,
}

/// The robot, simulated or real, as the cycle sees it.
///
/// Both methods are called once in each cycle by the cycle thread, so they neither allocate, lock nor
/// call the system.
pub trait RobotLink {
    /// The newest measurement for the release at `release_ns`; none when there is none yet.
    fn measure(&mut self, release_ns: u64, inputs: &CycleInputs) -> Option<TimedMeasurement>;

    /// The rates that hold from the release at `release_ns` on.
    fn command(&mut self, release_ns: u64, rates: &BendRates);
}
