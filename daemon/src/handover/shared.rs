use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};

use crate::latch::Latch;

/// A flag set by one thread. A reader that sees it set also sees all earlier writes of that thread.
#[derive(Debug, Default)]
pub struct Flag(AtomicBool);

impl Flag {
    pub fn set(&self, is_set: bool) {
        self.0.store(is_set, Ordering::Release);
    }

    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::Acquire)
    }
}

/// A counter. A reader that sees a new value also sees all writes before the increment.
#[derive(Debug, Default)]
pub struct Count(AtomicU64);

impl Count {
    pub fn add(&self, more: u64) {
        self.0.fetch_add(more, Ordering::Release);
    }

    pub fn get(&self) -> u64 {
        self.0.load(Ordering::Acquire)
    }
}

/// Flags and counters visible to all threads.
#[derive(Debug, Default)]
pub struct Shared {
    ending: Flag,
    /// The cycle thread has written its last record.
    pub cycle_ended: Flag,
    /// The exchange thread has passed on its last report.
    pub exchange_ended: Flag,
    /// The supervisor has passed on its last status.
    pub supervisor_ended: Flag,
    /// The cycle thread's last command moves the robot.
    pub still_moving: Flag,
    /// The newest command sent moves the robot.
    pub last_word_moves: Flag,
    /// Records, reports, incidents and summaries lost because a ring was full.
    pub dropped_records: Count,
    /// Resets of the statistics requested by clients.
    pub statistics_resets: Count,
    pub cycle_beats: Count,
    pub exchange_beats: Count,
    pub reporter_beats: Count,
    pub status_beats: Count,
    origin_ns: AtomicU64,
    cycle_thread: AtomicU32,
    /// Set by a signal, so that a stop needs neither shared memory nor another thread.
    stop_asked: Arc<AtomicBool>,
    /// State that outlives the process.
    pub latch: Latch,
}

impl Shared {
    /// `stop_asked` is set by the signal that requests a stop; `latch` outlives the process.
    pub fn new(stop_asked: Arc<AtomicBool>, latch: Latch) -> Self {
        Self {
            stop_asked,
            latch,
            ..Self::default()
        }
    }

    /// A signal requested a stop since the last call.
    pub fn take_stop(&self) -> bool {
        // The flag is rarely set: a load costs less than a write.
        self.stop_asked.load(Ordering::Relaxed) && self.stop_asked.swap(false, Ordering::AcqRel)
    }

    /// Publishes the id of the cycle thread, so that other threads can read its scheduler statistics.
    pub fn set_cycle_thread(&self, id: u32) {
        self.cycle_thread.store(id, Ordering::Release);
    }

    /// Id of the cycle thread, once published.
    pub fn cycle_thread(&self) -> Option<u32> {
        Some(self.cycle_thread.load(Ordering::Acquire)).filter(|id| *id != 0)
    }

    /// Heartbeats of cycle, exchange, reporter and status so far.
    pub fn beats(&self) -> [u64; 4] {
        [
            &self.cycle_beats,
            &self.exchange_beats,
            &self.reporter_beats,
            &self.status_beats,
        ]
        .map(Count::get)
    }

    /// Asks every thread to end; the cycle first brings the robot to rest.
    pub fn end(&self) {
        self.ending.set(true);
    }

    pub fn is_ending(&self) -> bool {
        self.ending.is_set()
    }

    pub fn set_origin_ns(&self, origin_ns: u64) {
        self.origin_ns.store(origin_ns, Ordering::Release);
    }

    /// Origin of the time grid; 0 before it is chosen.
    pub fn origin_ns(&self) -> u64 {
        self.origin_ns.load(Ordering::Acquire)
    }
}
