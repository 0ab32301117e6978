//! Lateness in the last records: stalls of the machine that a bound has to include.

use std::collections::VecDeque;
use std::ops::RangeInclusive;

use cdcr_shared_types::Telemetry;

use crate::faults::trail::late_ns;

/// Number of kept records: 10 s at 5 ms.
const KEPT: usize = 2000;

/// The data about stalls in the last records.
#[derive(Debug, Default)]
pub(crate) struct History(VecDeque<Kept>);

#[derive(Debug, Clone, Copy)]
struct Kept {
    release_ns: u64,
    period_ns: u64,
    late_ns: u64,
    gather: u64,
    gather_ns: u64,
    measured_ns: u64,
    commanded_rad: f64,
    rate_rad_s: f64,
}

impl History {
    pub(crate) fn note(&mut self, record: &Telemetry) {
        if self.0.len() == KEPT {
            self.0.pop_front();
        }
        // A cycle that reuses the inputs of the previous one costs a period, too.
        let newest = self.0.back();
        let has_old_inputs = newest.is_some_and(|before| before.gather == record.gather);
        self.0.push_back(Kept {
            release_ns: record.release_ns,
            period_ns: record.period_ns,
            late_ns: late_ns(record) + u64::from(has_old_inputs) * record.period_ns,
            gather: record.gather,
            gather_ns: record.gather_ns,
            measured_ns: record.measurement.measured_ns,
            commanded_rad: record.commanded_rad[0],
            rate_rad_s: record.command.bend_rate_rad_s[0],
        });
    }

    /// Lateness reported by the cycles released after `begin_ns` \[ns\]; each may have delayed the newest
    /// one.
    pub(crate) fn late_since_ns(&self, begin_ns: u64) -> u64 {
        let since = self.0.iter().filter(|kept| kept.release_ns > begin_ns);
        since.map(|kept| kept.late_ns).sum()
    }

    /// Motion of the commanded first bend from `begin_ns` to the newest release \[rad\]. A command that left moves it
    /// from its release until it expires or the next one comes.
    pub(crate) fn way_rad(&self, begin_ns: u64) -> f64 {
        let way_rad = |(before, now): (&Kept, &Kept)| {
            let moved_rad = now.commanded_rad - before.commanded_rad;
            let moving_ns = (moved_rad / before.rate_rad_s * 1e9).max(0.0);
            let left_out_ns = begin_ns.saturating_sub(before.release_ns) as f64;
            if left_out_ns >= moving_ns {
                0.0
            } else {
                moved_rad * (1.0 - left_out_ns / moving_ns)
            }
        };
        let since = self
            .pairs()
            .take_while(|(_, now)| now.release_ns > begin_ns);
        since.map(way_rad).sum()
    }

    /// Pairs of neighbours, newest first.
    fn pairs(&self) -> impl Iterator<Item = (&Kept, &Kept)> {
        self.0.iter().rev().skip(1).zip(self.0.iter().rev())
    }

    /// Silence of the driver in the record with this gather \[ns\]: the counted time, at most two periods
    /// from one gather to the next, and the rest.
    pub(crate) fn silence_ns(&self, gather: u64) -> (u64, u64) {
        let (mut counted_ns, mut rest_ns) = (0, 0);
        for (before, now) in self.pairs().skip_while(|(_, now)| now.gather != gather) {
            if before.measured_ns != now.measured_ns {
                // A measurement that came while its gather stood still has age zero.
                counted_ns += now.gather_ns.saturating_sub(now.measured_ns);
                break;
            }
            let gap_ns = now.gather_ns - before.gather_ns;
            let counts_ns = gap_ns.min(2 * now.period_ns);
            counted_ns += counts_ns;
            rest_ns += gap_ns - counts_ns;
        }
        (counted_ns, rest_ns)
    }

    /// Extension of a lease from gather `first`, which began at `first_ns`, to gather `last` \[ns\]: the time
    /// beyond two periods between consecutive gathers. Least and largest value, because skipped cycles leave
    /// no record of their gathers.
    pub(crate) fn unheard_ns(&self, first: u64, first_ns: u64, last: u64) -> RangeInclusive<u64> {
        let (mut before, mut before_ns) = (first, first_ns);
        let (mut least_ns, mut most_ns) = (0, 0);
        let since = self
            .0
            .iter()
            .filter(|kept| (first + 1..=last).contains(&kept.gather));
        for kept in since {
            if kept.gather == before {
                continue;
            }
            let gap_ns = kept.gather_ns.saturating_sub(before_ns);
            let gathers = kept.gather - before;
            least_ns += gap_ns.saturating_sub(2 * kept.period_ns * gathers);
            most_ns += gap_ns.saturating_sub(2 * kept.period_ns);
            (before, before_ns) = (kept.gather, kept.gather_ns);
        }
        least_ns..=most_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gathers at these times, in periods of 5 ns; the first two have new measurements.
    fn history(gathers: &[(u64, u64)]) -> History {
        let mut history = History::default();
        for (index, (gather, gather_ns)) in gathers.iter().enumerate() {
            let mut record = Telemetry {
                period_ns: 5,
                gather: *gather,
                gather_ns: *gather_ns,
                release_ns: gather_ns + 1,
                start_ns: gather_ns + 2,
                ..Telemetry::default()
            };
            record.measurement.measured_ns = 102 + index.min(1) as u64;
            history.note(&record);
        }
        history
    }

    #[test]
    fn only_what_passed_beyond_two_periods_is_unheard() {
        let history = history(&[(1, 100), (2, 105), (3, 130), (3, 130), (6, 165)]);
        assert_eq!(history.unheard_ns(1, 100, 2), 0..=0);
        assert_eq!(history.unheard_ns(1, 100, 3), 15..=15);
        // The times of gathers 4 and 5 are unknown.
        assert_eq!(history.unheard_ns(1, 100, 6), 20..=40);
        // The measurement at time 103 came with the gather at 105.
        assert_eq!(history.silence_ns(3), (2 + 10, 15));
        assert_eq!(history.silence_ns(6), (2 + 10 + 10, 15 + 25));
        // Each of the five started 1 ns late, and one had old inputs.
        assert_eq!(history.late_since_ns(100), 5 + 5);
        assert_eq!(history.late_since_ns(131), 1);
    }

    #[test]
    fn a_command_moves_from_its_release_until_it_expires() {
        let mut history = History::default();
        // A stall of 40 ns after a command that was valid for 15.
        for (release_ns, commanded_rad, rate_rad_s) in [
            (100, 0.0, 1e9),
            (105, 5.0, 2e9),
            (145, 35.0, 4e9),
            (150, 55.0, 0.0),
            (155, 55.0, 0.0),
        ] {
            let mut record = Telemetry {
                period_ns: 5,
                release_ns,
                start_ns: release_ns,
                ..Telemetry::default()
            };
            record.commanded_rad[0] = commanded_rad;
            record.command.bend_rate_rad_s[0] = rate_rad_s;
            history.note(&record);
        }
        for (begin_ns, way_rad) in [
            (152, 0.0),
            (147, 12.0),
            (130, 20.0),
            (110, 40.0),
            (102, 53.0),
        ] {
            let found_rad = history.way_rad(begin_ns);
            assert!(
                (found_rad - way_rad).abs() < 1e-9,
                "{begin_ns}: {found_rad}"
            );
        }
    }
}
