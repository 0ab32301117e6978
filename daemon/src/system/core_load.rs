//! Shares of the time of each core, from two readings of `/proc/stat`.

use std::collections::BTreeMap;

use cdcr_shared_types::proc_stat::{CoreTicks, core_ticks};

/// Time of each core since the machine started.
pub(crate) type CoreTimes = BTreeMap<usize, CoreTicks>;

/// Shares of one core's time, 0 to 1.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
#[cfg_attr(test, derive(serde::Serialize, serde::Deserialize), serde(default))]
pub(crate) struct CoreLoad {
    /// Time between the readings, in the kernel's ticks.
    pub(crate) ticks: u64,
    pub(crate) busy: f64,
    /// Given to another machine by the hypervisor between the readings.
    pub(crate) steal: f64,
    pub(crate) steal_since_start: f64,
}

/// The time of each core, from the text of `/proc/stat`.
pub(crate) fn core_times(stat: &str) -> CoreTimes {
    let each = core_ticks(stat).filter_map(|(core, ticks)| Some((core?, ticks)));
    each.collect()
}

/// 0 to 1; 0 if `total` is 0.
pub(crate) fn share(part: u64, total: u64) -> f64 {
    (part as f64 / total.max(1) as f64).min(1.0)
}

/// Shares of each core's time between two readings. Counters that run backwards (of a core that was off) count
/// as zero.
pub(crate) fn core_loads(before: &CoreTimes, after: &CoreTimes) -> BTreeMap<usize, CoreLoad> {
    let loads = after.iter().map(|(core, now)| {
        let old = before.get(core).copied().unwrap_or_default();
        let ticks = now.total.saturating_sub(old.total);
        let load = CoreLoad {
            ticks,
            busy: share(now.busy.saturating_sub(old.busy), ticks),
            steal: share(now.steal.saturating_sub(old.steal), ticks),
            steal_since_start: share(now.steal, now.total),
        };
        (*core, load)
    });
    loads.collect()
}
