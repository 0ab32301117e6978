//! The five numbers that stand for a distribution of latencies.

use cdcr_shared_types::LatencySummary;
use hdrhistogram::Histogram;
use serde::Serialize;

use crate::closed_loop::quantile_us;

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Quantiles {
    pub min: f64,
    pub p50: f64,
    pub p99: f64,
    pub p999: f64,
    pub max: f64,
}

impl Quantiles {
    /// Of times in nanoseconds; none of an empty histogram.
    pub fn of(times_ns: &Histogram<u64>) -> Option<Self> {
        if times_ns.is_empty() {
            return None;
        }
        Some(Self {
            min: times_ns.min() as f64 * 1e-3,
            p50: quantile_us(times_ns, 0.5),
            p99: quantile_us(times_ns, 0.99),
            p999: quantile_us(times_ns, 0.999),
            max: times_ns.max() as f64 * 1e-3,
        })
    }

    /// As a daemon tells them; none when it counted nothing.
    pub fn told(summary: &LatencySummary) -> Option<Self> {
        let us = |time_ns: u64| time_ns as f64 * 1e-3;
        (summary.count > 0).then(|| Self {
            min: us(summary.min_ns),
            p50: us(summary.p50_ns),
            p99: us(summary.p99_ns),
            p999: us(summary.p999_ns),
            max: us(summary.max_ns),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::closed_loop::histogram;

    #[test]
    fn nothing_has_no_quantiles() {
        assert_eq!(Quantiles::of(&histogram().expect("bounds")), None);
        assert_eq!(Quantiles::told(&LatencySummary::default()), None);
    }

    #[test]
    fn they_are_those_of_the_values() {
        let mut times = histogram().expect("bounds");
        for us in 1..=1000 {
            times.record(us * 1000).expect("within the bounds");
        }
        let found = Quantiles::of(&times).expect("there are values");
        let near = |value: f64, expected: f64| (value - expected).abs() <= 2e-3 * expected;
        assert!(near(found.min, 1.0) && near(found.p50, 500.0), "{found:?}");
        assert!(
            near(found.p99, 990.0) && near(found.p999, 999.0),
            "{found:?}"
        );
        assert!(near(found.max, 1000.0), "{found:?}");
    }
}
