//! Percentiles of latencies, the same for the daemon's statistics and for [`bare`](crate::bare).

use cdcr_shared_types::LatencySummary;
use hdrhistogram::{CreationError, Histogram};

/// Higher latencies are counted as this \[ns\].
const LATENCY_MAX_NS: u64 = 10_000_000_000;

/// A histogram of latencies with `digits` significant digits. `saturating_record` never allocates.
pub(crate) fn histogram(digits: u8) -> Result<Histogram<u64>, CreationError> {
    Histogram::new_with_bounds(1, LATENCY_MAX_NS, digits)
}

pub(crate) fn summary(histogram: &Histogram<u64>) -> LatencySummary {
    LatencySummary {
        count: histogram.len(),
        min_ns: if histogram.is_empty() {
            0
        } else {
            histogram.min()
        },
        p50_ns: histogram.value_at_quantile(0.5),
        p99_ns: histogram.value_at_quantile(0.99),
        p999_ns: histogram.value_at_quantile(0.999),
        max_ns: histogram.max(),
    }
}
