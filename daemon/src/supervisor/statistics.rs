use std::time::Duration;

use cdcr_shared_types as wire;
use cdcr_shared_types::codes::LateCause;
use hdrhistogram::Histogram;

use crate::accounting::Totals;
use crate::handover::Summary;
use crate::rt::latency;

/// Length of a slice of the last minute.
const SLICE: Duration = Duration::from_secs(10);
/// Slices of the last minute, including the present one.
const SLICES: usize = 6;
/// Digits of a percentile: accurate to 1 %. Three digits would need ten times the memory for each status.
const DIGITS: u8 = 2;

/// Statistics of the cycles: since the start or the last reset, and of the last minute.
///
/// Cycles, late starts, deadline misses and skipped periods come from the totals of the cycle thread, so they
/// are exact even if summaries were lost. All others count the summaries received.
///
/// All memory is allocated at the start, about 1.4 MB.
#[derive(Debug)]
pub(super) struct Statistics {
    /// Totals of the newest summary, since the start.
    counted: Totals,
    since_reset: Window,
    since_ns: u64,
    slices: [Window; SLICES],
    filling: usize,
    slice_began_ns: u64,
    /// The sum of the slices.
    last_minute: Window,
}

/// Counts and latencies of one time window.
#[derive(Debug)]
struct Window {
    counts: wire::Statistics,
    /// Wake-up, gather, compute, response, publish, solve.
    latencies: [Histogram<u64>; 6],
    streak: u64,
}

impl Statistics {
    pub(super) fn new(now_ns: u64) -> anyhow::Result<Self> {
        Ok(Self {
            counted: Totals::default(),
            since_reset: Window::new()?,
            since_ns: now_ns,
            slices: [
                Window::new()?,
                Window::new()?,
                Window::new()?,
                Window::new()?,
                Window::new()?,
                Window::new()?,
            ],
            filling: 0,
            slice_began_ns: now_ns,
            last_minute: Window::new()?,
        })
    }

    pub(super) fn record(&mut self, summary: &Summary) {
        let before = core::mem::replace(&mut self.counted, summary.totals);
        let passed = difference(&summary.totals, &before);
        for window in self.windows() {
            window.count(&passed);
            window.record(summary);
        }
    }

    pub(super) fn dropped(&mut self, records: u64) {
        for window in self.windows() {
            window.counts.dropped_records += records;
        }
    }

    /// The windows to which a cycle is added.
    fn windows(&mut self) -> [&mut Window; 3] {
        let filling = &mut self.slices[self.filling];
        [&mut self.since_reset, filling, &mut self.last_minute]
    }

    /// Resets all windows, including the last minute.
    pub(super) fn reset(&mut self, now_ns: u64) {
        self.since_reset.clear();
        self.since_ns = now_ns;
        for slice in &mut self.slices {
            slice.clear();
        }
        self.last_minute.clear();
        self.slice_began_ns = now_ns;
    }

    /// Advances to the slice that contains `now_ns`.
    pub(super) fn advance(&mut self, now_ns: u64) {
        let slice_ns = SLICE.as_nanos() as u64;
        let passed = now_ns.saturating_sub(self.slice_began_ns) / slice_ns;
        for _ in 0..passed.min(SLICES as u64) {
            let streak = self.slices[self.filling].streak;
            self.filling = (self.filling + 1) % SLICES;
            self.slices[self.filling].clear();
            // A streak across the border of two slices is one streak.
            self.slices[self.filling].streak = streak;
        }
        self.slice_began_ns += passed * slice_ns;
        if passed > 0 {
            // Sum up the slices again, without the expired ones.
            self.last_minute.clear();
            for slice in &self.slices {
                self.last_minute.add(slice);
            }
            self.last_minute.streak = self.slices[self.filling].streak;
        }
    }

    /// Writes both windows into a status.
    pub(super) fn report(&self, status: &mut wire::Status) {
        status.statistics_since_ns = self.since_ns;
        status.since_reset = self.since_reset.summary();
        status.last_minute = self.last_minute.summary();
    }
}

