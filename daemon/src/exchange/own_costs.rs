use crate::core_budget::RecentCosts;

/// What the exchange thread takes of the core in a period.
#[derive(Debug, Default)]
pub(super) struct OwnCosts {
    recent: RecentCosts,
    /// Its time on the core until the newest record \[ns\].
    on_core_ns: u64,
}

impl OwnCosts {
    /// It has had the core for `on_core_ns` so far, and has handed a record on.
    pub(super) fn note(&mut self, on_core_ns: u64) {
        let before_ns = core::mem::replace(&mut self.on_core_ns, on_core_ns);
        self.recent.note(on_core_ns.saturating_sub(before_ns));
    }

    /// The largest of late, but for what stalls made of a few \[ns\].
    pub(super) fn high_ns(&self) -> u64 {
        self.recent.high_on_core_ns()
    }
}
