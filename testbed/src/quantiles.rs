//! Five quantiles of a latency distribution, and the histogram that they are read from: for measurements and tests.

use cdcr_shared_types::LatencySummary;
use hdrhistogram::Histogram;
use serde_json::{Value, json};

/// Five quantiles \[µs\]; null without values.
pub fn quantiles(times_ns: &Histogram<u64>) -> Value {
    reported(&times_ns.into())
}

/// The same from a daemon's statistics.
pub fn reported(of: &LatencySummary) -> Value {
    let all_ns = [of.min_ns, of.p50_ns, of.p99_ns, of.p999_ns, of.max_ns];
    let [min, p50, p99, p999, max] = all_ns.map(|time_ns| time_ns as f64 * 1e-3);
    let all = json!({ "min": min, "p50": p50, "p99": p99, "p999": p999, "max": max });
    if of.count > 0 { all } else { Value::Null }
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
