use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};

/// Flags and counters that all threads see.
#[derive(Debug, Default)]
pub struct Shared {
    ending: AtomicBool,
    cycle_ended: AtomicBool,
    exchange_ended: AtomicBool,
    supervisor_ended: AtomicBool,
    dropped_records: AtomicU64,
    origin_ns: AtomicU64,
    cycle_thread: AtomicU32,
    cycle_beats: AtomicU64,
    exchange_beats: AtomicU64,
    reporter_beats: AtomicU64,
    status_beats: AtomicU64,
    statistics_resets: AtomicU64,
    still_moving: AtomicBool,
    last_word_moves: AtomicBool,
    /// Set by a signal, so that neither shared memory nor another thread is needed for a stop.
    stop_asked: Arc<AtomicBool>,
}

impl Shared {
    /// With a flag that a signal sets when it asks for a stop.
    pub fn with_stop_flag(stop_asked: Arc<AtomicBool>) -> Self {
        Self {
            stop_asked,
            ..Self::default()
        }
    }

    /// Whether a stop was asked for by a signal since the last call.
    pub fn take_stop(&self) -> bool {
        // The flag is hardly ever set: a look costs less than a write.
        self.stop_asked.load(Ordering::Relaxed) && self.stop_asked.swap(false, Ordering::AcqRel)
    }

    /// The cycle thread has made its last command, and it was (not) zero rates.
    pub fn set_still_moving(&self, still_moving: bool) {
        self.still_moving.store(still_moving, Ordering::Release);
    }

    /// Whether the last command let the robot move on.
    pub fn is_still_moving(&self) -> bool {
        self.still_moving.load(Ordering::Acquire)
    }

    /// A command has left, and it was (not) zero rates.
    pub fn set_last_word_moves(&self, moves: bool) {
        self.last_word_moves.store(moves, Ordering::Release);
    }

    /// Whether the newest command that left lets the robot move on.
    pub fn last_word_moves(&self) -> bool {
        self.last_word_moves.load(Ordering::Acquire)
    }

    /// The cycle thread says who it is, so that others can read what the scheduler counts of it.
    pub fn set_cycle_thread(&self, id: u32) {
        self.cycle_thread.store(id, Ordering::Release);
    }

    /// Id of the cycle thread, once it has said it.
    pub fn cycle_thread(&self) -> Option<u32> {
        Some(self.cycle_thread.load(Ordering::Acquire)).filter(|id| *id != 0)
    }

    /// The cycle thread lives.
    pub fn beat_cycle(&self) {
        self.cycle_beats.fetch_add(1, Ordering::Relaxed);
    }

    /// The exchange thread lives.
    pub fn beat_exchange(&self) {
        self.exchange_beats.fetch_add(1, Ordering::Relaxed);
    }

    /// The reporter thread lives.
    pub fn beat_reporter(&self) {
        self.reporter_beats.fetch_add(1, Ordering::Relaxed);
    }

    /// The thread that publishes the status lives.
    pub fn beat_status(&self) {
        self.status_beats.fetch_add(1, Ordering::Relaxed);
    }

    /// Beats of cycle, exchange, reporter and status so far.
    pub fn beats(&self) -> [u64; 4] {
        [
            &self.cycle_beats,
            &self.exchange_beats,
            &self.reporter_beats,
            &self.status_beats,
        ]
        .map(|beats| beats.load(Ordering::Relaxed))
    }

    /// A client wants the statistics to begin anew.
    pub fn reset_statistics(&self) {
        self.statistics_resets.fetch_add(1, Ordering::Release);
    }

    /// How often that was wanted.
    pub fn statistics_resets(&self) -> u64 {
        self.statistics_resets.load(Ordering::Acquire)
    }

    /// Asks every thread to come to an end: the cycle brings the robot to rest first.
    pub fn end(&self) {
        self.ending.store(true, Ordering::Release);
    }

    pub fn is_ending(&self) -> bool {
        self.ending.load(Ordering::Acquire)
    }

    /// The cycle thread has made its last record.
    pub fn set_cycle_ended(&self) {
        self.cycle_ended.store(true, Ordering::Release);
    }

    /// Whether the cycle thread has made its last record.
    pub fn has_cycle_ended(&self) -> bool {
        self.cycle_ended.load(Ordering::Acquire)
    }

    /// The exchange thread has handed its last report on.
    pub fn set_exchange_ended(&self) {
        self.exchange_ended.store(true, Ordering::Release);
    }

    /// Whether the exchange thread has handed its last report on.
    pub fn has_exchange_ended(&self) -> bool {
        self.exchange_ended.load(Ordering::Acquire)
    }

    /// The supervisor has handed its last status on.
    pub fn set_supervisor_ended(&self) {
        self.supervisor_ended.store(true, Ordering::Release);
    }

    /// Whether the supervisor has handed its last status on.
    pub fn has_supervisor_ended(&self) -> bool {
        self.supervisor_ended.load(Ordering::Acquire)
    }

    /// A record, report, incident or summary was lost because a ring was full.
    pub fn count_dropped_record(&self) {
        self.count_dropped_records(1);
    }

    /// As [`count_dropped_record`](Self::count_dropped_record), for several.
    pub fn count_dropped_records(&self, count: u64) {
        self.dropped_records.fetch_add(count, Ordering::Relaxed);
    }

    /// How many of them so far.
    pub fn dropped_records(&self) -> u64 {
        self.dropped_records.load(Ordering::Relaxed)
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
