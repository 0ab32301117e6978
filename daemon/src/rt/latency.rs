//! Histograms of latencies, the same for the daemon's statistics and for [`bare`](crate::bare).

use hdrhistogram::{CreationError, Histogram};

/// Higher latencies are counted as this \[ns\].
const LATENCY_MAX_NS: u64 = 10_000_000_000;

/// A histogram of latencies with `digits` significant digits. `saturating_record` never allocates.
pub(crate) fn histogram(digits: u8) -> Result<Histogram<u64>, CreationError> {
    Histogram::new_with_bounds(1, LATENCY_MAX_NS, digits)
}
