//! What one stretch of cycles comes to: counts, causes and latencies.

use anyhow::Result;
use cdcr_shared_types::codes::LateCause;
use derive_more::AddAssign;
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
pub(super) const COMPUTE: usize = 1;
/// To the hand-over of the command.
pub(super) const RESPONSE: usize = 2;
/// To the command in the client's hands.
pub(super) const COMMAND: usize = 3;
pub(super) const TIME_NAMES: [&str; 4] = ["wake", "compute", "response", "command"];

/// Of each time five numbers \[µs\]; none of those that were not measured.
pub(super) type TimeQuantiles = [Option<Quantiles>; 4];

/// Under their names, with the unit.
pub(super) fn times_json(times: TimeQuantiles) -> Value {
    let named = TIME_NAMES.iter().zip(times);
    named
        .map(|(name, quantiles)| (format!("{name}_us"), json!(quantiles)))
        .collect()
}

#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, AddAssign)]
pub struct Counts {
    pub cycles: u64,
    pub late_starts: u64,
    pub deadline_misses: u64,
    /// Of these, those that are ours: the computation took too long, or a page was missing.
    pub own_misses: u64,
    pub skipped_periods: u64,
    pub causes: Causes,
    /// Records that never reached the observer.
    pub lost_records: u64,
    /// Commands that never reached the observer, or came after it had stopped looking.
    pub lost_commands: u64,
    /// Time that the hypervisor kept the core from the machine \[ms\], in steps of 10 ms.
    pub steal_ms: f64,
    /// Time that the thread was ready and another had the core \[ms\].
    pub run_delay_ms: f64,
}

#[derive(Debug, Clone)]
pub struct Tally {
    pub counts: Counts,
    /// All latencies \[ns\]; empty for what has no such time.
    pub times: [Histogram<u64>; 4],
}

impl Tally {
    pub fn new() -> Result<Self> {
        Ok(Self {
            counts: Counts::default(),
            times: [histogram()?, histogram()?, histogram()?, histogram()?],
        })
    }

    /// Of cycles; `computes` says whether what they handed over was computed.
    pub fn of(cycles: &[Cycle], computes: bool) -> Result<Self> {
        let mut tally = Self::new()?;
        let mut after_miss = false;
        for cycle in cycles {
            tally.count(cycle, computes, after_miss);
            after_miss = cycle.deadline_miss;
        }
        Ok(tally)
    }

    /// Of what cyclictest tells: a wake-up later than the deadline is a miss, later than the limit a late start.
    pub fn of_cyclictest(latencies: &Latencies, deadline_ns: u64, late_ns: u64) -> Result<Self> {
        let mut tally = Self::new()?;
        tally.times[WAKE].add(&latencies.histogram_ns)?;
        tally.counts.cycles = latencies.cycles;
        tally.counts.skipped_periods = latencies.skipped_periods;
        tally.counts.late_starts = latencies.later_than(late_ns);
        tally.counts.deadline_misses = latencies.later_than(deadline_ns);
        Ok(tally)
    }

    /// Counts one. A punctual cycle whose releases the one before took has nothing to answer for.
    fn count(&mut self, cycle: &Cycle, computes: bool, after_miss: bool) {
        let counts = &mut self.counts;
        counts.cycles += 1;
        counts.late_starts += u64::from(cycle.late_start);
        counts.deadline_misses += u64::from(cycle.deadline_miss);
        let is_ours = matches!(cycle.cause, LateCause::Compute | LateCause::PageFault);
        counts.own_misses += u64::from(cycle.deadline_miss && is_ours);
        counts.skipped_periods += u64::from(cycle.skipped_periods);
        let is_late = cycle.late_start || cycle.deadline_miss;
        if is_late || (cycle.skipped_periods > 0 && !after_miss) {
            counts.causes.count(cycle.cause);
        }
        counts.run_delay_ms += cycle.run_delay_ns as f64 * 1e-6;
        let times = &mut self.times;
        times[WAKE].saturating_record(cycle.wake_ns);
        if computes {
            let compute_ns = cycle.response_ns.saturating_sub(cycle.wake_ns);
            times[COMPUTE].saturating_record(compute_ns);
            times[RESPONSE].saturating_record(cycle.response_ns);
        }
    }

    pub fn add(&mut self, other: &Self) -> Result<()> {
        self.counts += other.counts;
        for (mine, theirs) in self.times.iter_mut().zip(&other.times) {
            mine.add(theirs)?;
        }
        Ok(())
    }

    pub fn quantiles(&self) -> TimeQuantiles {
        self.times.each_ref().map(Quantiles::of)
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

    #[test]
    fn every_late_cycle_has_one_cause_and_only_our_misses_are_ours() {
        let cycles = [
            cycle(20, 50, LateCause::None),
            cycle(6000, 6030, LateCause::Platform),
            cycle(20, 5100, LateCause::Compute),
            cycle(20, 5200, LateCause::PageFault),
            cycle(2000, 2040, LateCause::Load),
            cycle(30, 9000, LateCause::Stall),
            // Punctual again; the cycle before took its releases.
            Cycle {
                skipped_periods: 1,
                ..cycle(20, 50, LateCause::Stall)
            },
        ];
        let mut tally = Tally::of(&cycles, true).unwrap();
        let counts = tally.counts;
        assert_eq!(
            (counts.cycles, counts.late_starts, counts.deadline_misses),
            (7, 2, 4)
        );
        assert_eq!((counts.own_misses, counts.skipped_periods), (2, 5));
        let expected = Causes {
            platform: 1,
            load: 1,
            compute: 1,
            fault: 1,
            other: 1,
        };
        assert_eq!(counts.causes, expected);
        assert!((counts.run_delay_ms - 3.5).abs() < 1e-9);
        assert_eq!(tally.times[RESPONSE].len(), 7);
        let twice = tally.clone();
        tally.add(&twice).unwrap();
        assert_eq!(tally.counts.causes.load, 2);
        assert_eq!(tally.times[WAKE].len(), 14);
    }
}