impl Window {
    fn new() -> anyhow::Result<Self> {
        let histogram = || latency::histogram(DIGITS);
        Ok(Self {
            counts: wire::Statistics::default(),
            latencies: [
                histogram()?,
                histogram()?,
                histogram()?,
                histogram()?,
                histogram()?,
                histogram()?,
            ],
            streak: 0,
        })
    }

    fn count(&mut self, passed: &Totals) {
        let counts = &mut self.counts;
        counts.cycles += passed.cycles;
        counts.late_starts += passed.late_starts;
        counts.deadline_misses += passed.deadline_misses;
        counts.skipped_periods += passed.skipped_periods;
    }

    fn record(&mut self, summary: &Summary) {
        let counts = &mut self.counts;
        let missed = summary.lateness.deadline_miss;
        counts.accumulate(&summary.counts);
        let cause = summary.late_cause;
        if cause != LateCause::None.code()
            && let Some(count) = counts.causes.get_mut(cause as usize)
        {
            *count += 1;
        }
        // The skipped releases are before this cycle.
        self.streak += u64::from(summary.skipped_periods);
        self.streak += u64::from(missed);
        counts.longest_streak = counts.longest_streak.max(self.streak);
        if !missed {
            self.streak = 0;
        }
        let values = [
            summary.wake_ns,
            summary.gather_ns,
            summary.compute_ns,
            summary.response_ns,
            summary.publish_ns,
            summary.solve_ns,
        ];
        let counted = if summary.solved { 6 } else { 5 };
        for (histogram, value_ns) in self.latencies.iter_mut().zip(values).take(counted) {
            histogram.saturating_record(value_ns);
        }
    }

    fn clear(&mut self) {
        self.counts = wire::Statistics::default();
        self.streak = 0;
        for histogram in &mut self.latencies {
            histogram.reset();
        }
    }

    /// Adds the counts of another window.
    fn add(&mut self, other: &Self) {
        let (counts, more) = (&mut self.counts, &other.counts);
        counts.accumulate(more);
        for (count, more) in counts.causes.iter_mut().zip(more.causes) {
            *count += more;
        }
        for (sum, part) in self.latencies.iter_mut().zip(&other.latencies) {
            // The bounds are equal, so every value fits.
            let _ = sum.add(part);
        }
    }

    fn summary(&self) -> wire::Statistics {
        let [wake, gather, compute, response, publish, solve] =
            self.latencies.each_ref().map(wire::LatencySummary::from);
        wire::Statistics {
            wake,
            gather,
            compute,
            solve,
            response,
            publish,
            ..self.counts
        }
    }
}

