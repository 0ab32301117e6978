use std::collections::BTreeMap;

use anyhow::Result;
use cdcr_shared_types::LatencySummary;
use cdcr_shared_types::codes::realtime;
use cdcr_shared_types::message::{Struct as _, Value};
use serde::{Serialize, Serializer};

use super::{BareCycle, CauseAssignment, Recorder};
use crate::config::{Config, ns};
use crate::handover::Policy;
use crate::rt::latency;

/// Digits of a percentile.
const DIGITS: u8 = 3;

/// Summary of a bare loop.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BareSummary {
    /// Period \[ns\].
    pub period_ns: u64,
    /// Deadline after the release \[ns\].
    pub deadline_ns: u64,
    /// A start later than this after the release is a late start \[ns\].
    pub late_start_ns: u64,
    /// Time before each release at which the thread wakes up and spins \[ns\].
    pub spin_ns: u64,
    /// Time on the grid covered by the cycles \[s\].
    pub duration_s: f64,
    pub cycles: u64,
    pub late_starts: u64,
    pub deadline_misses: u64,
    /// Releases without a cycle.
    pub skipped_periods: u64,
    /// Number of late cycles by cause. A cycle that only follows an overrun has no cause of its own.
    pub causes: BTreeMap<&'static str, u64>,
    /// Wake-up latency.
    pub wake: Percentiles,
    /// Time ready to run while another task had the core, per cycle. `None` if the kernel does not report it.
    pub run_delay: Option<Percentiles>,
    /// Page faults, minor and major. `None` if the kernel does not report them.
    pub page_faults: Option<u64>,
    /// All real-time properties were granted: `SCHED_FIFO`, a core, locked memory.
    pub realtime: bool,
    /// The missing properties.
    pub realtime_missing: Vec<&'static str>,
    /// Core of the thread, if it is pinned.
    pub core: Option<usize>,
}

/// Percentiles of a latency, by the names of the message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Percentiles(pub LatencySummary);

impl BareSummary {
    /// The summary of a completed loop; `missing` and `core` describe the granted properties.
    pub(super) fn new(
        config: &Config,
        recorder: &Recorder,
        missing: u32,
        core: Option<usize>,
    ) -> Result<Self> {
        let (totals, limits) = (recorder.totals(), Policy::new(config).limits());
        let cycles = &recorder.cycles;
        let period_ns = ns(config.cycle.period_ms);
        let periods = cycles.last().map_or(0, |cycle| cycle.release.cycle);
        let reported = || cycles.iter().filter_map(|cycle| cycle.interference);
        let is_reported = reported().next().is_some();
        let run_delay =
            Percentiles::from_latencies(reported().map(|reported| reported.run_delay_ns))?;
        let page_faults = reported()
            .map(|reported| u64::from(reported.page_faults))
            .sum();
        Ok(Self {
            period_ns,
            deadline_ns: limits.deadline_ns,
            late_start_ns: limits.late_start_ns,
            spin_ns: config.realtime.spin_ns(config.cycle.period_ms),
            duration_s: (periods * period_ns) as f64 * 1e-9,
            cycles: totals.cycles,
            late_starts: totals.late_starts,
            deadline_misses: totals.deadline_misses,
            skipped_periods: totals.skipped_periods,
            causes: causes(cycles),
            wake: Percentiles::from_latencies(cycles.iter().map(BareCycle::wake_ns))?,
            run_delay: is_reported.then_some(run_delay),
            page_faults: is_reported.then_some(page_faults),
            realtime: missing == 0,
            realtime_missing: names(missing),
            core,
        })
    }
}

impl BareCycle {
    /// Wake-up latency \[ns\].
    pub fn wake_ns(&self) -> u64 {
        self.release.start_ns - self.release.due_ns
    }
}

fn causes(cycles: &[BareCycle]) -> BTreeMap<&'static str, u64> {
    let mut causes = BTreeMap::new();
    for cycle in cycles {
        if let CauseAssignment::Own(cause) = cycle.assignment {
            *causes.entry(cause.text()).or_default() += 1;
        }
    }
    causes
}

fn names(missing: u32) -> Vec<&'static str> {
    realtime::set(missing).map(|(name, _)| name).collect()
}

impl Percentiles {
    fn from_latencies(latencies_ns: impl Iterator<Item = u64>) -> Result<Self> {
        let mut histogram = latency::histogram(DIGITS)?;
        latencies_ns.for_each(|latency_ns| histogram.saturating_record(latency_ns));
        Ok(Self(latency::summary(&histogram)))
    }
}

impl Serialize for Percentiles {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut fields = Vec::new();
        self.0.visit(&mut |field, value| {
            if let Value::U64(number) = value {
                fields.push((field.name, number));
            }
        });
        serializer.collect_map(fields)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bare::Interference;
    use crate::rt::schedule::Lateness;
    use crate::rt::schedule::Release;
    use cdcr_shared_types::codes::LateCause;

    fn cycle(
        number: u64,
        wake_ns: u64,
        assignment: CauseAssignment,
        run_delay_ns: Option<u64>,
    ) -> BareCycle {
        let due_ns = number * 5_000_000;
        BareCycle {
            release: Release {
                cycle: number,
                release_ns: due_ns,
                due_ns,
                start_ns: due_ns + wake_ns,
                skipped: 0,
            },
            handed_over_ns: due_ns + wake_ns + 50,
            lateness: Lateness::default(),
            assignment,
            interference: run_delay_ns.map(|run_delay_ns| Interference {
                run_delay_ns,
                page_faults: 1,
            }),
        }
    }

    fn summary(cycles: Vec<BareCycle>, missing: u32) -> BareSummary {
        let config = Config::default();
        let mut recorder = Recorder::new(&config, 1).unwrap();
        recorder.cycles = cycles;
        BareSummary::new(&config, &recorder, missing, None).unwrap()
    }

    #[test]
    fn causes_are_counted_once_for_an_event() {
        let load = LateCause::Load;
        let cycles = vec![
            cycle(1, 10, CauseAssignment::InTime, Some(0)),
            cycle(2, 9_000_000, CauseAssignment::Own(load), Some(8_000_000)),
            cycle(4, 10, CauseAssignment::Before(load), Some(0)),
            cycle(5, 10, CauseAssignment::Own(LateCause::Platform), Some(0)),
        ];
        let summary = summary(cycles, 0);
        let causes = [("another task had the core", 1), ("platform", 1)];
        assert_eq!(summary.causes, BTreeMap::from(causes));
        assert_eq!(summary.page_faults, Some(4));
        assert!((summary.duration_s - 0.025).abs() < 1e-12);
        let close = |is: u64, was: u64| is.abs_diff(was) * 500 <= was;
        assert!(
            close(summary.wake.0.max_ns, 9_000_000),
            "{:?}",
            summary.wake
        );
        assert_eq!(summary.wake.0.p50_ns, 10);
        assert!(close(summary.run_delay.unwrap().0.max_ns, 8_000_000));
        assert!(summary.realtime && summary.realtime_missing.is_empty());
    }

    #[test]
    fn what_was_not_measured_is_not_zero() {
        let summary = summary(
            vec![cycle(1, 10, CauseAssignment::InTime, None)],
            realtime::FIFO | realtime::LOCKED,
        );
        assert_eq!((summary.run_delay, summary.page_faults), (None, None));
        assert!(!summary.realtime);
        assert_eq!(summary.realtime_missing, ["SCHED_FIFO", "locked memory"]);
    }
}
