//! What the configuration asks of the machine.

use std::path::PathBuf;

use super::finding::{Judgement, Verdict};
use crate::config::{RealtimeMode, Validated, ns};
use crate::rt::privileges::choose_core;

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
    /// Largest share of the core that the cycle thread may use, 0 to 1.
    pub core_share_max: f64,
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
        let solve_ns = match ns(cycle.budget_ms) {
            0 => cycle.deadline_ns().saturating_sub(cycle.budget_margin_ns()),
            budget_ns => budget_ns,
        };
        let busy_ms = solve_ns as f64 * 1e-6 + realtime.spin_us * 1e-3;
        Self {
            mode: realtime.mode,
            core: choose_core(realtime),
            cycle_priority: realtime.cycle_priority,
            exchange_priority: realtime.exchange_priority,
            period_ms: cycle.period_ms,
            core_share_max: (busy_ms / cycle.period_ms).min(1.0),
            no_deep_sleep: realtime.no_deep_sleep,
            root: location.root().to_owned(),
            is_for_group: group_id.is_some(),
            lock_file: location.lock_file(&config.robot.name),
        }
    }

    /// The judgement of a privilege that is not granted: a fault where real time is required.
    pub fn missing(&self, value: impl Into<String>, mend: impl Into<String>) -> Judgement {
        let verdict = match self.mode {
            RealtimeMode::Require => Verdict::Fault,
            RealtimeMode::Prefer => Verdict::Warning,
            RealtimeMode::Off => Verdict::Ok,
        };
        Judgement::new(verdict, value, mend)
    }
}

#[cfg(test)]
mod tests {
    #![allow(
        clippy::unwrap_used,
        reason = "in a test a panic is the report, in its helpers, too"
    )]

    use super::*;
    use crate::config::Config;

    #[test]
    fn the_largest_share_of_the_core_follows_from_the_budget() {
        let mut config = Config::default();
        let share = |config: &Config| Plan::new(&config.clone().check().unwrap()).core_share_max;
        assert!((share(&config) - 0.9).abs() < 1e-9);
        config.cycle.budget_ms = 2.0;
        assert!((share(&config) - 0.4).abs() < 1e-9);
        config.realtime.spin_us = 500.0;
        assert!((share(&config) - 0.5).abs() < 1e-9);
        config.cycle.budget_ms = 5.0;
        assert_eq!(share(&config), 1.0);
    }
}
