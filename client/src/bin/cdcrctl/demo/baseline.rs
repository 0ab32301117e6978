use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use anyhow::Context;
use cdcr_process::Process;
use cdcr_shared_types::BareSummary;
use serde::Serialize;

use super::daemon::{cdcrd, undisturbed};
use crate::interrupt::Interrupt;
use crate::spread::Spread;

/// Duration of the loop, as a command-line option.
const DURATION: &str = "1s";
/// Timeout of the process: it ends by itself, but a stalling machine needs longer.
const TIMEOUT: Duration = Duration::from_secs(10);

/// The baseline: latencies of `cdcrd bare` right before the demo's daemon starts.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Baseline {
    /// Time covered by its cycles \[s\].
    pub(super) duration_s: f64,
    pub(super) cycles: u64,
    pub(super) late_starts: u64,
    pub(super) late_starts_per_s: f64,
    pub(super) deadline_misses: u64,
    pub(super) deadline_misses_per_s: f64,
    pub(super) skipped_periods: u64,
    /// Late cycles by cause; causes without a cycle are omitted.
    pub(super) causes: BTreeMap<String, u64>,
    pub(super) wake_us: Spread,
}

impl Baseline {
    /// Runs the loop with this configuration. `None`: interrupted.
    pub(super) fn measure(config: &Path, interrupt: &Interrupt) -> anyhow::Result<Option<Self>> {
        let mut command = cdcrd("bare", config)?;
        command.args(["--duration", DURATION, "--format", "json"]);
        // It has no clients, so the place is irrelevant.
        for name in ["CDCR_ROBOT", "CDCR_PREFIX", "CDCR_ROOT"] {
            command.env_remove(name);
        }
        let undisturbed = || undisturbed(interrupt);
        let ended = Process::start("cdcrd bare", command)?.wait(TIMEOUT, undisturbed);
        if interrupt.is_raised() {
            return Ok(None);
        }
        let summary: BareSummary = serde_json::from_str(&ended?).context(
            "cannot read the result of cdcrd bare; use cdcrd and cdcrctl of the same version",
        )?;
        Ok(Some(summary.into()))
    }
}

impl From<BareSummary> for Baseline {
    fn from(bare: BareSummary) -> Self {
        let per_s = |count: u64| count as f64 / bare.duration_s.max(f64::MIN_POSITIVE);
        let us = |time_ns: u64| time_ns as f64 * 1e-3;
        Self {
            duration_s: bare.duration_s,
            cycles: bare.cycles,
            late_starts: bare.late_starts,
            late_starts_per_s: per_s(bare.late_starts),
            deadline_misses: bare.deadline_misses,
            deadline_misses_per_s: per_s(bare.deadline_misses),
            skipped_periods: bare.skipped_periods,
            wake_us: Spread {
                p50: us(bare.wake.p50_ns),
                p99: us(bare.wake.p99_ns),
                max: us(bare.wake.max_ns),
            },
            causes: bare.causes,
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use cdcr_shared_types::LatencySummary;

    use super::*;

    /// The output of `cdcrd bare`, for tests of arithmetic and texts.
    pub(in crate::demo) fn baseline(deadline_misses: u64, late_starts: u64) -> Baseline {
        BareSummary {
            duration_s: 0.5,
            cycles: 100,
            late_starts,
            deadline_misses,
            skipped_periods: 2,
            causes: [("platform".to_owned(), deadline_misses)].into(),
            wake: LatencySummary {
                p50_ns: 20_500,
                p99_ns: 90_000,
                max_ns: 1_234_500,
                ..LatencySummary::default()
            },
            ..BareSummary::default()
        }
        .into()
    }

    #[test]
    fn counts_are_per_second_and_times_in_microseconds() {
        let baseline = baseline(3, 4);
        assert_eq!((baseline.cycles, baseline.skipped_periods), (100, 2));
        assert!((baseline.deadline_misses_per_s - 6.0).abs() < 1e-12);
        assert!((baseline.late_starts_per_s - 8.0).abs() < 1e-12);
        assert!((baseline.wake_us.p50 - 20.5).abs() < 1e-12);
        assert!((baseline.wake_us.max - 1234.5).abs() < 1e-12);
        assert_eq!(baseline.causes["platform"], 3);
    }

    #[test]
    fn a_loop_without_a_cycle_has_no_rates_that_are_not_numbers() {
        let none = Baseline::from(BareSummary::default());
        assert_eq!(none.deadline_misses_per_s, 0.0);
    }
}
