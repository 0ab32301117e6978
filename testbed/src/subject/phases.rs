//! Times within a period, spread evenly over it, for messages and requests that come at any time.

/// Fractional part of the golden ratio: its multiples cover the circle more evenly than those of any other
/// number, for every count.
const GOLDEN: f64 = 0.618_033_988_749_894_9;

#[derive(Debug, Default)]
pub struct Phases {
    taken: u32,
}

impl Phases {
    pub fn next_ns(&mut self, period_ns: u64) -> u64 {
        self.taken += 1;
        ((f64::from(self.taken) * GOLDEN).fract() * period_ns as f64) as u64
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
        let is_fair = |count| (18..=22).contains(count);
        assert!(tenths.iter().all(is_fair), "{tenths:?}");
    }
}
