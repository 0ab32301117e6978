//! What one stretch of cycles comes to: counts, causes and latencies.

use anyhow::Result;
use cdcr_shared_types::codes::LateCause;
use hdrhistogram::Histogram;
use serde::Serialize;
use serde_json::{Value, json};

use crate::causes::Causes;
use crate::quantiles::{Quantiles, histogram};
use crate::subject::Cycle;
use crate::subject::cyclictest::Latencies;

// The times of a cycle, all from the release that was due but for compute.
pub(super) const WAKE: usize = 0;
/// Start to hand-over of the command.
const COMPUTE: usize = 1;
/// To the hand-over of the command.
const RESPONSE: usize = 2;
/// To the command in the client's hands.
pub(super) const COMMAND: usize = 3;
pub(super) const TIME_NAMES: [&str; 4] = ["wake", "compute", "response", "command"];

/// All latencies \[ns\]; empty for what has no such time.
pub(super) type Times = [Histogram<u64>; 4];

/// Of each time five numbers \[µs\], under its name with the unit; null for those that were not measured.
pub(super) fn times_json(times: &Times) -> Value {
    let named = TIME_NAMES.iter().zip(times);
    let quantiles = named.map(|(name, times)| (format!("{name}_us"), json!(Quantiles::of(times))));
    quantiles.collect()
}

/// What was counted; none of what a subject does not tell: cyclictest tells neither why it was late nor how long it
/// waited for its core, and only a daemon has clients.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub(super) struct Counts {
    pub(super) cycles: u64,
    pub(super) late_starts: u64,
    pub(super) deadline_misses: u64,
    /// Of these, those that are ours: the computation took too long, or a page was missing.
    pub(super) own_misses: Option<u64>,
    pub(super) skipped_periods: u64,
    pub(super) causes: Option<Causes>,
    /// Records that never reached the observer.
    pub(super) lost_records: Option<u64>,
    /// Commands that never reached the observer, or came after it had stopped looking.
    pub(super) lost_commands: Option<u64>,
    pub(super) budget_hits: Option<u64>,
    /// Share of the cycles in which the robot followed its reference.
    pub(super) tracking_share: Option<f64>,
    /// Time that the hypervisor kept the core from the machine \[ms\], in steps of 10 ms.
    pub(super) steal_ms: f64,
    /// Time that the thread was ready and another had the core \[ms\].
    pub(super) run_delay_ms: Option<f64>,
}

#[derive(Debug, Clone)]
pub(super) struct Tally {
    pub(super) counts: Counts,
    pub(super) times: Times,
}

impl Tally {
    pub(super) fn new() -> Result<Self> {
        Ok(Self {
            counts: Counts::default(),
            times: [histogram()?, histogram()?, histogram()?, histogram()?],
        })
    }

    /// Of cycles; `computes` says whether what they handed over was computed.
    pub(super) fn of(cycles: &[Cycle], computes: bool) -> Result<Self> {
        let mut tally = Self::new()?;
        let (counts, times) = (&mut tally.counts, &mut tally.times);
        let (mut causes, mut own_misses, mut run_delay_ns) = (Causes::default(), 0, 0);
        let mut after_miss = false;
        for cycle in cycles {
            counts.cycles += 1;
            counts.late_starts += u64::from(cycle.late_start);
            counts.deadline_misses += u64::from(cycle.deadline_miss);
            let is_ours = matches!(cycle.cause, LateCause::Compute | LateCause::PageFault);
            own_misses += u64::from(cycle.deadline_miss && is_ours);
            counts.skipped_periods += u64::from(cycle.skipped_periods);
            let is_late = cycle.late_start || cycle.deadline_miss;
            // A punctual cycle whose releases the one before took has nothing to answer for.
            if is_late || (cycle.skipped_periods > 0 && !after_miss) {
                causes.count(cycle.cause);
            }
            after_miss = cycle.deadline_miss;
            run_delay_ns += cycle.run_delay_ns;
            times[WAKE].saturating_record(cycle.wake_ns);
            if computes {
                let compute_ns = cycle.response_ns.saturating_sub(cycle.wake_ns);
                times[COMPUTE].saturating_record(compute_ns);
                times[RESPONSE].saturating_record(cycle.response_ns);
            }
        }
        counts.own_misses = Some(own_misses);
        counts.causes = Some(causes);
        counts.run_delay_ms = Some(run_delay_ns as f64 * 1e-6);
        Ok(tally)
    }

    /// Of what cyclictest tells: a wake-up later than the deadline is a miss, later than the limit a late start.
    pub(super) fn of_cyclictest(
        latencies: &Latencies,
        deadline_ns: u64,
        late_ns: u64,
    ) -> Result<Self> {
        let mut tally = Self::new()?;
        tally.times[WAKE].add(&latencies.histogram_ns)?;
        tally.counts.cycles = latencies.cycles;
        tally.counts.skipped_periods = latencies.skipped_periods;
        tally.counts.late_starts = latencies.later_than(late_ns);
        tally.counts.deadline_misses = latencies.later_than(deadline_ns);
        Ok(tally)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cycle(wake_us: u64, response_us: u64, cause: LateCause) -> Cycle {
        Cycle {
            due_ns: 0,
            wake_ns: wake_us * 1000,
            response_ns: response_us * 1000,
            late_start: wake_us > 1000,
            deadline_miss: response_us > 5000,
            skipped_periods: u32::from(response_us > 5000),
            cause,
            run_delay_ns: 500_000,
        }
    }

    fn each_cause_once() -> Causes {
        let mut causes = Causes::default();
        for cause in LateCause::ALL {
            if *cause != LateCause::None {
                causes.count(*cause);
            }
        }
        causes
    }

    #[test]
    fn every_late_cycle_has_one_cause_and_only_our_misses_are_ours() {
        let mut cycles = [
            cycle(20, 50, LateCause::None),
            cycle(6000, 6030, LateCause::Platform),
            cycle(20, 5100, LateCause::Compute),
            cycle(20, 5200, LateCause::PageFault),
            cycle(2000, 2040, LateCause::Load),
            cycle(30, 9000, LateCause::Stall),
            // Punctual again; the cycle before took its releases.
            cycle(20, 50, LateCause::Stall),
        ];
        cycles[6].skipped_periods = 1;
        let tally = Tally::of(&cycles, true).unwrap();
        let expected = Counts {
            cycles: 7,
            late_starts: 2,
            deadline_misses: 4,
            own_misses: Some(2),
            skipped_periods: 5,
            causes: Some(each_cause_once()),
            run_delay_ms: Some(3.5),
            ..Counts::default()
        };
        assert_eq!(tally.counts, expected);
        assert_eq!(tally.times.map(|times| times.len()), [7, 7, 7, 0]);
    }
}
