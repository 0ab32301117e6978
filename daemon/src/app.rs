//! The composition root: the one place that knows every concrete type.
//!
//! Order at the start: build everything → lock memory → warm the solver → priority, core, stack → first
//! release. Order at the end: the robot comes to rest → threads end → ports close → files
//! go.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::{Builder, JoinHandle, Thread};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use cdcr_controller::plant::KinematicPlant;
use cdcr_shared_types::codes::realtime;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use crate::config::{LinkKind, REST_MAX_S, RealtimeMode, Validated, ns};
use crate::cycle::{Cycle, Settings};
use crate::exchange::{Exchange, UnfinishedFiles, services};
use crate::exit::{Ended, ExitCause};
use crate::instance::Instance;
use crate::link::{DriverLink, SimulatedRobot};
use crate::ports::{Clock, RobotLink};
use crate::rt::clock::MonotonicClock;
use crate::rt::handoff::{CycleEnds, ExchangeEnds, Shared, channels};
use crate::rt::privileges::{ThreadPlan, choose_core, keep_awake, lock_memory, stay_off_core};
use crate::rt::schedule::Schedule;
use crate::rt::scheduler::this_thread;
use crate::supervisor::Supervisor;

/// How long a thread may take to get ready.
const START_TIMEOUT: Duration = Duration::from_secs(10);
/// Time between the last preparation and the first release \[ns\].
const START_DELAY_NS: u64 = 10_000_000;
/// Time beyond the ramp itself \[s\].
const REST_SLACK_S: f64 = 0.5;
/// How long the threads of a start that failed may take to end.
const GIVE_UP: Duration = Duration::from_secs(2);
/// Stack of a real-time thread.
const STACK_BYTES: usize = 2 * 1024 * 1024;

/// Runs the daemon until a signal ends it.
///
/// # Errors
/// When it cannot start, or a thread ended by itself.
pub fn run(validated: &Validated) -> Result<()> {
    let ending = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        signal_hook::flag::register(signal, Arc::clone(&ending)).context("signals")?;
    }
    run_until(validated, || ending.load(Ordering::Relaxed), |life| life())
}

/// What is put around the life of the cycle thread. It has to call its argument once.
pub type CycleWatch = fn(&mut dyn FnMut());

/// Runs the daemon until `should_end` says so. `watch` is put around the life of the cycle thread, for
/// tests that observe it from inside; see [`count_allocations`](crate::rt::sys::count_allocations).
///
/// # Errors
/// As [`run`].
pub fn run_until(
    validated: &Validated,
    should_end: impl FnMut() -> bool,
    watch: CycleWatch,
) -> Result<()> {
    let _instance = Instance::claim(&validated.location, &validated.config.robot.name)?;
    match validated.config.link.kind {
        LinkKind::Simulated => {
            let plant = KinematicPlant::new(&validated.robot, validated.initial)
                .with_extrapolate_max_s(validated.config.link.command_valid_ms * 1e-3);
            run_with(validated, SimulatedRobot::new(plant), should_end, watch)
        }
        LinkKind::Driver => run_with(validated, DriverLink, should_end, watch),
    }
}

fn run_with<L: RobotLink + Send + 'static>(
    validated: &Validated,
    link: L,
    should_end: impl FnMut() -> bool,
    watch: CycleWatch,
) -> Result<()> {
    let daemon_id = random_id();
    let shared = Arc::new(Shared::default());
    let (cycle_ends, exchange_ends, supervisor_ends) = channels(Settings::new(&validated.config));
    let clock = MonotonicClock;
    let node = services::node(&validated.location)?;
    let mut supervisor = Supervisor::new(&node, validated, supervisor_ends, daemon_id, &clock)?;

    let exchange = spawn_exchange(validated, exchange_ends, &shared, daemon_id)?;
    let cycle = Cycle::new(validated, link).context("the solver")?;
    let waker = exchange.handle.thread().clone();
    let cycle = spawn_cycle(validated, cycle, cycle_ends, &shared, waker, watch)?;

    let missing = match arm(validated, [&exchange, &cycle]) {
        Ok(missing) => missing,
        Err(error) => {
            // Both threads end when their starter goes, and clean up. One that hangs is left behind.
            give_up([cycle, exchange]);
            return Err(error);
        }
    };
    let pinned = missing & (realtime::PINNED | realtime::OFF) == 0;
    let core = choose_core(&validated.config.realtime).filter(|_| pinned);
    supervisor.set_realtime(missing, core, &clock);
    stay_off_core(core);
    // Held open for the whole run: closing it gives the processor its sleep back.
    let _awake = keep_awake(&validated.config.realtime);
    let schedule = Schedule::new(
        clock.now_ns() + START_DELAY_NS,
        ns(validated.config.cycle.period_ms),
    )
    .with_spin(ns(validated.config.realtime.spin_us * 1e-3));
    shared.set_origin_ns(schedule.release_ns(0));
    exchange.go(&schedule);
    cycle.go(&schedule);
    announce(validated);
    supervisor.run(&clock, &shared, should_end, || {
        // A thread that ends by itself takes the process with it.
        if cycle.handle.is_finished() || exchange.handle.is_finished() {
            shared.end();
        }
        if cycle.handle.is_finished() {
            shared.set_cycle_ended();
        }
        if exchange.handle.is_finished() {
            // It has ended, and does not hang: only the cycle is watched on.
            shared.beat_exchange();
        }
        cycle.handle.is_finished() && exchange.handle.is_finished()
    })?;
    cycle.join()?;
    exchange.join()?;
    if shared.is_still_moving() {
        bail!(Ended {
            cause: ExitCause::NotAtRest,
            message: format!(
                "the robot was still commanded to move when the time to come to rest was over ({REST_MAX_S} s at \
                 most): motion.deceleration_rad_s2 = {} is too small for its rates",
                validated.config.motion.deceleration_rad_s2
            ),
        });
    }
    tracing::info!("ended");
    Ok(())
}

