use super::ns;

table! {
    /// The period and what counts as late.
    pub struct CycleConfig {
        /// Period of the loop, {range}, and at least twice gather_lead_ms.
        period_ms: f64 = 5.0, in 0.1..=100.0, "at least twice cycle.gather_lead_ms";
        /// Deadline after the release, {range}, and at most the period; 0: the period.
        deadline_ms: f64 = 0.0, in 0.0..=100.0, "at most cycle.period_ms";
        /// A start later than this after its release counts as a late start, {range}.
        late_start_ms: f64 = 1.0, in 0.001..=100.0;
        /// Longest time of one solve, {range}, and at most the period; 0: all that is left until the deadline, less
        /// the margin. It is cut where the other parts of the period would not fit (docs/realtime.md).
        budget_ms: f64 = 0.0, in 0.0..=100.0, "at most cycle.period_ms";
        /// Time that the solver leaves at least for what follows it, {range}, and at most half the period; 0: a tenth of the
        /// period, at least 0.04 ms. What guard and exchange are measured to take beyond that is left, too.
        budget_margin_ms: f64 = 0.0, in 0.0..=50.0, "at most half of cycle.period_ms";
        /// How long before the cycle thread wakes up (realtime.spin_us before its release) the inputs are gathered, {range}, and at
        /// most half the period.
        gather_lead_ms: f64 = 0.2, in 0.02..=50.0, "at most half of cycle.period_ms";
        /// Leaky bucket: +1 for each deadline miss, each skipped period and each cycle on stale inputs, -1/9 for each good
        /// cycle, so that more than one bad release in ten fills it. At this level the robot is stopped, {range}; 0: 40, which are 200 ms without control at 5 ms, and a simulated robot is not
        /// stopped: the daemon logs a warning and goes on.
        miss_limit: u32 = 0, in 0.0..=1e6;
        /// Watchdog: the process ends when the cycle or exchange thread makes no progress for this long, the reporter
        /// for five times as long, or the thread of the status for twenty times; {range}, and at least 10 periods. The robot then holds when its last command runs out (link.command_valid_ms).
        watchdog_ms: f64 = 1000.0, in 50.0..=60_000.0, "at least ten times cycle.period_ms";
    }
}

impl CycleConfig {
    /// Level at which the leaky bucket is full when the configuration sets no `miss_limit`: 200 ms without control at
    /// 5 ms.
    pub const MISS_LIMIT: u32 = 40;
    /// What one gather and one publication take at least, with a little more for slower machines \[ns\].
    pub const EXCHANGE_NS: u64 = 40_000;

    /// Deadline D after the release \[ns\].
    pub fn deadline_ns(&self) -> u64 {
        match ns(self.deadline_ms) {
            0 => ns(self.period_ms),
            deadline_ns => deadline_ns,
        }
    }

    /// Time that the solver leaves at least for what follows it \[ns\], by default a tenth of the period. And at least
    /// what the exchange needs on the same core, without which the reference does not arrive. What was measured to
    /// take longer is left by the [`CoreBudget`](crate::core_budget::CoreBudget).
    pub fn budget_margin_ns(&self) -> u64 {
        match ns(self.budget_margin_ms) {
            0 => (ns(self.period_ms) / 10).max(Self::EXCHANGE_NS),
            margin_ns => margin_ns,
        }
    }
}
