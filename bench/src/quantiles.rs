//! Five quantiles of a latency distribution, and the histogram that they are read from.

use cdcr_shared_types::LatencySummary;
use hdrhistogram::Histogram;
use serde::Serialize;

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Quantiles {
    pub min: f64,
    pub p50: f64,
    pub p99: f64,
    pub p999: f64,
    pub max: f64,
}

impl Quantiles {
    pub fn of(times_ns: &Histogram<u64>) -> Option<Self> {
        (!times_ns.is_empty()).then(|| Self {
            min: times_ns.min() as f64 * 1e-3,
            p50: quantile_us(times_ns, 0.5),
            p99: quantile_us(times_ns, 0.99),
            p999: quantile_us(times_ns, 0.999),
            max: times_ns.max() as f64 * 1e-3,
        })
    }

    /// From a daemon's statistics; `None` without counted values.
    pub fn reported(summary: &LatencySummary) -> Option<Self> {
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

pub fn quantile_us(times_ns: &Histogram<u64>, quantile: f64) -> f64 {
    times_ns.value_at_quantile(quantile) as f64 * 1e-3
}

/// Range from 1 ns to one minute, three digits.
pub fn histogram() -> Histogram<u64> {
    Histogram::new_with_bounds(1, 60_000_000_000, 3).expect("valid bounds")
}

/// The sum of histograms with these bounds.
pub fn pooled<'a>(all: impl IntoIterator<Item = &'a Histogram<u64>>) -> Histogram<u64> {
    all.into_iter()
        .fold(histogram(), |sum, times_ns| sum + times_ns)
}
