/// Counts trouble in: +n for each bad cycle, -1 for each good one, never below zero. At its limit,
/// trouble is no accident any more.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LeakyBucket {
    level: u32,
    limit: u32,
}

impl LeakyBucket {
    /// An empty bucket that overflows at `limit` ≥ 1.
    pub fn new(limit: u32) -> Self {
        Self {
            level: 0,
            limit: limit.max(1),
        }
    }

    /// A good cycle.
    pub fn drain(&mut self) {
        self.level = self.level.saturating_sub(1);
    }

    /// A bad cycle that counts `amount`; the level stays at most twice the limit, so that recovery
    /// takes a bounded time.
    pub fn pour(&mut self, amount: u32) {
        self.level = self.level.saturating_add(amount).min(2 * self.limit);
    }

    /// Present level.
    pub fn level(&self) -> u32 {
        self.level
    }

    /// Whether the limit is reached.
    pub fn overflows(&self) -> bool {
        self.level >= self.limit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn accidents_drain_away_and_series_overflow() {
        let mut bucket = LeakyBucket::new(3);
        for _ in 0..100 {
            bucket.pour(1);
            bucket.drain();
        }
        assert!(!bucket.overflows());
        bucket.pour(3);
        assert!(bucket.overflows());
        bucket.pour(1000);
        for _ in 0..6 {
            bucket.drain();
        }
        assert_eq!(bucket.level(), 0);
    }
}
