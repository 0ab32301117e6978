use crate::core_budget::RecentCosts;

/// Core time of the exchange thread per period.
#[derive(Debug, Default)]
pub(super) struct OwnCosts {
    recent: RecentCosts,
    /// Core time of the thread up to the newest record \[ns\].
    on_core_ns: u64,
}

impl OwnCosts {
    /// Records the total core time of the thread when it has passed on a record.
    pub(super) fn note(&mut self, on_core_ns: u64) {
        let before_ns = core::mem::replace(&mut self.on_core_ns, on_core_ns);
        self.recent.note(on_core_ns.saturating_sub(before_ns));
    }

    /// The largest recent cost, except a few attributed to stalls \[ns\].
    pub(super) fn high_ns(&self) -> u64 {
        self.recent.high_on_core_ns()
    }
}
