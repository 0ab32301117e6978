//! `CLOCK_MONOTONIC`.

use std::cell::Cell;
use std::ops::RangeInclusive;

use rustix::time::{ClockId, Timespec, clock_gettime};

pub trait Clock {
    /// Present time \[ns\]. Monotonic; costs tens of nanoseconds; no system call on the supported platforms
    /// (vDSO).
    fn now_ns(&self) -> u64;

    /// Returns at `time_ns` or later; at once if that time has passed. The only call of the cycle that may
    /// block.
    fn sleep_until(&self, time_ns: u64);

    /// Core time of the calling thread so far \[ns\]. A system call. Test clocks may omit it.
    fn on_core_ns(&self) -> u64 {
        0
    }

    /// Lower and upper bound of the time for which the machine was suspended so far \[ns\].
    /// [`now_ns`](Self::now_ns) stands still during a suspend. No system call. Test clocks may omit it.
    fn slept_ns(&self) -> RangeInclusive<u64> {
        0..=0
    }
}

/// `CLOCK_MONOTONIC`, the clock of every time stamp on the wire.
#[derive(Debug, Clone, Copy, Default)]
pub struct MonotonicClock;

impl Clock for MonotonicClock {
    fn now_ns(&self) -> u64 {
        read_ns(ClockId::Monotonic)
    }

    fn sleep_until(&self, time_ns: u64) {
        let until = Timespec {
            tv_sec: (time_ns / 1_000_000_000).cast_signed(),
            tv_nsec: (time_ns % 1_000_000_000).cast_signed(),
        };
        // A signal may end the sleep early; then the rest is slept.
        while rustix::thread::clock_nanosleep_absolute(ClockId::Monotonic, &until)
            == Err(rustix::io::Errno::INTR)
        {}
    }

    fn on_core_ns(&self) -> u64 {
        read_ns(ClockId::ThreadCPUTime)
    }

    fn slept_ns(&self) -> RangeInclusive<u64> {
        // The thread may stall between two readings. The middle reading is later than the first and earlier
        // than the last.
        let before_ns = read_ns(ClockId::Monotonic);
        let awake_or_not_ns = read_ns(ClockId::Boottime);
        let after_ns = read_ns(ClockId::Monotonic);
        awake_or_not_ns.saturating_sub(after_ns)..=awake_or_not_ns.saturating_sub(before_ns)
    }
}

/// A clock that a test advances; all times in \[ns\].
#[derive(Debug, Default)]
#[allow(clippy::struct_field_names, reason = "the unit ends each name")]
pub struct ManualClock {
    pub now_ns: Cell<u64>,
    /// Advance per reading: a large one simulates a slow computation.
    pub step_ns: Cell<u64>,
    /// Lateness of the end of each sleep.
    pub late_ns: Cell<u64>,
    pub slept_ns: Cell<u64>,
}

impl ManualClock {
    pub fn new(now_ns: u64) -> Self {
        Self {
            now_ns: Cell::new(now_ns),
            ..Self::default()
        }
    }
}

impl Clock for ManualClock {
    fn now_ns(&self) -> u64 {
        self.now_ns.set(self.now_ns.get() + self.step_ns.get());
        self.now_ns.get()
    }

    fn sleep_until(&self, time_ns: u64) {
        self.now_ns
            .set(self.now_ns.get().max(time_ns) + self.late_ns.get());
    }

    fn slept_ns(&self) -> RangeInclusive<u64> {
        self.slept_ns.get()..=self.slept_ns.get()
    }
}

fn read_ns(clock: ClockId) -> u64 {
    let now = clock_gettime(clock);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn least_and_most_of_the_sleep_are_apart_by_the_time_between_the_readings() {
        let begin_ns = MonotonicClock.now_ns();
        let slept_ns = MonotonicClock.slept_ns();
        let took_ns = MonotonicClock.now_ns() - begin_ns;
        assert!(slept_ns.start() <= slept_ns.end());
        assert!(slept_ns.end() - slept_ns.start() <= took_ns);
    }
}
