//! Threads of observers: pinned, and with priority over ordinary threads.

use rustix::thread::{ClockId, clock_nanosleep_absolute};
use rustix::time::Timespec;
use thread_priority::unix::{
    RealtimeThreadSchedulePolicy, ThreadSchedulePolicy, set_thread_priority_and_policy,
    thread_native_id,
};
use thread_priority::{ThreadPriority, ThreadPriorityValue};

/// Priority of a thread that observes the daemon from another core. Below the daemon's, so that it never
/// delays the daemon on a machine with one core.
pub const CLIENT_PRIORITY: u8 = 60;

/// Pins the calling thread. Returns whether the system granted it.
pub fn pin(core: usize) -> bool {
    core_affinity::set_for_current(core_affinity::CoreId { id: core })
}

/// Gives the calling thread `SCHED_FIFO` at `priority`, 1 to 99. Returns whether the system granted it.
pub fn set_fifo(priority: u8) -> bool {
    let Ok(value) = ThreadPriorityValue::try_from(priority) else {
        return false;
    };
    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    let priority = ThreadPriority::Crossplatform(value);
    set_thread_priority_and_policy(thread_native_id(), priority, policy).is_ok()
}

/// Whether this process may have real-time threads; tested with a thread that ends at once.
pub fn may_be_realtime() -> bool {
    std::thread::spawn(|| set_fifo(1)).join().unwrap_or(false)
}

/// Sleeps until `time_ns` on `CLOCK_MONOTONIC`; returns at once if that time has passed.
pub fn sleep_until(time_ns: u64) {
    let until = Timespec {
        tv_sec: (time_ns / 1_000_000_000).cast_signed(),
        tv_nsec: (time_ns % 1_000_000_000).cast_signed(),
    };
    // Sleeps again after a signal.
    while clock_nanosleep_absolute(ClockId::Monotonic, &until) == Err(rustix::io::Errno::INTR) {}
}

#[cfg(test)]
mod tests {
    use cdcr_client::monotonic_ns;

    use super::*;

    #[test]
    fn a_sleep_ends_after_its_time() {
        let until_ns = monotonic_ns() + 2_000_000;
        sleep_until(until_ns);
        assert!(monotonic_ns() >= until_ns);
        sleep_until(0);
    }
}
