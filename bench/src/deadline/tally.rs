//! Result of one stretch of cycles: counts, causes and latencies.

use anyhow::Result;
use hdrhistogram::Histogram;
use serde_json::{Value, json};

use crate::causes::{Causes, OWN};
use crate::quantiles::{histogram, quantiles};
use crate::subject::Cycle;
use crate::subject::cyclictest::Latencies;

// Indices of the times of a cycle. All begin at the due release except compute, which lasts from start to
// hand-over. Response ends with the hand-over, command with its receipt by the client.
pub(super) const WAKE: usize = 0;
const COMPUTE: usize = 1;
const RESPONSE: usize = 2;
pub(super) const COMMAND: usize = 3;
pub(super) const TIME_NAMES: [&str; 4] = ["wake", "compute", "response", "command"];

pub(super) type Times = [Histogram<u64>; 4];

fn empty_times() -> Times {
    [(); 4].map(|()| histogram())
}

/// Five quantiles \[µs\] of each time, under its name with the unit; null if not measured.
pub(super) fn times_json(times: &Times) -> Value {
    let named = TIME_NAMES.iter().zip(times);
    let named = named.map(|(name, times)| (format!("{name}_us"), quantiles(times)));
    named.collect()
}

pub(super) struct Tally {
    pub(super) counts: Value,
    pub(super) times: Times,
}

impl Tally {
    pub(super) fn from_cycles(cycles: &[Cycle], computes: bool) -> Self {
        let (mut times, mut causes) = (empty_times(), Causes::default());
        let mut after_miss = false;
        for cycle in cycles {
            let is_late = cycle.late_start || cycle.deadline_miss;
            // A punctual cycle after a miss does not count: its skipped releases belong to the miss.
            if is_late || (cycle.skipped_periods > 0 && !after_miss) {
                causes.count(cycle.cause);
            }
            after_miss = cycle.deadline_miss;
            times[WAKE].saturating_record(cycle.wake_ns);
            if computes {
                let compute_ns = cycle.response_ns.saturating_sub(cycle.wake_ns);
                times[COMPUTE].saturating_record(compute_ns);
                times[RESPONSE].saturating_record(cycle.response_ns);
            }
        }
        let count = |is: fn(&&Cycle) -> bool| cycles.iter().filter(is).count();
        let sum = |number: fn(&Cycle) -> u64| cycles.iter().map(number).sum::<u64>();
        let counts = json!({
            "cycles": cycles.len(),
            "late_starts": count(|cycle| cycle.late_start),
            "deadline_misses": count(|cycle| cycle.deadline_miss),
            "own_misses": count(|cycle| cycle.deadline_miss && OWN.contains(&cycle.cause)),
            "skipped_periods": sum(|cycle| cycle.skipped_periods.into()),
            "causes": causes,
            // Time that the thread was ready while another one had the core.
            "run_delay_ms": sum(|cycle| cycle.run_delay_ns) as f64 * 1e-6,
        });
        Self { counts, times }
    }

    pub(super) fn from_cyclictest(of: &Latencies, deadline_ns: u64, late_ns: u64) -> Result<Self> {
        let mut times = empty_times();
        times[WAKE].add(&of.histogram_ns)?;
        let counts = json!({
            "cycles": of.cycles,
            "late_starts": of.later_than(late_ns),
            "deadline_misses": of.later_than(deadline_ns),
            "skipped_periods": of.skipped_periods,
        });
        Ok(Self { counts, times })
    }
}

#[cfg(test)]
mod tests {
    use cdcr_shared_types::codes::LateCause;

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
        let mut cycles = [
            cycle(20, 50, LateCause::None),
            cycle(6000, 6030, LateCause::Platform),
            cycle(20, 5100, LateCause::Compute),
            cycle(20, 5200, LateCause::PageFault),
            cycle(2000, 2040, LateCause::Load),
            cycle(30, 9000, LateCause::Stall),
            // Punctual again; the cycle before consumed its releases.
            cycle(20, 50, LateCause::Stall),
        ];
        cycles[6].skipped_periods = 1;
        let tally = Tally::from_cycles(&cycles, true);
        let expected = json!({
            "cycles": 7, "late_starts": 2, "deadline_misses": 4, "own_misses": 2, "skipped_periods": 5,
            "causes": { "platform": 1, "load": 1, "fault": 1, "other": 1, "compute": 1 }, "run_delay_ms": 3.5,
        });
        assert_eq!(tally.counts, expected);
        assert_eq!(tally.times.map(|times| times.len()), [7, 7, 7, 0]);
    }
}
