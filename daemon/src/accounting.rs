//! Lateness of cycles, and its totals.

use cdcr_controller::safety::LeakyBucket;

use crate::rt::schedule::{Lateness, Release};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Deadline D after the release \[ns\].
    pub deadline_ns: u64,
    /// A start later than this after the release is a late start \[ns\].
    pub late_start_ns: u64,
    /// Level at which the leaky bucket is full.
    pub miss_limit: u32,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Totals {
    pub cycles: u64,
    pub late_starts: u64,
    pub deadline_misses: u64,
    /// Releases without a cycle.
    pub skipped_periods: u64,
}

/// Evaluates the lateness of every cycle.
#[derive(Debug, Clone)]
pub struct Accounting {
    limits: Limits,
    totals: Totals,
    bucket: LeakyBucket,
}

impl Accounting {
    pub fn new(limits: Limits) -> Self {
        Self {
            limits,
            totals: Totals::default(),
            bucket: LeakyBucket::new(limits.miss_limit),
        }
    }

    /// Evaluates a cycle whose command was handed over at `handed_over_ns`. A cycle with stale inputs is not
    /// a deadline miss, but counts like one in the leaky bucket.
    pub fn evaluate(
        &mut self,
        release: &Release,
        handed_over_ns: u64,
        stale_inputs: bool,
    ) -> Lateness {
        let lateness = Lateness {
            late_start: release.start_ns - release.due_ns > self.limits.late_start_ns,
            deadline_miss: handed_over_ns - release.due_ns > self.limits.deadline_ns,
        };
        self.totals.cycles += 1;
        self.totals.late_starts += u64::from(lateness.late_start);
        self.totals.deadline_misses += u64::from(lateness.deadline_miss);
        self.totals.skipped_periods += u64::from(release.skipped);
        match u32::from(lateness.deadline_miss || stale_inputs).saturating_add(release.skipped) {
            0 => self.bucket.drain(),
            trouble => self.bucket.pour(trouble),
        }
        lateness
    }

    pub fn totals(&self) -> &Totals {
        &self.totals
    }

    /// The leaky bucket of deadline misses, skipped periods and cycles with stale inputs.
    pub fn bucket(&self) -> &LeakyBucket {
        &self.bucket
    }

    pub fn limits(&self) -> &Limits {
        &self.limits
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lateness_counts_from_the_release() {
        let limits = Limits {
            deadline_ns: 100,
            late_start_ns: 20,
            miss_limit: 3,
        };
        let mut accounting = Accounting::new(limits);
        let release = |start_ns, skipped| Release {
            cycle: 1,
            release_ns: 1000,
            due_ns: 1000,
            start_ns,
            skipped,
        };
        assert_eq!(
            accounting.evaluate(&release(1020, 0), 1100, false),
            Lateness::default()
        );
        let late = accounting.evaluate(&release(1021, 0), 1100, false);
        assert!(late.late_start && !late.deadline_miss);
        let miss = accounting.evaluate(&release(1001, 2), 1101, false);
        assert!(!miss.late_start && miss.deadline_miss);
        assert!(accounting.bucket().overflows());
        // Slept through three periods: the release that was due is missed, however punctual the newest one.
        let stall = Release {
            release_ns: 1300,
            ..release(1310, 0)
        };
        let lateness = Accounting::new(limits).evaluate(&stall, 1320, false);
        assert!(lateness.late_start && lateness.deadline_miss);
        let mut starved = Accounting::new(limits);
        for _ in 0..3 {
            let lateness = starved.evaluate(&release(1001, 0), 1010, true);
            assert_eq!(lateness, Lateness::default());
        }
        assert!(starved.bucket().overflows());
        let totals = Totals {
            cycles: 3,
            late_starts: 1,
            deadline_misses: 1,
            skipped_periods: 2,
        };
        assert_eq!(*accounting.totals(), totals);
    }
}
