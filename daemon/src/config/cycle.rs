use serde::{Deserialize, Serialize};

use super::ns;

/// The period and what counts as late.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct CycleConfig {
    /// Period T \[ms\].
    pub period_ms: f64,
    /// Deadline D after the release \[ms\]; 0: the period.
    pub deadline_ms: f64,
    /// A start later than this after the release counts as a late start \[ms\].
    pub late_start_ms: f64,
    /// Longest time of one solve \[ms\]; 0: all that is left until the deadline, less the margin.
    pub budget_ms: f64,
    /// Time that the solver leaves for what follows it \[ms\]; 0: a tenth of the period, at least 0.04 ms.
    pub budget_margin_ms: f64,
    /// How long before the release inputs are gathered \[ms\].
    pub gather_lead_ms: f64,
    /// Level of the leaky bucket (+1 for each miss and each skipped period, -1 for each good cycle)
    /// at which the robot is stopped; 0: [`Self::MISS_LIMIT`], at which a simulated robot is not stopped: the daemon
    /// logs a warning and goes on.
    pub miss_limit: u32,
    /// The process ends when the cycle or exchange thread makes no progress for this long \[ms\], or the reporter for
    /// five times as long.
    pub watchdog_ms: f64,
}

impl Default for CycleConfig {
    fn default() -> Self {
        Self {
            period_ms: 5.0,
            deadline_ms: 0.0,
            late_start_ms: 1.0,
            budget_ms: 0.0,
            budget_margin_ms: 0.0,
            gather_lead_ms: 0.2,
            miss_limit: 0,
            watchdog_ms: 1000.0,
        }
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
