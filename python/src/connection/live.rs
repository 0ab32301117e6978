//! Live records, batch by batch.

use std::time::{Duration, Instant};

use cdcr_shared_types::Telemetry;
use pyo3::prelude::*;

use crate::wire::Records;
use crate::worker::sleep_until;

/// Interval between fetches of records, short enough that a queue of 256 does not fill.
pub(super) const FETCH_EACH: Duration = Duration::from_millis(20);

/// Adds the pending records to others, and updates the time of the last one.
type Fetch = Box<dyn Fn(Python<'_>, &mut Records, &mut Instant) -> PyResult<()> + Send + Sync>;

/// Batches of records, from Connection.live().
#[pyclass(frozen, module = "cdcr")]
pub(crate) struct Live {
    fetch: Fetch,
    robot: String,
    batch: Duration,
}

impl Live {
    pub(super) fn new(fetch: Fetch, robot: String, batch: Duration) -> Self {
        Self {
            fetch,
            robot,
            batch,
        }
    }
}

#[pymethods]
impl Live {
    fn __iter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    /// The records since the last step. Raises LinkError if the daemon sends nothing for a second, or only commands for ten.
    fn __next__(&self, py: Python<'_>) -> PyResult<Records> {
        let mut records = Records::new(Telemetry::LAYOUT);
        let mut heard = Instant::now();
        (self.fetch)(py, &mut records, &mut heard)?;
        sleep_until(py, Instant::now() + self.batch)?;
        // Python may have returned late: the time of silence begins here.
        heard = Instant::now();
        loop {
            (self.fetch)(py, &mut records, &mut heard)?;
            if records.count() > 0 {
                return Ok(records);
            }
            sleep_until(py, Instant::now() + FETCH_EACH)?;
        }
    }

    fn __repr__(&self) -> String {
        format!("<Live records of {}, each {:?}>", self.robot, self.batch)
    }
}
