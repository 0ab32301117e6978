//! Client processes, readers that never read, and busy cores; each ends by itself.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use cdcr_client::{Connection, TelemetryStream};
use cdcr_tests::{Place, Program};
use rustix::process::Signal;

/// Client processes at one time: the services have eight readers, some of which are needed elsewhere.
const PROCESSES_MAX: usize = 3;

/// The present clients and threads.
#[derive(Debug, Default)]
pub(crate) struct Crowd {
    processes: Vec<(Program, Option<Instant>)>,
    idle: Vec<(TelemetryStream, Instant)>,
    threads: Vec<JoinHandle<()>>,
    ending: Arc<AtomicBool>,
}

impl Crowd {
    /// Ends those whose time is over.
    pub(crate) fn tend(&mut self) {
        let now = Instant::now();
        self.idle.retain(|(_, until)| *until > now);
        for (program, thaw) in &mut self.processes {
            if thaw.take_if(|thaw| *thaw <= now).is_some() {
                program.signal(Signal::CONT);
            }
        }
        self.processes.retain_mut(|(program, _)| program.runs());
        self.threads.retain(|thread| !thread.is_finished());
    }

    /// Starts a `cdcrctl`; ends the oldest one when there are too many.
    pub(crate) fn start(&mut self, place: &Place, arguments: &[&str]) {
        if self.processes.len() == PROCESSES_MAX {
            self.kill();
        }
        let program = Program::start(place.command("cdcrctl").args(arguments));
        self.processes.push((program, None));
    }

    /// Whether there is any client process.
    pub(crate) fn is_empty(&self) -> bool {
        self.processes.is_empty()
    }

    /// Kills the oldest client process.
    pub(crate) fn kill(&mut self) {
        drop(self.processes.remove(0));
    }

    /// Stops the newest client process for a while.
    pub(crate) fn freeze(&mut self, duration: Duration) {
        if let Some((program, thaw)) = self.processes.last_mut() {
            program.signal(Signal::STOP);
            *thaw = Some(Instant::now() + duration);
        }
    }

    /// Opens the telemetry without reading it.
    pub(crate) fn idle(&mut self, connection: &Connection, duration: Duration) {
        // Skipped when all places of readers are taken.
        if let Ok(stream) = connection.telemetry() {
            self.idle.truncate(1);
            self.idle.push((stream, Instant::now() + duration));
        }
    }

    /// Repeats `work` in a thread for a while.
    pub(crate) fn busy(&mut self, duration: Duration, work: impl FnMut() + Send + 'static) {
        self.busy_with(duration, || Some(work));
    }

    /// Calls `make` in a thread, and then repeats its result for a while.
    pub(crate) fn busy_with<W: FnMut()>(
        &mut self,
        duration: Duration,
        make: impl FnOnce() -> Option<W> + Send + 'static,
    ) {
        let (until, ending) = (Instant::now() + duration, self.ending.clone());
        self.threads.push(std::thread::spawn(move || {
            let Some(mut work) = make() else {
                return;
            };
            while Instant::now() < until && !ending.load(Ordering::Relaxed) {
                work();
            }
        }));
    }
}

impl Drop for Crowd {
    fn drop(&mut self) {
        self.ending.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}
