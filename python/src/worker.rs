//! A thread that owns what must stay on one thread. Python asks it from any thread, without the interpreter's lock, and looks at
//! signals while it waits.

use std::process;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use pyo3::prelude::*;

use crate::errors::{Class, Failure};

/// How long Python waits before it looks at signals.
pub(crate) const SIGNALS_EACH: Duration = Duration::from_millis(50);
/// The longest job of a thread that has others to do, or may be closed meanwhile: what takes longer is done in slices.
pub(crate) const SLICE: Duration = Duration::from_millis(20);

type Job<D> = Box<dyn FnOnce(&mut D) + Send>;

/// The thread with its desk, which is made and dropped on it.
pub(crate) struct Worker<D: 'static> {
    open: Mutex<Option<Open<D>>>,
    process_id: u32,
}

struct Open<D> {
    jobs: Sender<Job<D>>,
    thread: JoinHandle<()>,
}

impl<D: 'static> Worker<D> {
    /// Starts the thread and makes its desk.
    pub(crate) fn start(
        py: Python<'_>,
        name: &str,
        make: impl FnOnce() -> Result<D, Failure> + Send + 'static,
    ) -> PyResult<Self> {
        refuse_forked_process()?;
        let (jobs, orders) = channel::<Job<D>>();
        let (made, is_made) = channel();
        let thread = spawn(name, move || match make() {
            Ok(mut desk) => {
                // Python may have been interrupted meanwhile: then nobody has orders.
                let _ = made.send(Ok(()));
                while let Ok(job) = orders.recv() {
                    job(&mut desk);
                }
            }
            Err(failure) => {
                let _ = made.send(Err(failure));
            }
        })?;
        wait(py, is_made)??;
        Ok(Self {
            open: Mutex::new(Some(Open { jobs, thread })),
            process_id: process::id(),
        })
    }

    /// Lets the thread compute something and waits for it.
    pub(crate) fn ask<T: Send + 'static>(
        &self,
        py: Python<'_>,
        job: impl FnOnce(&mut D) -> T + Send + 'static,
    ) -> PyResult<T> {
        let (answer, answered) = channel();
        let job = move |desk: &mut D| {
            let _ = answer.send(job(desk));
        };
        self.jobs()?.send(Box::new(job)).map_err(|_| ended())?;
        wait(py, answered)
    }

    /// Asks for at most a slice at a time until there is an answer, or until a time: then the last one is none.
    pub(crate) fn ask_until<T: Send + 'static>(
        &self,
        py: Python<'_>,
        until: Instant,
        job: impl Fn(&mut D, Duration) -> Result<Option<T>, Failure> + Clone + Send + 'static,
    ) -> PyResult<Option<T>> {
        loop {
            let left = until.saturating_duration_since(Instant::now());
            let (job, slice) = (job.clone(), left.min(SLICE));
            let answer = self.ask(py, move |desk| job(desk, slice))??;
            if answer.is_some() || left.is_zero() {
                return Ok(answer);
            }
            py.check_signals()?;
        }
    }

    fn jobs(&self) -> Result<Sender<Job<D>>, Failure> {
        // The lock of a process that was forked may be held for ever.
        if self.process_id != process::id() {
            return Err(forked());
        }
        let open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        match &*open {
            Some(open) => Ok(open.jobs.clone()),
            None => Err(Failure::new(
                Class::Link,
                "the connection or driver is closed",
                "Make another one, with cdcr.connect().",
            )),
        }
    }

    /// Ends the thread, and waits until everything that it had is given back. Closing twice changes nothing.
    pub(crate) fn close(&self, py: Python<'_>) {
        if self.process_id != process::id() {
            return;
        }
        let open = self
            .open
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        if let Some(open) = open {
            py.detach(|| end(open));
        }
    }
}

impl<D> Drop for Worker<D> {
    fn drop(&mut self) {
        let open = self.open.get_mut().unwrap_or_else(PoisonError::into_inner);
        let Some(open) = open.take() else {
            return;
        };
        if self.process_id == process::id() {
            end(open);
        } else {
            // A process that was forked has no such thread, and the lock of the channel may be held for ever.
            std::mem::forget(open);
        }
    }
}

fn end<D>(open: Open<D>) {
    drop(open.jobs);
    // A thread that panicked has nothing left to give back.
    let _ = open.thread.join();
}

/// Computes something on a thread of its own and waits for it.
pub(crate) fn once<T: Send + 'static>(
    py: Python<'_>,
    job: impl FnOnce() -> T + Send + 'static,
) -> PyResult<T> {
    refuse_forked_process()?;
    let (answer, answered) = channel();
    spawn("cdcr-once", move || {
        let _ = answer.send(job());
    })?;
    wait(py, answered)
}

/// A thread of this module. Python handles signals in its main thread alone.
pub(crate) fn spawn<T: Send + 'static>(
    name: &str,
    run: impl FnOnce() -> T + Send + 'static,
) -> PyResult<JoinHandle<T>> {
    Ok(thread::Builder::new().name(name.to_owned()).spawn(run)?)
}

/// Waits for an answer, and looks at signals meanwhile.
pub(crate) fn wait<T: Send>(py: Python<'_>, mut answered: Receiver<T>) -> PyResult<T> {
    loop {
        let answer;
        (answered, answer) = py.detach(move || {
            let answer = answered.recv_timeout(SIGNALS_EACH);
            (answered, answer)
        });
        match answer {
            Ok(answer) => return Ok(answer),
            Err(RecvTimeoutError::Timeout) => py.check_signals()?,
            Err(RecvTimeoutError::Disconnected) => return Err(ended().into()),
        }
    }
}

/// Waits until a time, or until a signal says otherwise.
pub(crate) fn sleep_until(py: Python<'_>, until: Instant) -> PyResult<()> {
    loop {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Ok(());
        }
        py.detach(|| thread::sleep(left.min(SIGNALS_EACH)));
        py.check_signals()?;
    }
}

/// Where Python may have come from a fork: the shared memory that its parent opened is the parent's.
pub(crate) fn refuse_forked_process() -> Result<(), Failure> {
    static FIRST: OnceLock<u32> = OnceLock::new();
    if *FIRST.get_or_init(process::id) == process::id() {
        return Ok(());
    }
    Err(forked())
}

pub(crate) fn forked() -> Failure {
    Failure::new(
        Class::Link,
        "this process was forked from one that had connected to a daemon; what that opened cannot be shared",
        "Start processes with multiprocessing.get_context(\"spawn\").",
    )
}

pub(crate) fn ended() -> Failure {
    Failure::new(
        Class::Link,
        "the thread of the connection has ended",
        "Connect again.",
    )
}
