use serde_json::{Value, json};

/// Bins per decade, and number of decades from 1 µs on.
const PER_DECADE: usize = 40;
const DECADES: usize = 6;

const BINS: usize = PER_DECADE * DECADES;

/// Histogram of a latency: bins of equal ratio from 1 µs to 1 s, one below and one above.
#[derive(Debug)]
pub(super) struct Histogram {
    bins: [u64; BINS + 2],
    count: u64,
    max_ns: u64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self {
            bins: [0; BINS + 2],
            count: 0,
            max_ns: 0,
        }
    }
}

impl Histogram {
    pub(super) fn take(&mut self, latency_ns: u64) {
        let decades = (latency_ns as f64 * 1e-3).log10();
        // The logarithm of zero is minus infinity: the first bin.
        let bin = (decades * PER_DECADE as f64 + 1.0).max(0.0) as usize;
        self.bins[bin.min(BINS + 1)] += 1;
        self.count += 1;
        self.max_ns = self.max_ns.max(latency_ns);
    }

    /// The upper end of the bin with the percentile `part` \[µs\], limited to the largest value, which is the
    /// upper end of the last bin.
    fn percentile_us(&self, part: f64) -> f64 {
        let wanted = (part * self.count as f64).ceil() as u64;
        let mut below = 0;
        let bin = self.bins.iter().position(|count| {
            below += count;
            below >= wanted
        });
        let max_us = self.max_ns as f64 * 1e-3;
        match bin {
            Some(bin) if bin <= BINS => max_us.min(10_f64.powf(bin as f64 / PER_DECADE as f64)),
            _ => max_us,
        }
    }

    pub(super) fn json(&self) -> Value {
        json!({
            "bins_per_decade": PER_DECADE,
            "bins": &self.bins[1..=BINS],
            "below_1_us": self.bins[0],
            "above_1_s": self.bins[BINS + 1],
            "count": self.count,
            "p50_us": self.percentile_us(0.5),
            "p99_us": self.percentile_us(0.99),
            "p999_us": self.percentile_us(0.999),
            "max_us": self.max_ns as f64 * 1e-3,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_right_to_a_bin_and_nothing_is_lost() {
        let mut histogram = Histogram::default();
        assert_eq!(histogram.json()["count"], 0);
        for us in 1..=1000 {
            histogram.take(us * 1000);
        }
        histogram.take(0);
        histogram.take(u64::MAX);
        let counted: u64 = histogram.bins.iter().sum();
        assert_eq!((histogram.count, counted), (1002, 1002));
        assert_eq!((histogram.bins[0], histogram.bins[BINS + 1]), (1, 1));
        let width = 10_f64.powf(1.0 / PER_DECADE as f64);
        for (part, expected_us) in [(0.5, 500.0), (0.99, 990.0)] {
            let ratio = histogram.percentile_us(part) / expected_us;
            assert!((1.0 / width..=width).contains(&ratio), "{ratio}");
        }
    }

    #[test]
    fn percentiles_of_what_is_less_or_more_than_all_bins_are_no_bins_end() {
        let mut histogram = Histogram::default();
        (0..1000).for_each(|ns| histogram.take(ns));
        assert!((histogram.percentile_us(0.5) - 0.999).abs() < 1e-9);
        (0..1000).for_each(|_| histogram.take(30_000_000_000));
        assert_eq!(histogram.percentile_us(0.5), 1.0);
        assert_eq!(histogram.percentile_us(0.99), 30e6);
        assert_eq!(histogram.json()["above_1_s"], 1000);
    }
}
