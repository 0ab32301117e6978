//! Whether the machine slept: suspended to memory or to disk.
//!
//! `CLOCK_MONOTONIC` stands still meanwhile, and so does every time stamp of the daemon; `CLOCK_BOOTTIME` goes on. What
//! one is ahead of the other grows by the sleep and by nothing else.

use std::ops::RangeInclusive;

/// A shorter sleep does not count \[ns\]: no machine sleeps and wakes up again in this time.
const SLEEP_MIN_NS: u64 = 10_000_000;

/// Counts how often the machine slept.
#[derive(Debug, Default)]
pub struct SuspendWatch {
    /// The machine slept for at most so long until the newest look \[ns\]; none before the first.
    most_ns: Option<u64>,
    suspends: u64,
}

impl SuspendWatch {
    /// Takes note of how long the machine has slept in all, between a least and a most \[ns\]
    /// ([`Clock::slept_ns`](crate::rt::clock::Clock::slept_ns)). Returns how often it slept since the first look.
    ///
    /// The two are apart by the time that passed between the readings of the clocks, which may be long. It counts only
    /// what is certain: the least of now is more than the most of before.
    pub fn look(&mut self, slept_ns: &RangeInclusive<u64>) -> u64 {
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
        // It may have slept before the daemon began.
        assert_eq!(watch.look(&(7000 * MS..=7000 * MS)), 0);
        assert_eq!(watch.look(&(7009 * MS..=7009 * MS)), 0, "shorter than any");
        assert_eq!(watch.look(&(7500 * MS..=7500 * MS)), 1);
        assert_eq!(watch.look(&(7500 * MS..=7500 * MS)), 1);
        assert_eq!(watch.look(&(9500 * MS..=9500 * MS)), 2);
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
            assert_eq!(watch.look(&slept_ns), 0, "{slept_ns:?}");
        }
        // A sleep is found in spite of it, at the latest at the next look.
        assert_eq!(watch.look(&(105 * MS..=500 * MS)), 0);
        assert_eq!(watch.look(&(300 * MS..=300 * MS)), 1);
    }
}
