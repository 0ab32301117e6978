//! Moments that are spread evenly over the period.

/// Fractional part of the golden ratio: its multiples fill the circle more evenly than those of any other
/// number, however many of them are taken.
const GOLDEN: f64 = 0.618_033_988_749_894_9;

/// Phases of a period, one after the other.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Phases {
    taken: u32,
}

impl Phases {
    pub(super) fn next(&mut self) -> f64 {
        self.taken += 1;
        (f64::from(self.taken) * GOLDEN).fract()
    }

    /// The next one, as a part of `period_ns`.
    pub(super) fn next_ns(&mut self, period_ns: u64) -> u64 {
        (self.next() * period_ns as f64) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_tenth_of_the_period_gets_its_share() {
        let mut phases = Phases::default();
        let mut tenths = [0; 10];
        for _ in 0..200 {
            tenths[phases.next_ns(10) as usize] += 1;
        }
        assert!(
            tenths.iter().all(|count| (18..=22).contains(count)),
            "{tenths:?}"
        );
    }
}
