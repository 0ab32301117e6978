//! A thread that owns objects that must stay on one thread. Python sends it requests from any thread, without
//! the interpreter's lock, and checks for signals while it waits.

use std::process;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use pyo3::prelude::*;

use crate::errors::{Class, Failure};

/// Interval at which a waiting Python checks for signals.
pub(crate) const SIGNALS_EACH: Duration = Duration::from_millis(50);
/// Longest job of a thread with other work, or one that may be closed meanwhile: longer ones are divided.
pub(crate) const SLICE: Duration = Duration::from_millis(20);

/// Interval between checks of other threads, and of Python waiting for one: about one cycle.
pub(crate) const TURN: Duration = Duration::from_millis(5);
/// Time limit for the feeds of a closed connection. They wait 2 s for the robot to hold.
const THREADS_END_WITHIN: Duration = Duration::from_secs(4);

type Job<D> = Box<dyn FnOnce(&mut D) + Send>;

/// The thread with its desk, which is created and dropped on it.
pub(crate) struct Worker<D: 'static> {
    open: Mutex<Option<Open<D>>>,
    closed: Closed,
    process_id: u32,
}

/// Whether close() was called, for what was made from a connection and has a thread of its own.
#[derive(Clone, Default)]
pub(crate) struct Closed {
    is_set: Arc<AtomicBool>,
    /// Such threads that run.
    threads: Arc<AtomicUsize>,
}

/// A thread that close() waits for, until this is dropped.
pub(crate) struct AwaitedThread(Closed);

impl Closed {
    pub(crate) fn is_set(&self) -> bool {
        self.is_set.load(Ordering::SeqCst)
    }

    pub(crate) fn check(&self) -> Result<(), Failure> {
        if self.is_set() {
            return Err(closed());
        }
        Ok(())
    }

    /// Counts before it checks: close() either sees the thread or refuses it.
    pub(crate) fn begin_thread(&self) -> Result<AwaitedThread, Failure> {
        self.threads.fetch_add(1, Ordering::SeqCst);
        let thread = AwaitedThread(self.clone());
        self.check()?;
        Ok(thread)
    }

    fn wait_for_threads(&self, py: Python<'_>) -> PyResult<()> {
        let until = Instant::now() + THREADS_END_WITHIN;
        while self.threads.load(Ordering::SeqCst) > 0 && Instant::now() < until {
            sleep_until(py, Instant::now() + TURN)?;
        }
        Ok(())
    }
}

impl Drop for AwaitedThread {
    fn drop(&mut self) {
        self.0.threads.fetch_sub(1, Ordering::SeqCst);
    }
}

struct Open<D> {
    jobs: Sender<Job<D>>,
    thread: JoinHandle<()>,
}

impl<D: 'static> Worker<D> {
    /// Starts the thread and creates its desk.
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
                // Fails if Python was interrupted meanwhile: then nothing will be asked.
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
            closed: Closed::default(),
            process_id: process::id(),
        })
    }

    /// Runs a computation on the thread and waits for the result.
    pub(crate) fn call_on_thread<T: Send + 'static>(
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

    /// Repeats a request, at most a slice at a time, until it returns a value or the time is over.
    pub(crate) fn poll_on_thread<T: Send + 'static>(
        &self,
        py: Python<'_>,
        until: Instant,
        job: impl Fn(&mut D, Duration) -> Result<Option<T>, Failure> + Clone + Send + 'static,
    ) -> PyResult<Option<T>> {
        loop {
            let left = until.saturating_duration_since(Instant::now());
            let (job, slice) = (job.clone(), left.min(SLICE));
            let answer = self.call_on_thread(py, move |desk| job(desk, slice))??;
            if answer.is_some() || left.is_zero() {
                return Ok(answer);
            }
            py.check_signals()?;
        }
    }

    fn jobs(&self) -> Result<Sender<Job<D>>, Failure> {
        // In a forked process the lock may be held for ever.
        if self.process_id != process::id() {
            return Err(forked());
        }
        let open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        match &*open {
            Some(open) => Ok(open.jobs.clone()),
            None => Err(closed()),
        }
    }

    pub(crate) fn closed(&self) -> &Closed {
        &self.closed
    }

    /// Ends the thread, waits until it has dropped everything, and then for the threads of what was made from it. A second call
    /// waits for these only.
    pub(crate) fn close(&self, py: Python<'_>) -> PyResult<()> {
        if self.process_id != process::id() {
            return Ok(());
        }
        self.closed.is_set.store(true, Ordering::SeqCst);
        let open = self
            .open
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        if let Some(open) = open {
            py.detach(|| end(open));
        }
        self.closed.wait_for_threads(py)
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
            // A forked process has no such thread, and the lock of the channel may be held for ever.
            std::mem::forget(open);
        }
    }
}

fn end<D>(open: Open<D>) {
    drop(open.jobs);
    // A thread that panicked has nothing left to drop.
    let _ = open.thread.join();
}

/// Runs a computation on a new thread and waits for the result.
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

/// A thread of this module. Python handles signals in its main thread only.
pub(crate) fn spawn<T: Send + 'static>(
    name: &str,
    run: impl FnOnce() -> T + Send + 'static,
) -> PyResult<JoinHandle<T>> {
    Ok(thread::Builder::new().name(name.to_owned()).spawn(run)?)
}

/// Waits for an answer, and checks for signals meanwhile.
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

/// Waits until a time, or until a signal interrupts.
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

/// Rejects a forked process: the shared memory belongs to its parent.
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

fn closed() -> Failure {
    Failure::new(
        Class::Link,
        "the connection or driver is closed",
        "Make another one, with cdcr.connect().",
    )
}

pub(crate) fn ended() -> Failure {
    Failure::new(
        Class::Link,
        "the thread of the connection has ended",
        "Connect again.",
    )
}
