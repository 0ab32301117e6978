//! The output of `cdcrd bare`, declared once for its writer and its readers.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::LatencySummary;

/// Columns of `cdcrd bare --format csv`.
pub const BARE_COLUMNS: &str = "cycle,due_ns,start_ns,handed_over_ns,skipped_periods,late_start,deadline_miss,run_delay_ns,page_faults,cause";

/// Summary of a bare loop, for `--format json`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct BareSummary {
    /// Period \[ns\].
    pub period_ns: u64,
    /// Deadline after the release \[ns\].
    pub deadline_ns: u64,
    /// A start later than this after the release is a late start \[ns\].
    pub late_start_ns: u64,
    /// Time before each release at which the thread wakes up and spins \[ns\].
    pub spin_ns: u64,
    /// Time on the grid covered by the cycles \[s\].
    pub duration_s: f64,
    /// Cycles of the loop.
    pub cycles: u64,
    /// Cycles with a late start.
    pub late_starts: u64,
    /// Cycles that missed their deadline.
    pub deadline_misses: u64,
    /// Releases without a cycle.
    pub skipped_periods: u64,
    /// Number of late cycles by cause. A cycle that only follows an overrun has no cause of its own.
    pub causes: BTreeMap<String, u64>,
    /// Wake-up latency.
    pub wake: LatencySummary,
    /// Time ready to run while another task had the core, per cycle. `None` if the kernel does not report it.
    pub run_delay: Option<LatencySummary>,
    /// Page faults, minor and major. `None` if the kernel does not report them.
    pub page_faults: Option<u64>,
    /// All real-time properties were granted: `SCHED_FIFO`, a core, locked memory.
    pub realtime: bool,
    /// The missing properties.
    pub realtime_missing: Vec<String>,
    /// Core of the thread, if it is pinned.
    pub core: Option<usize>,
}
