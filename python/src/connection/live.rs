//! Live records, batch by batch. One module with the connection, which makes them and whose records they fetch.

use std::time::{Duration, Instant};

use cdcr_shared_types::Telemetry;
use pyo3::prelude::*;

use super::{Connection, FETCH_EACH};
use crate::wire::Records;
use crate::worker::sleep_until;

/// Batches of records, from Connection.live().
#[pyclass(frozen, module = "cdcr")]
pub(crate) struct Live {
    connection: Py<Connection>,
    batch: Duration,
}

impl Live {
    pub(crate) fn new(connection: Py<Connection>, batch: Duration) -> Self {
        Self { connection, batch }
    }
}

#[pymethods]
impl Live {
    fn __iter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    /// The records since the last step. Raises LinkError if the daemon sends nothing for a second, or only commands for ten.
    fn __next__(&self, py: Python<'_>) -> PyResult<Records> {
        let connection = self.connection.get();
        let mut records = Records::new(Telemetry::LAYOUT);
        let mut heard = Instant::now();
        connection.fetch(py, &mut records, &mut heard)?;
        sleep_until(py, Instant::now() + self.batch)?;
        // Python may have returned late: the time of silence begins here.
        heard = Instant::now();
        loop {
            connection.fetch(py, &mut records, &mut heard)?;
            if records.count() > 0 {
                return Ok(records);
            }
            sleep_until(py, Instant::now() + FETCH_EACH)?;
        }
    }

    fn __repr__(&self) -> String {
        let robot = &self.connection.get().address.robot;
        format!("<Live records of {robot}, each {:?}>", self.batch)
    }
}
