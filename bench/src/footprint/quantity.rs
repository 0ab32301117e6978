//! What a footprint consists of: each number, its unit, and what it may be at most.

use super::round::Round;

/// The real-time core may use so much at 200 Hz \[%\].
const CORE_MAX_PERCENT: f64 = 3.0;
const RESIDENT_MAX_MB: f64 = 64.0;
pub(super) const MB: f64 = 1e6;
/// Unit of what is or is not: 1 is yes, 0 no.
pub(super) const YES_NO: &str = "yes/no";

pub(super) struct Quantity {
    pub(super) what: &'static str,
    /// For JSON, CSV and the metrics; with its unit at the end.
    pub(super) key: &'static str,
    pub(super) unit: &'static str,
    pub(super) value: fn(&Round) -> f64,
    pub(super) target: Option<f64>,
}

/// One line for each: what, key, unit, value, and a target where there is one.
macro_rules! quantities {
    (@target) => { None };
    (@target $target:expr) => { Some($target) };
    ($($what:literal, $key:literal, $unit:expr, $value:expr $(, at most $target:expr)?;)+) => {
        [$(Quantity {
            what: $what,
            key: $key,
            unit: $unit,
            value: $value,
            target: quantities!(@target $($target)?),
        }),+]
    };
}

/// All that is measured, the figures with a target first.
pub(super) const QUANTITIES: [Quantity; 22] = quantities! {
    "real-time core, tracking", "core_tracking_percent", "%", Round::core_tracking_percent, at most CORE_MAX_PERCENT;
    "resident memory", "resident_mb", "MB", |r| r.after_tracking.resident_bytes as f64 / MB, at most RESIDENT_MAX_MB;
    "resident memory added while tracking", "growth_kb", "kB", |r| r.growth_bytes() * 1e-3, at most 0.0;
    "page faults while tracking", "page_faults", "", |r| r.faults() as f64, at most 0.0;
    "resident at the start", "resident_start_mb", "MB", |r| r.after_start.resident_bytes as f64 / MB;
    "resident memory added without a client", "growth_idle_kb", "kB", |r| r.growth_idle_bytes() * 1e-3;
    "resident memory added by the first client", "growth_by_client_kb", "kB", |r| r.growth_by_client_bytes() * 1e-3;
    "memory locked", "locked", YES_NO, |r| f64::from(r.memory_locked);
    "real-time core, idle", "core_idle_percent", "%", Round::core_idle_percent;
    "all threads, tracking", "all_tracking_percent", "%", |r| r.sum(|thread| thread.tracking_percent);
    "all threads, idle", "all_idle_percent", "%", |r| r.sum(|thread| thread.idle_percent);
    "most that ever was resident", "peak_mb", "MB", |r| r.after_tracking.peak_bytes as f64 / MB;
    "resident: heap and stacks", "own_mb", "MB", |r| r.after_tracking.own_bytes as f64 / MB;
    "resident: shared memory", "shared_mb", "MB", |r| r.after_tracking.shared_bytes as f64 / MB;
    "resident: program and libraries", "file_mb", "MB", |r| r.after_tracking.file_bytes as f64 / MB;
    "locked, by address range", "locked_mb", "MB", |r| r.after_tracking.locked_bytes as f64 / MB;
    "files in shared memory", "memory_files", "", |r| r.shared_memory.files as f64;
    "shared memory in use", "memory_stored_mb", "MB", |r| r.shared_memory.stored_bytes as f64 / MB;
    "files below the root folder", "root_files", "", |r| r.root.files as f64;
    "start to first release", "first_release_ms", "ms", |r| r.start.first_release_ms;
    "start to first good cycle (READY=1)", "ready_ms", "ms", |r| r.start.ready_ms;
    "start to first record at a client", "first_record_ms", "ms", |r| r.start.first_record_ms;
};
