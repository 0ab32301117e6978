use std::collections::BTreeMap;

use anyhow::Result;
use cdcr_shared_types::codes::realtime;
use cdcr_shared_types::{BareSummary, LatencySummary};

use super::{BareCycle, CauseAssignment, Recorder};
use crate::config::{Config, ns};
use crate::handover::Policy;
use crate::rt::latency;

/// Digits of a percentile.
const DIGITS: u8 = 3;

/// The summary of a completed loop; `missing` and `core` describe the granted properties.
pub(super) fn summary(
    config: &Config,
    recorder: &Recorder,
    missing: u32,
    core: Option<usize>,
) -> Result<BareSummary> {
    let (totals, limits) = (recorder.totals(), Policy::new(config).limits());
    let cycles = &recorder.cycles;
    let period_ns = ns(config.cycle.period_ms);
    let periods = cycles.last().map_or(0, |cycle| cycle.release.cycle);
    let reported = || cycles.iter().filter_map(|cycle| cycle.interference);
    let is_reported = reported().next().is_some();
    let run_delay = percentiles(reported().map(|reported| reported.run_delay_ns))?;
    let page_faults = reported()
        .map(|reported| u64::from(reported.page_faults))
        .sum();
    Ok(BareSummary {
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
        wake: percentiles(cycles.iter().map(BareCycle::wake_ns))?,
        run_delay: is_reported.then_some(run_delay),
        page_faults: is_reported.then_some(page_faults),
        realtime: missing == 0,
        realtime_missing: names(missing),
        core,
    })
}

impl BareCycle {
    /// Wake-up latency \[ns\].
    pub fn wake_ns(&self) -> u64 {
        self.release.start_ns - self.release.due_ns
    }
}

fn causes(cycles: &[BareCycle]) -> BTreeMap<String, u64> {
    let mut causes = BTreeMap::new();
    for cycle in cycles {
        if let CauseAssignment::Own(cause) = cycle.assignment {
            *causes.entry(cause.text().to_owned()).or_default() += 1;
        }
    }
    causes
}

fn names(missing: u32) -> Vec<String> {
    realtime::set(missing)
        .map(|(name, _)| name.to_owned())
        .collect()
}

fn percentiles(latencies_ns: impl Iterator<Item = u64>) -> Result<LatencySummary> {
    let mut histogram = latency::histogram(DIGITS)?;
    latencies_ns.for_each(|latency_ns| histogram.saturating_record(latency_ns));
    Ok(LatencySummary::from(&histogram))
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

    fn summary_of(cycles: Vec<BareCycle>, missing: u32) -> BareSummary {
        let config = Config::default();
        let mut recorder = Recorder::new(&config, 1).unwrap();
        recorder.cycles = cycles;
        summary(&config, &recorder, missing, None).unwrap()
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
        let summary = summary_of(cycles, 0);
        let causes = [("another task had the core", 1), ("platform", 1)];
        let causes = causes.map(|(cause, count)| (cause.to_owned(), count));
        assert_eq!(summary.causes, BTreeMap::from(causes));
        assert_eq!(summary.page_faults, Some(4));
        assert!((summary.duration_s - 0.025).abs() < 1e-12);
        let close = |is: u64, was: u64| is.abs_diff(was) * 500 <= was;
        assert!(close(summary.wake.max_ns, 9_000_000), "{:?}", summary.wake);
        assert_eq!(summary.wake.p50_ns, 10);
        assert!(close(summary.run_delay.unwrap().max_ns, 8_000_000));
        assert!(summary.realtime && summary.realtime_missing.is_empty());
    }

    #[test]
    fn what_was_not_measured_is_not_zero() {
        let summary = summary_of(
            vec![cycle(1, 10, CauseAssignment::InTime, None)],
            realtime::FIFO | realtime::LOCKED,
        );
        assert_eq!((summary.run_delay, summary.page_faults), (None, None));
        assert!(!summary.realtime);
        assert_eq!(summary.realtime_missing, ["SCHED_FIFO", "locked memory"]);
    }
}
