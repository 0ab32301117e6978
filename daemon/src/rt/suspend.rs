//! Detection of suspends of the machine, to memory or to disk.
//!
//! `CLOCK_MONOTONIC` stands still during a suspend, and with it every time stamp of the daemon;
//! `CLOCK_BOOTTIME` continues. Only a suspend increases their difference.

use std::ops::RangeInclusive;

/// A shorter suspend does not count \[ns\]: no machine suspends and resumes in this time.
const SLEEP_MIN_NS: u64 = 10_000_000;

/// Counts the suspends of the machine.
#[derive(Debug, Default)]
pub struct SuspendWatch {
    /// Upper bound of the suspended time at the newest reading \[ns\]; `None` before the first.
    most_ns: Option<u64>,
    suspends: u64,
}

impl SuspendWatch {
    /// Takes the lower and upper bound of the total suspended time \[ns\]
    /// ([`Clock::slept_ns`](crate::rt::clock::Clock::slept_ns)). Returns the number of suspends since the
    /// first call.
    ///
    /// The bounds differ by the time between the readings of the clocks, which may be long. Only a certain
    /// suspend counts: the new lower bound exceeds the earlier upper bound.
    pub fn update(&mut self, slept_ns: &RangeInclusive<u64>) -> u64 {
        let most_ns = self.most_ns.unwrap_or(*slept_ns.end());
        if *slept_ns.start() > most_ns + SLEEP_MIN_NS {
            self.suspends += 1;
            self.most_ns = Some(*slept_ns.end());
        } else {
            self.most_ns = Some(most_ns.min(*slept_ns.end()));
        }
        self.suspends
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    #[test]
    fn each_sleep_counts_once() {
        let mut watch = SuspendWatch::default();
        // A suspend before the start of the daemon does not count.
        assert_eq!(watch.update(&(7000 * MS..=7000 * MS)), 0);
        assert_eq!(
            watch.update(&(7009 * MS..=7009 * MS)),
            0,
            "shorter than any"
        );
        assert_eq!(watch.update(&(7500 * MS..=7500 * MS)), 1);
        assert_eq!(watch.update(&(7500 * MS..=7500 * MS)), 1);
        assert_eq!(watch.update(&(9500 * MS..=9500 * MS)), 2);
    }

    #[test]
    fn a_thread_that_stands_still_between_two_clocks_does_not_count() {
        let mut watch = SuspendWatch::default();
        for slept_ns in [
            100 * MS..=160 * MS,
            90 * MS..=101 * MS,
            40 * MS..=100 * MS,
            100 * MS..=800 * MS,
            100 * MS..=100 * MS,
        ] {
            assert_eq!(watch.update(&slept_ns), 0, "{slept_ns:?}");
        }
        // A suspend is found nevertheless, at the latest by the next reading.
        assert_eq!(watch.update(&(105 * MS..=500 * MS)), 0);
        assert_eq!(watch.update(&(300 * MS..=300 * MS)), 1);
    }
}
