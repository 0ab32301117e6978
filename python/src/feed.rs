//! Trajectories that are fed while Python does something else: a thread with a connection of its own keeps the lease.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use cdcr_client::{FeedEnd, FeedEvent, FeedOptions, FeedProgress, FeedReport as Report};
use pyo3::prelude::*;

use crate::connection::{Address, seconds};
use crate::errors::{Class, Failure};
use crate::running::{Running, TURN, until_it_holds};
use crate::trajectory::{Source, wire_interpolation};
use crate::worker::sleep_until;

/// What a feed and its thread share.
#[derive(Default)]
struct Shared {
    stop: AtomicBool,
    progress: Mutex<Option<FeedProgress>>,
}

/// Points that are fed to a daemon, from Connection.feed(): a context manager. Its thread has a connection and the lease of its own, so Python may do
/// something else, and be late. Leaving the `with` ends the feed: the lease is given back, and the robot holds.
#[pyclass(module = "cdcr")]
pub(crate) struct Feed {
    address: Address,
    source: Source,
    options: FeedOptions,
    shared: Arc<Shared>,
    running: Option<Running<Report>>,
    report: Option<FeedReport>,
}

/// What a feed did.
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
        address: Address,
        source: Source,
        track: bool,
        lead: Duration,
    ) -> PyResult<Self> {
        if !(0.05..=60.0).contains(&lead.as_secs_f64()) {
            let lead_s = lead.as_secs_f64();
            return Err(
                Failure::argument(format!("lead_s is {lead_s}"), "Give 0.05 to 60 s.").into(),
            );
        }
        let interpolation = wire_interpolation(source.interpolation());
        let options = FeedOptions {
            track,
            lead,
            interpolation,
            ..FeedOptions::default()
        };
        Ok(Self {
            address,
            source,
            options,
            shared: Arc::default(),
            running: None,
            report: None,
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
        let py = slf.py();
        let mut feed = slf.borrow_mut();
        if feed.running.is_some() || feed.report.is_some() {
            return Err(Failure::new(
                Class::Feed,
                "this feed was used before",
                "Make another one.",
            )
            .into());
        }
        let (address, source, options) = (feed.address.clone(), feed.source.clone(), feed.options);
        let shared = Arc::clone(&feed.shared);
        let running = Running::start(py, move |begun| {
            run(&address, &source, options, &shared, begun)
        });
        // Where Python was interrupted, the thread still runs.
        feed.shared.stop.store(running.is_err(), Ordering::Relaxed);
        feed.running = Some(running?);
        drop(feed);
        Ok(slf)
    }

    /// Waits until it is played, at most timeout_s [s]; without it, for as long as it takes. Returns the report, or None when it still runs.
    ///
    /// Raises FeedError, RequestError or LinkError if the daemon does not follow it to its end.
    #[pyo3(signature = (timeout_s = None))]
    fn wait(&mut self, py: Python<'_>, timeout_s: Option<f64>) -> PyResult<Option<FeedReport>> {
        let until = timeout_s
            .map(|timeout_s| seconds("timeout_s", timeout_s))
            .transpose()?
            .map(|timeout| Instant::now() + timeout);
        while let Some(running) = &self.running
            && !running.is_finished()
        {
            let now = Instant::now();
            if until.is_some_and(|until| now >= until) {
                return Ok(None);
            }
            let next = now + TURN;
            sleep_until(py, until.map_or(next, |until| until.min(next)))?;
        }
        if let Some(running) = self.running.take() {
            self.report = Some(running.join(py)?.into());
        }
        Ok(self.report.clone())
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

    #[pyo3(signature = (kind: "object" = None, _error: "object" = None, _trace: "object" = None, /))]
    fn __exit__(
        &mut self,
        py: Python<'_>,
        kind: Option<Py<PyAny>>,
        _error: Option<Py<PyAny>>,
        _trace: Option<Py<PyAny>>,
    ) -> PyResult<()> {
        self.shared.stop.store(true, Ordering::Relaxed);
        let ended = self.wait(py, None);
        // What happened in the `with` comes first.
        if kind.is_none() {
            ended.map(|_| ())
        } else {
            Ok(())
        }
    }
}

impl Drop for Feed {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        if let Some(running) = self.running.take() {
            running.abandon(());
        }
    }
}

fn run(
    address: &Address,
    source: &Source,
    options: FeedOptions,
    shared: &Shared,
    begun: &Sender<bool>,
) -> Result<Report, Failure> {
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
        if shared.stop.load(Ordering::Relaxed) {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    })?;
    if !has_begun {
        let _ = begun.send(true);
    }
    // The lease is given back: the robot holds within a few cycles.
    until_it_holds(&mut connection.telemetry()?)?;
    Ok(report)
}
