//! Trajectories fed in the background: a thread with its own connection keeps the lease.

use std::ops::{ControlFlow, RangeInclusive};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use cdcr_client::{FeedEnd, FeedEvent, FeedOptions, FeedProgress, FeedReport as Report};
use pyo3::prelude::*;

use crate::address::Address;
use crate::errors::Failure;
use crate::numbers::{until, within};
use crate::running::{Running, exit_result, wait_until_holding};
use crate::trajectory::{TrajectorySource, wire_interpolation};
use crate::worker::Closed;

/// Range of the time from the begin of the `with` to the first point [s].
const LEAD_S: RangeInclusive<f64> = 0.05..=60.0;

/// State shared by a feed and its thread.
#[derive(Default)]
struct Shared {
    stop: AtomicBool,
    closed: Closed,
    progress: Mutex<Option<FeedProgress>>,
}

/// Points that are fed to a daemon, from Connection.feed(): a context manager. Its thread has a connection and the lease of its own, so Python may do
/// something else, and be late. Leaving the `with` ends the feed: the lease is given back, and the robot holds.
#[pyclass(frozen, module = "cdcr")]
pub(crate) struct Feed {
    address: Address,
    source: TrajectorySource,
    options: FeedOptions,
    shared: Arc<Shared>,
    running: Running<FeedReport>,
}

/// Result of a feed.
#[pyclass(frozen, get_all, module = "cdcr")]
#[derive(Debug, Clone)]
pub(crate) struct FeedReport {
    /// Whether it was played to its end.
    played: bool,
    /// Points sent.
    points: u64,
    /// Chunks sent.
    chunks: u64,
    /// Whether the daemon tracked it.
    tracked: bool,
    /// Records of telemetry that the feed's thread lost.
    lost_records: u64,
    /// Time 0 of the trajectory [ns, CLOCK_MONOTONIC].
    start_ns: u64,
}

#[pymethods]
impl FeedReport {
    fn __repr__(&self) -> String {
        let Self {
            played,
            points,
            chunks,
            tracked,
            ..
        } = self;
        format!(
            "FeedReport(played={}, points={points}, chunks={chunks}, tracked={})",
            word(*played),
            word(*tracked)
        )
    }
}

/// Truth value in Python's notation.
fn word(truth: bool) -> &'static str {
    if truth { "True" } else { "False" }
}

impl From<Report> for FeedReport {
    fn from(report: Report) -> Self {
        Self {
            played: report.end == FeedEnd::Played,
            points: report.points,
            chunks: report.chunks,
            tracked: report.tracked,
            lost_records: report.lost_records,
            start_ns: report.start_ns,
        }
    }
}

impl Feed {
    pub(crate) fn new(
        (address, closed): (Address, Closed),
        source: TrajectorySource,
        track: bool,
        lead_s: f64,
    ) -> PyResult<Self> {
        let lead = within("lead_s", lead_s, LEAD_S)?;
        let interpolation = wire_interpolation(source.interpolation());
        let options = FeedOptions {
            track,
            lead: Duration::from_secs_f64(lead),
            interpolation,
            ..FeedOptions::default()
        };
        Ok(Self {
            address,
            source,
            options,
            shared: Arc::new(Shared {
                closed,
                ..Shared::default()
            }),
            running: Running::new("feed"),
        })
    }

    fn progress(&self) -> Option<FeedProgress> {
        *self
            .shared
            .progress
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl Feed {
    fn __enter__(slf: Bound<'_, Self>) -> PyResult<Bound<'_, Self>> {
        let feed = slf.get();
        let (address, source, options) = (feed.address.clone(), feed.source.clone(), feed.options);
        let shared = Arc::clone(&feed.shared);
        let run = move |begun: &Sender<bool>| run(&address, &source, options, &shared, begun);
        let give_up = || feed.shared.stop.store(true, Ordering::Relaxed);
        feed.running
            .begin(slf.py(), &feed.shared.closed, run, give_up)?;
        Ok(slf)
    }

    /// Waits until it is played, at most timeout_s [s]; without it, for as long as it takes. Returns the report, or None when it still runs.
    ///
    /// Raises FeedError, RequestError or LinkError if the daemon does not follow it to its end, or has ended, and FeedError outside of the `with`.
    #[pyo3(signature = (timeout_s = None))]
    fn wait(&self, py: Python<'_>, timeout_s: Option<f64>) -> PyResult<Option<FeedReport>> {
        let until = timeout_s.map(|timeout_s| until("timeout_s", timeout_s));
        self.running.wait(py, until.transpose()?)
    }

    /// Time played since the start of the points [s]; 0 before.
    #[getter]
    fn played_s(&self) -> f64 {
        self.progress().map_or(0.0, |progress| progress.played_s)
    }

    /// Whether the daemon has begun to track it; a hold by another client does not change this.
    #[getter]
    fn tracking(&self) -> bool {
        self.progress().is_some_and(|progress| progress.tracking)
    }

    /// Ends the feed, and waits until the robot holds.
    #[pyo3(signature = (kind: "object" = None, _error: "object" = None, _trace: "object" = None, /))]
    fn __exit__(
        &self,
        py: Python<'_>,
        kind: Option<Py<PyAny>>,
        _error: Option<Py<PyAny>>,
        _trace: Option<Py<PyAny>>,
    ) -> PyResult<()> {
        self.shared.stop.store(true, Ordering::Relaxed);
        exit_result(kind.as_ref(), self.running.wait(py, None))
    }

    fn __repr__(&self) -> String {
        let (robot, stage) = (&self.address.robot, self.running.word());
        let (played_s, duration_s) = (self.played_s(), self.source.curve().duration_s());
        format!("<Feed to {robot}: {stage}, {played_s:.2} of {duration_s:.2} s>")
    }
}

impl Drop for Feed {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
    }
}

fn run(
    address: &Address,
    source: &TrajectorySource,
    options: FeedOptions,
    shared: &Shared,
    begun: &Sender<bool>,
) -> Result<FeedReport, Failure> {
    let connection = address.open()?;
    let feeder = connection.feed(source.curve(), options)?;
    let mut has_begun = false;
    let report = feeder.run(|event| {
        if let FeedEvent::Progress(progress) = event {
            *shared
                .progress
                .lock()
                .unwrap_or_else(PoisonError::into_inner) = Some(progress);
            if !has_begun && (progress.tracking || !options.track) {
                has_begun = true;
                let _ = begun.send(true);
            }
        }
        if shared.stop.load(Ordering::Relaxed) || shared.closed.is_set() {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    })?;
    if !has_begun {
        let _ = begun.send(true);
    }
    // The lease is returned: the robot holds within a few cycles.
    wait_until_holding(address, &mut connection.telemetry()?)?;
    Ok(report.into())
}
