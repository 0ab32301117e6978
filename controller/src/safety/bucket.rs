/// A leaky bucket: each bad release adds [`WEIGHT`](Self::WEIGHT), each good one removes 1, never below zero.
/// It overflows after `limit` bad releases in a row, or when more than one release in ten is bad for long
/// enough.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LeakyBucket {
    /// In units of a good release: [`WEIGHT`](Self::WEIGHT) units are one bad release.
    level: u64,
    limit: u32,
}

impl LeakyBucket {
    /// Good releases that compensate for a bad one.
    pub const WEIGHT: u32 = 9;

    /// An empty bucket that overflows at `limit` ≥ 1 bad releases in a row.
    pub fn new(limit: u32) -> Self {
        Self {
            level: 0,
            limit: limit.max(1),
        }
    }

    /// A good release.
    pub fn drain(&mut self) {
        self.level = self.level.saturating_sub(1);
    }

    /// `amount` bad releases; the level stays at most twice the limit, so that recovery takes a bounded time.
    pub fn pour(&mut self, amount: u32) {
        let most = 2 * u64::from(self.limit) * u64::from(Self::WEIGHT);
        self.level = (self.level + u64::from(amount) * u64::from(Self::WEIGHT)).min(most);
    }

    /// Present level in bad releases, rounded down.
    pub fn level(&self) -> u32 {
        (self.level / u64::from(Self::WEIGHT)) as u32
    }

    /// Whether the limit is reached.
    pub fn overflows(&self) -> bool {
        self.level >= u64::from(self.limit) * u64::from(Self::WEIGHT)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Releases until the bucket overflows when every `nth` is bad, at most 100 000.
    fn overflows_after(limit: u32, nth: u32) -> Option<u32> {
        let mut bucket = LeakyBucket::new(limit);
        (1..=100_000).find(|release| {
            if release % nth == 0 {
                bucket.pour(1);
            } else {
                bucket.drain();
            }
            bucket.overflows()
        })
    }

    #[test]
    fn accidents_drain_away_and_series_overflow() {
        assert_eq!(overflows_after(40, 1), Some(40));
        // One release in three is bad: 40 of them are not made up for after less than a second at 5 ms.
        let third = overflows_after(40, 3).unwrap_or(u32::MAX);
        assert!(third < 200, "{third}");
        assert!(overflows_after(40, 9).is_some());
        assert_eq!(overflows_after(40, 10), None);
        let mut bucket = LeakyBucket::new(3);
        bucket.pour(1000);
        assert!(bucket.overflows());
        for _ in 0..6 * LeakyBucket::WEIGHT {
            bucket.drain();
        }
        assert_eq!((bucket.level, bucket.level()), (0, 0));
    }
}
