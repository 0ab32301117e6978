//! Start of real-time threads, the same for the daemon and for `cdcrd bare`.
//!
//! ```text
//! each thread: ready ─► (memory is locked) ─► warm up ─► priority, core, stack ─► schedule ─► first release
//! ```

use std::cell::Cell;
use std::fs::File;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::{Builder, JoinHandle, Thread};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use cdcr_shared_types::codes::realtime;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use signal_hook::consts::{SIGINT, SIGTERM};

use crate::config::{Config, RealtimeConfig, RealtimeMode, ns};
use crate::exit::{Ended, ExitCause};
use crate::rt::clock::Clock;
use crate::rt::privileges::{
    ThreadPlan, last_core, lock_memory, prevent_deep_sleep, stay_off_core,
};
use crate::rt::schedule::Schedule;

/// Time limit for a thread to get ready.
const START_TIMEOUT: Duration = Duration::from_secs(10);
/// Time between the last preparation and the origin of the grid \[ns\].
const START_DELAY_NS: u64 = 10_000_000;
/// Time limit for the threads of a failed start to end.
const ABANDON_TIMEOUT: Duration = Duration::from_secs(2);
const STACK_BYTES: usize = 1024 * 1024;

/// Files that a daemon opens before its first client: 53 were counted.
const OPEN_FILES_MIN: u64 = 64;
/// Files that a daemon and all possible clients open: 30 clients of the status needed 60.
const OPEN_FILES: u64 = 1024;

/// Raises the limit of open files to the number that clients may need, as far as permitted.
pub(crate) fn raise_open_files() -> Result<()> {
    let limit = getrlimit(Resource::Nofile);
    let mut granted = limit.current.unwrap_or(u64::MAX);
    let wanted = limit
        .maximum
        .map_or(OPEN_FILES, |most| most.min(OPEN_FILES));
    let current = Some(wanted);
    if granted < wanted && setrlimit(Resource::Nofile, Rlimit { current, ..limit }).is_ok() {
        granted = wanted;
    }
    if granted < OPEN_FILES_MIN {
        bail!(Ended {
            cause: ExitCause::SharedMemory,
            message: format!(
                "this process can open only {granted} files, but a daemon needs {OPEN_FILES_MIN}, and up to \
                 {OPEN_FILES} with clients: raise the limit with ulimit -n {OPEN_FILES} (LimitNOFILE of a unit, --ulimit nofile={OPEN_FILES} of a container)"
            ),
        });
    }
    Ok(())
}

/// A flag set by the signals that end the process.
pub(crate) fn end_signals() -> Result<Arc<AtomicBool>> {
    flag_of(&[SIGINT, SIGTERM])
}

/// A flag set by any of these signals.
pub(crate) fn flag_of(signals: &[i32]) -> Result<Arc<AtomicBool>> {
    let flag = Arc::new(AtomicBool::new(false));
    for signal in signals {
        signal_hook::flag::register(*signal, Arc::clone(&flag)).context("signals")?;
    }
    Ok(flag)
}

/// The core of the real-time threads: the configured one, or else the last one that the process may use.
pub(crate) fn core(config: &RealtimeConfig) -> Option<usize> {
    usize::try_from(config.core).ok().or_else(last_core)
}

/// The plan of a real-time thread with `priority`; an ordinary thread if real time is off.
pub(crate) fn plan(config: &RealtimeConfig, priority: i32) -> ThreadPlan {
    if config.mode == RealtimeMode::Off {
        return ThreadPlan::default();
    }
    ThreadPlan::real_time(core(config), priority)
}

/// The plan of a thread that works for the real-time threads, off their core.
pub(crate) fn plan_beside(config: &RealtimeConfig) -> ThreadPlan {
    if config.mode == RealtimeMode::Off {
        return ThreadPlan::default();
    }
    ThreadPlan::beside(core(config))
}

/// Properties that the system granted to the real-time threads. Prevents deep sleep of the processor until
/// dropped.
#[derive(Debug)]
pub(crate) struct Armed {
    /// The [`realtime`] bits of missing properties.
    pub(crate) missing: u32,
    /// The core of the threads, if they are pinned.
    pub(crate) core: Option<usize>,
    /// Closing it permits deep sleep again.
    _awake: Option<File>,
}

/// Waits until the threads are ready, locks memory, makes the threads real-time, and excludes the calling
/// thread from their core.
pub(crate) fn arm<T>(config: &RealtimeConfig, threads: &[&Started<T>]) -> Result<Armed> {
    for thread in threads {
        thread.wait_ready()?;
    }
    let is_off = config.mode == RealtimeMode::Off;
    let mut missing = if is_off { realtime::OFF } else { lock_memory() };
    for thread in threads {
        missing |= thread.arm()?;
    }
    if config.mode == RealtimeMode::Require && missing != 0 {
        bail!(not_granted(missing));
    }
    let pinned = missing & (realtime::PINNED | realtime::OFF) == 0;
    let core = core(config).filter(|_| pinned);
    log_missing_privileges(missing, core);
    stay_off_core(core);
    Ok(Armed {
        missing,
        core,
        _awake: (!is_off && config.no_deep_sleep)
            .then(prevent_deep_sleep)
            .flatten(),
    })
}

