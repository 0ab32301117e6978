use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};

use crate::latch::Latch;

/// A flag of one thread. Who sees it sees all that its thread did before.
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

/// A number that only grows. Who sees it sees all that was done before it grew.
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

/// Flags and counters that all threads see.
#[derive(Debug, Default)]
pub struct Shared {
    ending: Flag,
    /// The cycle thread has made its last record.
    pub cycle_ended: Flag,
    /// The exchange thread has handed its last report on.
    pub exchange_ended: Flag,
    /// The supervisor has handed its last status on.
    pub supervisor_ended: Flag,
    /// The last command of the cycle thread lets the robot move on.
    pub still_moving: Flag,
    /// The newest command that left lets the robot move on.
    pub last_word_moves: Flag,
    /// Records, reports, incidents and summaries that were lost because a ring was full.
    pub dropped_records: Count,
    /// How often a client wanted the statistics to begin anew.
    pub statistics_resets: Count,
    pub cycle_beats: Count,
    pub exchange_beats: Count,
    pub reporter_beats: Count,
    pub status_beats: Count,
    origin_ns: AtomicU64,
    cycle_thread: AtomicU32,
    /// Set by a signal, so that neither shared memory nor another thread is needed for a stop.
    stop_asked: Arc<AtomicBool>,
    /// What outlives this process.
    pub latch: Latch,
}

impl Shared {
    /// With a flag that a signal sets when it asks for a stop, and what outlives the process.
    pub fn new(stop_asked: Arc<AtomicBool>, latch: Latch) -> Self {
        Self {
            stop_asked,
            latch,
            ..Self::default()
        }
    }

    /// Whether a stop was asked for by a signal since the last call.
    pub fn take_stop(&self) -> bool {
        // The flag is hardly ever set: a look costs less than a write.
        self.stop_asked.load(Ordering::Relaxed) && self.stop_asked.swap(false, Ordering::AcqRel)
    }

    /// The cycle thread says who it is, so that others can read what the scheduler counts of it.
    pub fn set_cycle_thread(&self, id: u32) {
        self.cycle_thread.store(id, Ordering::Release);
    }

    /// Id of the cycle thread, once it has said it.
    pub fn cycle_thread(&self) -> Option<u32> {
        Some(self.cycle_thread.load(Ordering::Acquire)).filter(|id| *id != 0)
    }

    /// Signs of life of cycle, exchange, reporter and status so far.
    pub fn beats(&self) -> [u64; 4] {
        [
            &self.cycle_beats,
            &self.exchange_beats,
            &self.reporter_beats,
            &self.status_beats,
        ]
        .map(Count::get)
    }

    /// Asks every thread to come to an end: the cycle brings the robot to rest first.
    pub fn end(&self) {
        self.ending.set(true);
    }

    pub fn is_ending(&self) -> bool {
        self.ending.is_set()
    }

    /// The origin of the time grid, once it is chosen.
    pub fn set_origin_ns(&self, origin_ns: u64) {
        self.origin_ns.store(origin_ns, Ordering::Release);
    }

    /// The origin of the time grid; 0 before it is chosen.
    pub fn origin_ns(&self) -> u64 {
        self.origin_ns.load(Ordering::Acquire)
    }
}
