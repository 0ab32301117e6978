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

/// All that is measured, the figures with a target first.
pub(super) const QUANTITIES: [Quantity; 22] = [
    Quantity {
        what: "real-time core, tracking",
        key: "core_tracking_percent",
        unit: "%",
        value: Round::core_tracking_percent,
        target: Some(CORE_MAX_PERCENT),
    },
    Quantity {
        what: "resident memory",
        key: "resident_mb",
        unit: "MB",
        value: |round| round.after_tracking.resident_bytes as f64 / MB,
        target: Some(RESIDENT_MAX_MB),
    },
    Quantity {
        what: "resident memory added while tracking",
        key: "growth_kb",
        unit: "kB",
        value: |round| round.growth_bytes() * 1e-3,
        target: Some(0.0),
    },
    Quantity {
        what: "page faults while tracking",
        key: "page_faults",
        unit: "",
        value: |round| round.faults() as f64,
        target: Some(0.0),
    },
    plain(
        "resident at the start",
        "resident_start_mb",
        "MB",
        |round| round.after_start.resident_bytes as f64 / MB,
    ),
    plain(
        "resident memory added without a client",
        "growth_idle_kb",
        "kB",
        |round| round.growth_idle_bytes() * 1e-3,
    ),
    plain(
        "resident memory added by the first client",
        "growth_by_client_kb",
        "kB",
        |round| round.growth_by_client_bytes() * 1e-3,
    ),
    plain("memory locked", "locked", YES_NO, |round| {
        f64::from(round.memory_locked)
    }),
    plain(
        "real-time core, idle",
        "core_idle_percent",
        "%",
        Round::core_idle_percent,
    ),
    plain(
        "all threads, tracking",
        "all_tracking_percent",
        "%",
        |round| round.sum(|thread| thread.tracking_percent),
    ),
    plain("all threads, idle", "all_idle_percent", "%", |round| {
        round.sum(|thread| thread.idle_percent)
    }),
    plain("most that ever was resident", "peak_mb", "MB", |round| {
        round.after_tracking.peak_bytes as f64 / MB
    }),
    plain("resident: heap and stacks", "own_mb", "MB", |round| {
        round.after_tracking.own_bytes as f64 / MB
    }),
    plain("resident: shared memory", "shared_mb", "MB", |round| {
        round.after_tracking.shared_bytes as f64 / MB
    }),
    plain(
        "resident: program and libraries",
        "file_mb",
        "MB",
        |round| round.after_tracking.file_bytes as f64 / MB,
    ),
    plain("locked, by address range", "locked_mb", "MB", |round| {
        round.after_tracking.locked_bytes as f64 / MB
    }),
    plain("files in shared memory", "memory_files", "", |round| {
        round.shared_memory.files as f64
    }),
    plain("shared memory in use", "memory_stored_mb", "MB", |round| {
        round.shared_memory.stored_bytes as f64 / MB
    }),
    plain("files below the root folder", "root_files", "", |round| {
        round.root.files as f64
    }),
    plain(
        "start to first release",
        "first_release_ms",
        "ms",
        |round| round.start.first_release_ms,
    ),
    plain(
        "start to first good cycle (READY=1)",
        "ready_ms",
        "ms",
        |round| round.start.ready_ms,
    ),
    plain(
        "start to first record at a client",
        "first_record_ms",
        "ms",
        |round| round.start.first_record_ms,
    ),
];

const fn plain(
    what: &'static str,
    key: &'static str,
    unit: &'static str,
    value: fn(&Round) -> f64,
) -> Quantity {
    Quantity {
        what,
        key,
        unit,
        value,
        target: None,
    }
}
