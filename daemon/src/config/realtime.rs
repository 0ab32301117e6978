use serde::{Deserialize, Serialize};

use super::LinkKind;
use crate::rt::privileges::{ThreadPlan, last_core};

/// How much real time is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum RealtimeMode {
    /// [`Require`](Self::Require) for a robot behind a driver, [`Prefer`](Self::Prefer) for a simulated one. A validated
    /// configuration says which of them.
    #[default]
    Auto,
    /// Refuse to start without all of it.
    Require,
    /// Take what the system grants, and say what is missing.
    Prefer,
    /// Ordinary threads.
    Off,
}

impl RealtimeMode {
    /// The mode in force for a robot.
    pub(super) fn of(self, robot: LinkKind) -> Self {
        match (self, robot) {
            (Self::Auto, LinkKind::Driver) => Self::Require,
            (Self::Auto, LinkKind::Simulated) => Self::Prefer,
            (mode, _) => mode,
        }
    }
}

/// Threads, priorities, memory.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct RealtimeConfig {
    /// How much real time is asked for.
    pub mode: RealtimeMode,
    /// Core of the real-time threads; -1: the best one that the process may use, see
    /// [`with_core`](crate::doctor::with_core).
    pub core: i64,
    /// `SCHED_FIFO` priority of the cycle thread.
    pub cycle_priority: i32,
    /// `SCHED_FIFO` priority of the exchange thread, below that of the cycle.
    pub exchange_priority: i32,
    /// The cycle thread wakes up this long before each release and spins \[µs\]; 0: it sleeps to the release.
    pub spin_us: f64,
    /// Keep the processor out of deep sleep, by `/dev/cpu_dma_latency`, as far as the system grants it.
    pub no_deep_sleep: bool,
}

impl RealtimeConfig {
    /// The core of the real-time threads: the configured one, or else the last one that the process may use.
    pub fn core(&self) -> Option<usize> {
        usize::try_from(self.core).ok().or_else(last_core)
    }

    /// The plan of a real-time thread with `priority`; an ordinary thread where no real time is wanted.
    pub fn thread_plan(&self, priority: i32) -> ThreadPlan {
        if self.mode == RealtimeMode::Off {
            return ThreadPlan::default();
        }
        ThreadPlan::real_time(self.core(), priority)
    }

    /// The plan of a thread that works for the real-time threads, off their core.
    pub fn plan_beside(&self) -> ThreadPlan {
        if self.mode == RealtimeMode::Off {
            return ThreadPlan::default();
        }
        ThreadPlan::beside(self.core())
    }
}

impl Default for RealtimeConfig {
    fn default() -> Self {
        Self {
            mode: RealtimeMode::default(),
            core: -1,
            cycle_priority: 80,
            exchange_priority: 70,
            spin_us: 0.0,
            no_deep_sleep: true,
        }
    }
}