fn not_granted(missing: u32) -> Ended {
    let lines: Vec<_> = realtime::set(missing)
        .map(|(name, remedy)| format!("  {name} is missing: {remedy}"))
        .collect();
    Ended {
        cause: ExitCause::NotRealtime,
        message: format!(
            "realtime.mode is \"require\", but the system does not grant real time:\n\
             {}\n\
             or set realtime.mode = \
             \"prefer\" to run without it",
            lines.join("\n")
        ),
    }
}

fn log_missing_privileges(missing: u32, core: Option<usize>) {
    if missing == 0 {
        tracing::info!(?core, "real time: SCHED_FIFO, pinned, memory locked");
    }
    for (name, remedy) in realtime::set(missing) {
        tracing::warn!("not real time: {name} is missing; {remedy}");
    }
}

/// The grid of the armed threads: its first release is a period and 10 ms from now.
pub(crate) fn schedule(config: &Config, clock: &impl Clock) -> Schedule {
    let period_ns = ns(config.cycle.period_ms);
    Schedule::new(clock.now_ns() + START_DELAY_NS, period_ns)
        .with_spin(config.realtime.spin_ns(config.cycle.period_ms))
}

/// Ends the threads of a failed start, and abandons those that hang.
pub(crate) fn abandon_threads<T, const N: usize>(threads: [Started<T>; N]) {
    // Each thread ends and cleans up when its starter is dropped.
    let handles = threads.map(|thread| thread.handle);
    let begin = Instant::now();
    while begin.elapsed() < ABANDON_TIMEOUT && !handles.iter().all(JoinHandle::is_finished) {
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// A started thread and its result.
#[derive(Debug)]
pub(crate) struct Started<T = ()> {
    handle: JoinHandle<T>,
    starter: Starter,
    name: &'static str,
}

/// The main thread's end of the start protocol.
#[derive(Debug)]
struct Starter {
    ready: Receiver<Result<()>>,
    is_ready: Cell<bool>,
    arm: Sender<()>,
    armed: Receiver<u32>,
    go: Sender<Schedule>,
}

#[derive(Debug)]
pub(crate) struct Stage {
    ready: Sender<Result<()>>,
    arm: Receiver<()>,
    armed: Sender<u32>,
    go: Receiver<Schedule>,
}

fn stages() -> (Starter, Stage) {
    let (ready_in, ready_out) = channel();
    let (arm_in, arm_out) = channel();
    let (armed_in, armed_out) = channel();
    let (go_in, go_out) = channel();
    let starter = Starter {
        ready: ready_out,
        is_ready: Cell::new(false),
        arm: arm_in,
        armed: armed_out,
        go: go_in,
    };
    let stage = Stage {
        ready: ready_in,
        arm: arm_out,
        armed: armed_in,
        go: go_out,
    };
    (starter, stage)
}

impl<T: Send + 'static> Started<T> {
    /// Starts a thread that runs `life`.
    pub(crate) fn spawn(
        name: &'static str,
        life: impl FnOnce(Stage) -> T + Send + 'static,
    ) -> Result<Self> {
        let (starter, stage) = stages();
        let handle = Builder::new()
            .name(name.to_owned())
            .stack_size(STACK_BYTES)
            .spawn(move || life(stage))
            .with_context(|| format!("the thread {name}"))?;
        Ok(Self {
            handle,
            starter,
            name,
        })
    }
}

impl<T> Started<T> {
    /// Waits until the thread is ready; returns at once on later calls.
    pub(crate) fn wait_ready(&self) -> Result<()> {
        if !self.starter.is_ready.get() {
            let answer = self.starter.ready.recv_timeout(START_TIMEOUT);
            answer.with_context(|| format!("the thread {} did not start", self.name))??;
            self.starter.is_ready.set(true);
        }
        Ok(())
    }

    /// Makes the thread real-time; returns the missing properties.
    fn arm(&self) -> Result<u32> {
        // An ended thread does not answer either.
        let _ = self.starter.arm.send(());
        let answer = self.starter.armed.recv_timeout(START_TIMEOUT);
        answer.with_context(|| format!("the thread {} did not become real-time", self.name))
    }

    /// Lets the thread run on the grid.
    pub(crate) fn start_loop(&self, schedule: &Schedule) {
        // The monitoring thread detects a thread that has ended meanwhile.
        let _ = self.starter.go.send(schedule.clone());
    }

    pub(crate) fn is_finished(&self) -> bool {
        self.handle.is_finished()
    }

    /// The thread itself, to wake it up.
    pub(crate) fn thread(&self) -> &Thread {
        self.handle.thread()
    }

    /// Waits for the end of the thread. A thread not yet running on the grid ends when its starter is
    /// dropped.
    pub(crate) fn join(self) -> Result<T> {
        drop(self.starter);
        self.handle.join().map_err(|_| {
            let ended = Ended {
                cause: ExitCause::Panicked,
                message: format!("the thread {} panicked", self.name),
            };
            ended.into()
        })
    }
}

impl Stage {
    /// Reports that the thread cannot get ready.
    pub(crate) fn fail(&self, error: anyhow::Error) {
        let _ = self.ready.send(Err(error));
    }

    /// Ready → (memory is locked) → warm up → priority and core → the schedule. `None` if the start was
    /// abandoned.
    pub(crate) fn prepare(&self, plan: ThreadPlan, warm_up: impl FnOnce()) -> Option<Schedule> {
        self.ready.send(Ok(())).ok()?;
        self.arm.recv().ok()?;
        warm_up();
        let missing = plan.apply();
        self.armed.send(missing).ok()?;
        self.go.recv().ok()
    }
}
