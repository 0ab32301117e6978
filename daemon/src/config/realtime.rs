use serde::{Deserialize, Serialize};

use super::ns;

/// How much real time is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum RealtimeMode {
    /// [`Require`](Self::Require) for a robot behind a driver, [`Prefer`](Self::Prefer) for a simulated one. A validated
    /// configuration says which of them.
    Auto,
    /// Refuse to start without all of it.
    Require,
    /// Take what the system grants, and report what is missing.
    Prefer,
    /// Ordinary threads.
    Off,
}

table! {
    /// Threads, priorities, memory.
    pub struct RealtimeConfig {
        /// "require": do not start without SCHED_FIFO, a pinned core and locked memory. "prefer": use what the system
        /// grants and report what is missing. "off": ordinary threads. "auto": "require" with link.kind = "driver", "prefer" with
        /// "simulated".
        mode: RealtimeMode = RealtimeMode::Auto;
        /// Core of the real-time threads, {range}; -1: the last core not used by another loop, preferably an isolated one, not an
        /// efficiency core, with an idle hyper-thread sibling.
        core: i32 = -1, in -1.0..=1023.0;
        /// SCHED_FIFO priority of the cycle thread, {range}, above that of the exchange.
        cycle_priority: i32 = 80, in 2.0..=99.0, "above realtime.exchange_priority";
        /// SCHED_FIFO priority of the exchange thread, {range}, below that of the cycle.
        exchange_priority: i32 = 70, in 1.0..=98.0, "below realtime.cycle_priority";
        /// Wake up this long before each release, rehearse the cycle to load code and data into the processor's caches, and
        /// spin until the release; {range}, and at most half the period; 0: no rehearsal; -1: 1.5 % of the period, at most 75 µs.
        /// Gives a punctual start and halves the response time for this share of the core.
        spin_us: f64 = -1.0, in -1.0..=1000.0, "at most half of cycle.period_ms";
        /// Keep the processor out of deep sleep states (with /dev/cpu_dma_latency, where permitted): faster wake-up, more
        /// power.
        no_deep_sleep: bool = true;
    }
}

impl RealtimeConfig {
    /// Time before each release at which the cycle thread wakes up, for a period of `period_ms` \[ns\].
    pub fn spin_ns(&self, period_ms: f64) -> u64 {
        ns(1e-3
            * match self.spin_us {
                automatic if automatic < 0.0 => (15.0 * period_ms).min(75.0),
                spin_us => spin_us,
            })
    }
}