/// Lets the threads of a start that failed end.
fn give_up(threads: [Started; 2]) {
    let handles = threads.map(|thread| thread.handle);
    let begin = Instant::now();
    while begin.elapsed() < GIVE_UP && !handles.iter().all(JoinHandle::is_finished) {
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// Cycles that the robot has to come to rest: its longest ramp, and a little more.
fn cycles_to_rest(validated: &Validated) -> u64 {
    let rates = validated.robot.sections().iter().map(|s| s.rate_max_rad_s);
    let ramp_s = rates.fold(0.0, f64::max) / validated.config.motion.deceleration_rad_s2;
    let rest_s = (ramp_s + REST_SLACK_S).min(REST_MAX_S);
    (rest_s * 1e3 / validated.config.cycle.period_ms).ceil() as u64
}

fn announce(validated: &Validated) {
    tracing::info!(
        robot = validated.config.robot.name,
        prefix = validated.location.prefix(),
        root = %validated.location.root().display(),
        sections = validated.robot.section_count(),
        period_ms = validated.config.cycle.period_ms,
        "running"
    );
}

/// Locks memory and makes the threads real-time. Returns what is missing.
fn arm(validated: &Validated, threads: [&Started; 2]) -> Result<u32> {
    for thread in threads {
        thread.wait_ready()?;
    }
    let config = &validated.config.realtime;
    let mut missing = lock_memory(config.mode);
    for thread in threads {
        missing |= thread.arm()?;
    }
    if config.mode == RealtimeMode::Require && missing != 0 {
        let lines: Vec<_> = realtime::ALL
            .iter()
            .filter(|(bit, _, _)| missing & bit != 0)
            .map(|(_, name, remedy)| format!("  {name} is missing: {remedy}"))
            .collect();
        bail!(Ended {
            cause: ExitCause::NotRealtime,
            message: format!(
                "realtime.mode is \"require\", but the system does not grant it:\n{}\n\
                 or set realtime.mode = \"prefer\" to run without",
                lines.join("\n")
            ),
        });
    }
    Ok(missing)
}

fn spawn_exchange(
    validated: &Validated,
    ends: ExchangeEnds,
    shared: &Arc<Shared>,
    daemon_id: u64,
) -> Result<Started> {
    let plan = ThreadPlan::new(
        &validated.config.realtime,
        validated.config.realtime.exchange_priority,
    );
    let name = "cdcr-exchange";
    let (starter, stage) = start_stages();
    let (validated, shared) = (validated.clone(), Arc::clone(shared));
    let handle = Builder::new()
        .name(name.to_owned())
        .stack_size(STACK_BYTES)
        .spawn(move || {
            // iceoryx2's ports stay in the thread that made them.
            let built = services::node(&validated.location).and_then(|node| {
                let ports = services::Ports::create(&node, &validated.config.robot.name)?;
                Ok((node, ports))
            });
            let (node, ports) = match built {
                Ok(built) => built,
                Err(error) => return stage.fail(error.into()),
            };
            let mut exchange = Exchange::new(&validated, ports, ends, daemon_id);
            if let Some(schedule) = stage.prepare(plan, || ()) {
                exchange.run(&schedule, &MonotonicClock, &shared);
            }
            drop(exchange);
            UnfinishedFiles::new(validated.location.file_prefix()).clear();
            drop(node);
        })?;
    Ok(Started {
        handle,
        starter,
        name,
    })
}

fn spawn_cycle<L: RobotLink + Send + 'static>(
    validated: &Validated,
    mut cycle: Cycle<L>,
    mut ends: CycleEnds,
    shared: &Arc<Shared>,
    exchange: Thread,
    watch: CycleWatch,
) -> Result<Started> {
    let plan = ThreadPlan::new(
        &validated.config.realtime,
        validated.config.realtime.cycle_priority,
    );
    let name = "cdcr-cycle";
    let (starter, stage) = start_stages();
    let shared = Arc::clone(shared);
    let cycles_to_rest = cycles_to_rest(validated);
    let handle = Builder::new()
        .name(name.to_owned())
        .stack_size(STACK_BYTES)
        .spawn(move || {
            let clock = MonotonicClock;
            shared.set_cycle_thread(this_thread());
            if let Some(mut schedule) = stage.prepare(plan, || cycle.warm_up(&clock)) {
                watch(&mut || {
                    run_cycles(
                        &mut cycle,
                        &mut ends,
                        &mut schedule,
                        &clock,
                        &shared,
                        &exchange,
                        cycles_to_rest,
                    );
                });
            }
            shared.set_cycle_ended();
            exchange.unpark();
        })?;
    Ok(Started {
        handle,
        starter,
        name,
    })
}

/// The life of the cycle thread: sleep to the release, run the cycle, hand the record on, wake the
/// exchange. When the process ends, the robot is brought to rest first.
pub fn run_cycles<L: RobotLink>(
    cycle: &mut Cycle<L>,
    ends: &mut CycleEnds,
    schedule: &mut Schedule,
    clock: &impl Clock,
    shared: &Shared,
    exchange: &Thread,
    cycles_to_rest: u64,
) {
    let mut cycles_to_rest = cycles_to_rest;
    while cycles_to_rest > 0 {
        let release = schedule.wait(clock);
        if shared.is_ending() {
            cycle.shut_down();
            cycles_to_rest = if cycle.is_at_rest() {
                0
            } else {
                cycles_to_rest - 1
            };
        }
        shared.beat_cycle();
        let inputs = ends.inputs.read();
        let record = cycle.run(release, inputs, || ends.requests.pop().ok(), clock);
        if ends.records.push(record).is_err() {
            shared.count_dropped_record();
        }
        exchange.unpark();
    }
    shared.set_still_moving(!cycle.is_at_rest());
}

/// A thread that was started.
#[derive(Debug)]
struct Started {
    handle: JoinHandle<()>,
    starter: Starter,
    name: &'static str,
}

/// The main thread's end of a thread that gets ready step by step.
#[derive(Debug)]
struct Starter {
    ready: Receiver<Result<()>>,
    arm: Sender<()>,
    armed: Receiver<u32>,
    go: Sender<Schedule>,
}

/// The thread's own end.
#[derive(Debug)]
struct Stage {
    ready: Sender<Result<()>>,
    arm: Receiver<()>,
    armed: Sender<u32>,
    go: Receiver<Schedule>,
}

fn start_stages() -> (Starter, Stage) {
    let (ready_in, ready_out) = channel();
    let (arm_in, arm_out) = channel();
    let (armed_in, armed_out) = channel();
    let (go_in, go_out) = channel();
    let starter = Starter {
        ready: ready_out,
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

impl Started {
    fn wait_ready(&self) -> Result<()> {
        let answer = self.starter.ready.recv_timeout(START_TIMEOUT);
        answer.with_context(|| format!("the thread {} did not get ready", self.name))?
    }

    /// Lets the thread become real-time; returns what is missing.
    fn arm(&self) -> Result<u32> {
        // A thread that is gone does not answer, either.
        let _ = self.starter.arm.send(());
        let answer = self.starter.armed.recv_timeout(START_TIMEOUT);
        answer.with_context(|| format!("the thread {} did not become real-time", self.name))
    }

    fn go(&self, schedule: &Schedule) {
        // A thread that ended meanwhile is found by the supervisor.
        let _ = self.starter.go.send(schedule.clone());
    }

    /// Waits for its end. A thread that was not told to go gives up when its starter goes.
    fn join(self) -> Result<()> {
        drop(self.starter);
        match self.handle.join() {
            Ok(()) => Ok(()),
            Err(_) => bail!(Ended {
                cause: ExitCause::Panicked,
                message: format!("the thread {} panicked", self.name),
            }),
        }
    }
}

impl Stage {
    fn fail(&self, error: anyhow::Error) {
        let _ = self.ready.send(Err(error));
    }

    /// Ready → (memory is locked) → warm up → priority and core → the schedule. None: the start was
    /// given up.
    fn prepare(&self, plan: ThreadPlan, warm_up: impl FnOnce()) -> Option<Schedule> {
        self.ready.send(Ok(())).ok()?;
        self.arm.recv().ok()?;
        warm_up();
        let missing = plan.apply();
        self.armed.send(missing).ok()?;
        self.go.recv().ok()
    }
}

/// An identity for this run, never 0.
fn random_id() -> u64 {
    use std::hash::{BuildHasher, Hasher, RandomState};
    RandomState::new().build_hasher().finish().max(1)
}
