//! What the configuration asks of the machine.

use std::path::PathBuf;

use super::finding::{Judgement, Verdict};
use crate::config::{RealtimeMode, Validated};
use crate::core_budget::CoreBudget;

/// What the configuration asks of the machine.
#[derive(Debug, Clone)]
pub struct Plan {
    /// How much real time is asked for.
    pub mode: RealtimeMode,
    /// Core of the real-time threads; none when the system does not tell which there are.
    pub core: Option<usize>,
    /// `SCHED_FIFO` priority of the cycle thread.
    pub cycle_priority: i32,
    /// `SCHED_FIFO` priority of the exchange thread.
    pub exchange_priority: i32,
    /// Period \[ms\].
    pub period_ms: f64,
    /// How the real-time threads share out the core, by what the kernel leaves to them by default.
    pub core_budget: CoreBudget,
    /// Whether deep sleep is to be kept away.
    pub no_deep_sleep: bool,
    /// Root folder of the shared-memory services.
    pub root: PathBuf,
    /// Whether the root folder is for a group, too.
    pub is_for_group: bool,
    /// File that the daemon of this robot locks.
    pub lock_file: PathBuf,
}

impl Plan {
    /// The plan of a configuration.
    pub fn new(validated: &Validated) -> Self {
        let Validated {
            config,
            location,
            group_id,
            ..
        } = validated;
        let (cycle, realtime) = (&config.cycle, &config.realtime);
        Self {
            mode: realtime.mode,
            core: realtime.core(),
            cycle_priority: realtime.cycle_priority,
            exchange_priority: realtime.exchange_priority,
            period_ms: cycle.period_ms,
            core_budget: CoreBudget::new(config),
            no_deep_sleep: realtime.no_deep_sleep,
            root: location.root().to_owned(),
            is_for_group: group_id.is_some(),
            lock_file: location.lock_file(&config.robot.name),
        }
    }

    /// The judgement of a privilege that is not granted: a fault where real time is required.
    pub fn missing(&self, value: impl Into<String>, remedy: impl Into<String>) -> Judgement {
        let verdict = match self.mode {
            RealtimeMode::Require => Verdict::Fault,
            RealtimeMode::Prefer | RealtimeMode::Auto => Verdict::Warning,
            RealtimeMode::Off => Verdict::Ok,
        };
        Judgement::new(verdict, value, remedy)
    }
}
