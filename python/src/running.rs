//! Threads that feed until they are told to stop.

use std::process;
use std::sync::mpsc::{Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use cdcr_client::{TelemetryStream, monotonic_ns};
use cdcr_shared_types::codes::Mode;
use pyo3::prelude::*;

use crate::errors::{Class, Failure};
use crate::worker::{ended, forked, refuse_forked_process, sleep_until, spawn, wait};

/// How often a thread that feeds, and who waits for one, looks again: about once a cycle.
pub(crate) const TURN: Duration = Duration::from_millis(5);
/// How long the robot may take to hold once the lease is given back, on a machine that stalls.
const HOLDS_WITHIN: Duration = Duration::from_secs(2);

/// A thread that runs until it is told to stop, and what came of it.
pub(crate) struct Running<T> {
    thread: JoinHandle<Result<T, Failure>>,
    process_id: u32,
}

impl<T: Send + 'static> Running<T> {
    /// Starts it, and waits until it says that it has begun, by a true.
    pub(crate) fn start(
        py: Python<'_>,
        run: impl FnOnce(&Sender<bool>) -> Result<T, Failure> + Send + 'static,
    ) -> PyResult<Self> {
        refuse_forked_process()?;
        let (begun, has_begun) = channel();
        let thread = spawn("cdcr-feed", move || {
            let outcome = run(&begun);
            let _ = begun.send(false);
            outcome
        })?;
        let running = Self {
            thread,
            process_id: process::id(),
        };
        if wait(py, has_begun)? {
            return Ok(running);
        }
        running.join(py).and_then(|_| Err(ended().into()))
    }

    /// Also where the thread is another process's.
    pub(crate) fn is_finished(&self) -> bool {
        self.thread.is_finished() || self.process_id != process::id()
    }

    /// Waits for its end.
    pub(crate) fn join(self, py: Python<'_>) -> PyResult<T> {
        if self.process_id != process::id() {
            std::mem::forget(self);
            return Err(forked().into());
        }
        while !self.is_finished() {
            sleep_until(py, Instant::now() + TURN)?;
        }
        let outcome = self.thread.join();
        Ok(outcome.map_err(|_| ended())??)
    }
}

impl<T> Running<T> {
    /// Lets go of it. A process that was forked has no such thread, and must not touch what belongs to one.
    pub(crate) fn abandon<P>(self, port: P) {
        if self.process_id != process::id() {
            std::mem::forget((self, port));
        }
    }
}

/// Waits until a record says that the robot is not tracking any more.
pub(crate) fn until_it_holds(telemetry: &mut TelemetryStream) -> Result<(), Failure> {
    let begin_ns = monotonic_ns();
    let until = Instant::now() + HOLDS_WITHIN;
    loop {
        let left = until.saturating_duration_since(Instant::now());
        match telemetry.next_within(left)? {
            Some(record) if record.start_ns < begin_ns => {}
            Some(record) if record.mode != Mode::Tracking.code() => return Ok(()),
            Some(_) if !left.is_zero() => {}
            _ => {
                return Err(Failure::new(
                    Class::Link,
                    format!(
                        "the feed has ended, and the daemon did not say within {HOLDS_WITHIN:?} that the robot holds"
                    ),
                    "Look with cdcrctl status; cdcrctl stop stops the robot.",
                ));
            }
        }
    }
}
