//! What the configuration asks of the machine.

use std::path::PathBuf;

use super::finding::{Assessment, Severity};
use crate::config::{RealtimeMode, Validated};
use crate::core_budget::CoreBudget;

/// What the configuration asks of the machine.
#[derive(Debug, Clone)]
pub(crate) struct Plan {
    pub(crate) mode: RealtimeMode,
    /// Core of the real-time threads; none when the system does not tell which there are.
    pub(crate) core: Option<usize>,
    pub(crate) cycle_priority: i32,
    pub(crate) exchange_priority: i32,
    pub(crate) period_ms: f64,
    /// How the real-time threads share out the core, by what the kernel leaves to them by default.
    pub(crate) core_budget: CoreBudget,
    pub(crate) no_deep_sleep: bool,
    pub(crate) root: PathBuf,
    pub(crate) is_for_group: bool,
    /// File that the daemon of this robot locks.
    pub(crate) lock_file: PathBuf,
}

impl Plan {
    pub(crate) fn new(validated: &Validated) -> Self {
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

    /// The assessment of a privilege that is not granted: a fault where real time is required.
    pub(crate) fn missing(
        &self,
        value: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Assessment {
        let severity = match self.mode {
            RealtimeMode::Require => Severity::Fault,
            RealtimeMode::Prefer | RealtimeMode::Auto => Severity::Warning,
            RealtimeMode::Off => Severity::Ok,
        };
        Assessment::new(severity, value, remedy)
    }
}
