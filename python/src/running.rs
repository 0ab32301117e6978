//! A thread that feeds from the begin of a `with` to its end.

use std::process;
use std::sync::mpsc::{Sender, channel};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use cdcr_client::{TelemetryStream, monotonic_ns};
use cdcr_shared_types::Service;
use cdcr_shared_types::codes::Mode;
use pyo3::prelude::*;

use crate::address::Address;
use crate::errors::{Class, Failure};
use crate::worker::{Closed, TURN, ended, forked, refuse_forked_process, sleep_until, spawn, wait};

/// Time limit for the robot to hold after the lease is returned, on a machine that stalls.
const HOLDS_WITHIN: Duration = Duration::from_secs(2);

/// A feeding thread and its result. It can be started once.
pub(crate) struct Running<T> {
    /// Name of the user's object: "feed" or "stream".
    what: &'static str,
    stage: Mutex<Stage<T>>,
    process_id: u32,
}

enum Stage<T> {
    New,
    Runs(JoinHandle<Result<T, Failure>>),
    Ended(Result<T, Failure>),
}

impl<T: Clone + Send + 'static> Running<T> {
    pub(crate) fn new(what: &'static str) -> Self {
        Self {
            what,
            stage: Mutex::new(Stage::New),
            process_id: process::id(),
        }
    }

    /// Starts the thread, unless the connection is closed, and waits until it reports true when it has begun. When Python is
    /// interrupted meanwhile, `give_up` ends the thread.
    pub(crate) fn begin(
        &self,
        py: Python<'_>,
        closed: &Closed,
        run: impl FnOnce(&Sender<bool>) -> Result<T, Failure> + Send + 'static,
        give_up: impl FnOnce(),
    ) -> PyResult<()> {
        refuse_forked_process()?;
        let awaited = closed.begin_thread()?;
        let (begun, has_begun) = channel();
        {
            let mut stage = self.stage()?;
            if !matches!(*stage, Stage::New) {
                return Err(self.failure("has begun before", "Make another one.").into());
            }
            *stage = Stage::Runs(spawn("cdcr-feed", move || {
                let outcome = run(&begun);
                let _ = begun.send(false);
                drop(awaited);
                outcome
            })?);
        }
        if wait(py, has_begun).inspect_err(|_| give_up())? {
            return Ok(());
        }
        self.wait(py, None)?;
        Err(ended().into())
    }

    /// Waits for the end, at most until a time; `None` if there is no outcome yet.
    pub(crate) fn wait(&self, py: Python<'_>, until: Option<Instant>) -> PyResult<Option<T>> {
        loop {
            if let Some(outcome) = self.outcome()? {
                return Ok(Some(outcome?));
            }
            let now = Instant::now();
            if until.is_some_and(|until| now >= until) {
                return Ok(None);
            }
            let next = now + TURN;
            sleep_until(py, until.map_or(next, |until| until.min(next)))?;
        }
    }

    /// The result, once the thread has ended.
    fn outcome(&self) -> Result<Option<Result<T, Failure>>, Failure> {
        let mut stage = self.stage()?;
        *stage = match std::mem::replace(&mut *stage, Stage::New) {
            Stage::New => {
                let remedy = format!("Use the {0} in a `with`: it begins there.", self.what);
                return Err(self.failure("has not begun", remedy));
            }
            Stage::Runs(thread) if thread.is_finished() => {
                Stage::Ended(thread.join().unwrap_or_else(|_| Err(ended())))
            }
            stage => stage,
        };
        match &*stage {
            Stage::Ended(outcome) => Ok(Some(outcome.clone())),
            _ => Ok(None),
        }
    }

    /// "new", "running" or "ended".
    pub(crate) fn word(&self) -> &'static str {
        match self.stage().as_deref() {
            Ok(Stage::New) => "new",
            Ok(Stage::Runs(_)) => "running",
            Ok(Stage::Ended(_)) | Err(_) => "ended",
        }
    }

    pub(crate) fn failure(&self, what_is: &str, remedy: impl ToString) -> Failure {
        Failure::new(Class::Feed, format!("the {} {what_is}", self.what), remedy)
    }

    pub(crate) fn is_forked(&self) -> bool {
        self.process_id != process::id()
    }

    /// A forked process has no such thread, and the lock may be held for ever.
    fn stage(&self) -> Result<MutexGuard<'_, Stage<T>>, Failure> {
        if self.is_forked() {
            return Err(forked());
        }
        Ok(self.stage.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl<T> Drop for Running<T> {
    fn drop(&mut self) {
        if self.process_id != process::id() {
            let stage = self.stage.get_mut().unwrap_or_else(PoisonError::into_inner);
            std::mem::forget(std::mem::replace(stage, Stage::New));
        }
    }
}

/// Result of leaving a `with`: an exception raised in it takes precedence.
pub(crate) fn exit_result<T>(happened: Option<&Py<PyAny>>, ended: PyResult<T>) -> PyResult<()> {
    match happened {
        None => ended.map(|_| ()),
        Some(_) => Ok(()),
    }
}

/// Waits for a record in which the robot is not tracking.
pub(crate) fn wait_until_holding(
    address: &Address,
    telemetry: &mut TelemetryStream,
) -> Result<(), Failure> {
    let begin_ns = monotonic_ns();
    let until = Instant::now() + HOLDS_WITHIN;
    loop {
        let left = until.saturating_duration_since(Instant::now());
        match telemetry.next_within(left)? {
            Some(record) if record.start_ns < begin_ns => {}
            Some(record) if record.mode != Mode::Tracking.code() => return Ok(()),
            Some(_) if !left.is_zero() => {}
            _ => {
                address.check_runs(Service::Telemetry, HOLDS_WITHIN)?;
                return Err(Failure::new(
                    Class::Link,
                    format!(
                        "the feed has ended, and the daemon did not report within {HOLDS_WITHIN:?} that the robot holds"
                    ),
                    "See the mode with cdcrctl status; cdcrctl stop stops the robot.",
                ));
            }
        }
    }
}
