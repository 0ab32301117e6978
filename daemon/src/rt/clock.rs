//! `CLOCK_MONOTONIC`.

use rustix::time::{ClockId, Timespec, clock_gettime};

use crate::ports::Clock;

/// `CLOCK_MONOTONIC`, the clock of every time stamp on the wire.
#[derive(Debug, Clone, Copy, Default)]
pub struct MonotonicClock;

impl Clock for MonotonicClock {
    fn now_ns(&self) -> u64 {
        let now = clock_gettime(ClockId::Monotonic);
        now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
    }

    fn sleep_until(&self, time_ns: u64) {
        let until = Timespec {
            tv_sec: (time_ns / 1_000_000_000).cast_signed(),
            tv_nsec: (time_ns % 1_000_000_000).cast_signed(),
        };
        // A signal may end the sleep early; then the rest of it is slept.
        while rustix::thread::clock_nanosleep_absolute(ClockId::Monotonic, &until)
            == Err(rustix::io::Errno::INTR)
        {}
    }
}