fn difference(now: &Totals, before: &Totals) -> Totals {
    Totals {
        cycles: now.cycles.saturating_sub(before.cycles),
        late_starts: now.late_starts.saturating_sub(before.late_starts),
        deadline_misses: now.deadline_misses.saturating_sub(before.deadline_misses),
        skipped_periods: now.skipped_periods.saturating_sub(before.skipped_periods),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rt::schedule::Lateness;

    const S: u64 = 1_000_000_000;

    fn good() -> Summary {
        Summary {
            wake_ns: 30_000,
            gather_ns: 10_000,
            compute_ns: 20_000,
            response_ns: 50_000,
            publish_ns: 5_000,
            solved: true,
            solve_ns: 15_000,
            ..Summary::default()
        }
    }

    fn missed(skipped_periods: u32) -> Summary {
        Summary {
            lateness: Lateness {
                late_start: true,
                deadline_miss: true,
            },
            skipped_periods,
            late_cause: LateCause::Platform.code(),
            wake_ns: 6_000_000,
            ..good()
        }
    }

    /// Statistics, and the totals of the cycle thread that they receive.
    struct StatisticsTest {
        statistics: Statistics,
        totals: Totals,
    }

    impl StatisticsTest {
        fn new() -> Self {
            Self {
                statistics: Statistics::new(0).unwrap(),
                totals: Totals::default(),
            }
        }

        /// A cycle whose summary is lost.
        fn lose(&mut self, summary: &Summary) {
            let totals = &mut self.totals;
            totals.cycles += 1;
            totals.late_starts += u64::from(summary.lateness.late_start);
            totals.deadline_misses += u64::from(summary.lateness.deadline_miss);
            totals.skipped_periods += u64::from(summary.skipped_periods);
        }

        fn record(&mut self, summary: &Summary) {
            self.lose(summary);
            let totals = self.totals;
            self.statistics.record(&Summary { totals, ..*summary });
        }
    }

    fn report(statistics: &mut Statistics) -> [wire::Statistics; 2] {
        let mut status = wire::Status::default();
        statistics.report(&mut status);
        [status.since_reset, status.last_minute]
    }

    #[test]
    fn counts_and_percentiles_of_both_stretches() {
        let mut test = StatisticsTest::new();
        for _ in 0..98 {
            test.record(&good());
        }
        test.record(&missed(0));
        test.record(&missed(3));
        test.statistics.dropped(2);
        for counts in report(&mut test.statistics) {
            assert_eq!((counts.cycles, counts.deadline_misses), (100, 2));
            assert_eq!((counts.skipped_periods, counts.longest_streak), (3, 5));
            assert_eq!(counts.causes[LateCause::Platform.code() as usize], 2);
            assert_eq!(counts.causes.iter().sum::<u64>(), 2);
            assert_eq!(counts.dropped_records, 2);
            assert_eq!(counts.wake.count, 100);
            let close = |is: u64, was: u64| is.abs_diff(was) * 100 <= was;
            assert!(close(counts.wake.p50_ns, 30_000), "{:?}", counts.wake);
            assert!(close(counts.wake.max_ns, 6_000_000), "{:?}", counts.wake);
            assert!(close(counts.solve.p99_ns, 15_000), "{:?}", counts.solve);
        }
    }

    #[test]
    fn the_last_minute_forgets_and_the_rest_remembers() {
        let mut test = StatisticsTest::new();
        for second in 0..200 {
            test.statistics.advance(second * S);
            test.record(&good());
        }
        let [since, minute] = report(&mut test.statistics);
        assert_eq!(since.cycles, 200);
        assert!((50..=60).contains(&minute.cycles), "{}", minute.cycles);
        // After a long time without cycles the last minute is empty.
        test.statistics.advance(1_000_000 * S);
        assert_eq!(report(&mut test.statistics)[1].cycles, 0);
        assert_eq!(report(&mut test.statistics)[0].cycles, 200);
    }

    #[test]
    fn a_reset_begins_anew() {
        let mut test = StatisticsTest::new();
        test.record(&missed(9));
        test.statistics.reset(7 * S);
        test.record(&good());
        for counts in report(&mut test.statistics) {
            assert_eq!((counts.cycles, counts.deadline_misses), (1, 0));
            assert_eq!((counts.longest_streak, counts.wake.count), (0, 1));
        }
        let mut status = wire::Status::default();
        test.statistics.report(&mut status);
        assert_eq!(status.statistics_since_ns, 7 * S);
    }

    #[test]
    fn a_streak_goes_on_over_the_border_of_a_slice() {
        let mut test = StatisticsTest::new();
        test.record(&missed(1));
        test.statistics.advance(10 * S);
        test.record(&missed(1));
        assert_eq!(report(&mut test.statistics)[1].longest_streak, 4);
        test.record(&good());
        test.record(&missed(0));
        assert_eq!(report(&mut test.statistics)[1].longest_streak, 4);
    }

    #[test]
    fn lost_summaries_do_not_make_the_exact_counts_wrong() {
        let mut test = StatisticsTest::new();
        test.record(&missed(0));
        test.statistics.reset(S);
        test.lose(&missed(2));
        test.lose(&good());
        test.record(&good());
        // Cycles lost in the next slice count there.
        test.statistics.advance(20 * S);
        test.lose(&missed(4));
        test.record(&missed(0));
        for counts in report(&mut test.statistics) {
            assert_eq!((counts.cycles, counts.wake.count), (5, 2));
            assert_eq!((counts.deadline_misses, counts.late_starts), (3, 3));
            assert_eq!(counts.skipped_periods, 6);
        }
        test.statistics.advance(65 * S);
        let [since, minute] = report(&mut test.statistics);
        assert_eq!((since.cycles, since.skipped_periods), (5, 6));
        assert_eq!((minute.cycles, minute.skipped_periods), (2, 4));
    }
}
