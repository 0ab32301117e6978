//! The composition root: the only module that knows every concrete type.
//!
//! Order at the start: build everything → lock memory → warm the solver → priority, core, stack → first
//! release. Order at the end: the robot comes to rest → threads end → ports close → files are removed.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::Thread;

use anyhow::{Context, Result, bail};
use cdcr_controller::safety::{Mode, Reason};
use cdcr_shared_types::codes::realtime;
use rtrb::Producer;
use signal_hook::consts::{SIGHUP, SIGUSR1};

use crate::caretaker::Caretaker;
use crate::config::{REST_MAX_S, Validated};
use crate::core_budget::KERNEL_SHARE;
use crate::cycle::Cycle;
use crate::exchange::Exchange;
use crate::exit::{Ended, ExitCause};
use crate::handover::{
    ChangedSettings, CycleEnds, ExchangeEnds, ReporterEnds, RuntimeSettings, Shared, channels,
};
use crate::instance::Instance;
use crate::kept_obstacles::KeptObstacles;
use crate::latch::Latch;
use crate::link::CycleRobot;
use crate::reload::{ReadConfig, Reload};
use crate::reporter::Reporter;
use crate::rt::clock::Clock;
use crate::rt::clock::MonotonicClock;
use crate::rt::privileges::raise_above_ordinary_tasks;
use crate::rt::schedule::Schedule;
use crate::rt::scheduler::this_thread;
use crate::rt::sys::take_signal;
use crate::services;
use crate::start::{self, Started, abandon_threads, arm, end_signals};
use crate::status_thread::StatusThread;
use crate::supervisor::Supervisor;
use crate::system::{System, with_core};

/// Time beyond the ramp itself \[s\].
const REST_SLACK_S: f64 = 0.5;

/// Runs the daemon with the configuration from `read` until a signal ends it. `SIGHUP` reloads the
/// configuration.
pub fn run(read: ReadConfig) -> Result<()> {
    let validated = read()?;
    let ending = end_signals()?;
    let should_end = || ending.load(Ordering::Relaxed);
    claim_and_run(&validated, read, should_end, |life| life())
}

/// A wrapper around the life of the cycle thread. It must call its argument once.
pub type CycleThreadHook = fn(&mut dyn FnMut());

/// Runs the daemon until `should_end`. `hook` wraps the life of the cycle thread, for tests that observe it
/// from inside; see [`count_allocations`](crate::rt::sys::count_allocations). `SIGHUP` changes nothing.
pub fn run_until(
    validated: &Validated,
    should_end: impl FnMut() -> bool,
    hook: CycleThreadHook,
) -> Result<()> {
    let same = validated.clone();
    let read = Box::new(move || Ok(same.clone()));
    claim_and_run(validated, read, should_end, hook)
}

fn claim_and_run(
    given: &Validated,
    read: ReadConfig,
    should_end: impl FnMut() -> bool,
    hook: CycleThreadHook,
) -> Result<()> {
    let validated = &with_core(given);
    // Before any process can find this one by its lock: these signals would end it.
    let signals = Signals::catch()?;
    start::raise_open_files()?;
    let (location, robot) = (&validated.location, &validated.config.robot.name);
    let instance = Instance::claim(location, robot, validated.group_id)?;
    let Signals { stop, reload } = signals;
    let shared = Arc::new(Shared::new(stop, instance.latch()));
    let reload = |settings| Reload::new(reload, read, &given.config, settings);
    let ended = run_with(validated, &instance, &shared, reload, should_end, hook);
    // The cycle handles no further signals.
    take_signal(SIGUSR1, true);
    if shared.take_stop() {
        shared.latch.stop_asked();
    }
    ended
}

fn run_with(
    validated: &Validated,
    instance: &Instance,
    shared: &Arc<Shared>,
    reload: impl FnOnce(Producer<ChangedSettings>) -> Reload,
    mut should_end: impl FnMut() -> bool,
    hook: CycleThreadHook,
) -> Result<()> {
    let daemon_id = random_id();
    let ends = channels(RuntimeSettings::new(&validated.config));
    let clock = MonotonicClock;
    let mut supervisor = Supervisor::new(validated, ends.supervisor, daemon_id, &clock)?;

    let cycle = as_left_before(make_cycle(validated, &clock)?, shared.latch);
    let reporter = spawn_reporter(validated, ends.reporter, shared, daemon_id)?;
    // In sequence: each of them checks the free space for itself.
    if let Err(error) = reporter.wait_ready() {
        abandon_threads([reporter]);
        return Err(error);
    }
    let kept = instance.kept_obstacles();
    let exchange = match spawn_exchange(validated, ends.exchange, shared, daemon_id, kept) {
        Ok(exchange) => exchange,
        Err(error) => {
            abandon_threads([reporter]);
            return Err(error);
        }
    };
    let waker = exchange.thread().clone();
    let cycle = match spawn_cycle(validated, cycle, ends.cycle, shared, waker, hook) {
        Ok(cycle) => cycle,
        Err(error) => {
            abandon_threads([exchange, reporter]);
            return Err(error);
        }
    };

    // Held until the threads have ended.
    let armed = match arm(&validated.config.realtime, &[&reporter, &exchange, &cycle]) {
        Ok(armed) => armed,
        Err(error) => {
            abandon_threads([cycle, exchange, reporter]);
            return Err(error);
        }
    };
    supervisor.set_realtime(armed.missing, armed.core, &clock);
    if armed.missing & (realtime::FIFO | realtime::OFF) == 0 {
        raise_above_ordinary_tasks();
    }
    // At this point, because the thread inherits the core and the priority of the calling thread.
    let beside = StatusThread::start(validated, ends.status_thread, shared).and_then(|desk| {
        // All services exist now.
        let place = instance.watch(&validated.config.robot.name);
        let caretaker = Caretaker::start(place, reload(ends.reloaded), Arc::clone(shared))?;
        Ok((desk, caretaker))
    });
    let (desk, caretaker) = match beside {
        Ok(beside) => beside,
        Err(error) => {
            abandon_threads([cycle, exchange, reporter]);
            return Err(error);
        }
    };
    let schedule = start::schedule(&validated.config, &clock);
    shared.set_origin_ns(schedule.release_ns(0));
    reporter.start_loop(&schedule);
    exchange.start_loop(&schedule);
    cycle.start_loop(&schedule);
    announce(validated);
    let should_end = || should_end() || caretaker.lost().is_some();
    supervisor.run(&clock, shared, &desk, should_end, || {
        caretaker.wake_if_asked();
        // A thread that ends by itself ends the process.
        let ended = [&cycle, &exchange, &reporter].map(Started::is_finished);
        if ended.contains(&true) || desk.is_finished() {
            shared.end();
        }
        if desk.is_finished() {
            shared.status_beats.add(1);
        }
        if cycle.is_finished() {
            shared.cycle_ended.set(true);
        }
        // An ended thread does not hang: only the others are monitored further.
        if exchange.is_finished() {
            shared.exchange_ended.set(true);
            shared.exchange_beats.add(1);
        }
        if reporter.is_finished() {
            shared.reporter_beats.add(1);
        }
        ended == [true; 3]
    })?;
    drop(desk);
    cycle.join()?;
    exchange.join()?;
    reporter.join()?;
    check_end(validated, shared, caretaker.lost())?;
    tracing::info!("ended");
    Ok(())
}

/// Checks that the daemon ended as requested, with the robot at rest.
fn check_end(validated: &Validated, shared: &Shared, lost: Option<&Path>) -> Result<()> {
    if shared.still_moving.is_set() {
        bail!(Ended {
            cause: ExitCause::NotAtRest,
            message: format!(
                "the robot did not come to rest within {REST_MAX_S} s: motion.deceleration_rad_s2 = {} is too small \
                 for its rates; increase it",
                validated.config.motion.deceleration_rad_s2
            ),
        });
    }
    if shared.last_word_moves.is_set() {
        bail!(Ended {
            cause: ExitCause::NotAtRest,
            message: "cannot publish the command to rest: the last published command still moves the robot, which \
                      holds when it expires (link.command_valid_ms)"
                .to_owned(),
        });
    }
    if let Some(lost) = lost {
        bail!(Ended {
            cause: ExitCause::PlaceLost,
            message: format!(
                "the root folder {} was emptied or replaced while the daemon ran ({} is missing or replaced), so \
                 clients cannot reach it: the robot came to rest, the process ends",
                validated.location.root().display(),
                lost.display()
            ),
        });
    }
    Ok(())
}

/// Requests by signals, except the end.
#[derive(Debug)]
struct Signals {
    /// `SIGUSR1`: stop the robot.
    stop: Arc<AtomicBool>,
    /// `SIGHUP`: reload the configuration.
    reload: Arc<AtomicBool>,
}

impl Signals {
    fn catch() -> Result<Self> {
        Ok(Self {
            stop: start::flag_of(&[SIGUSR1])?,
            reload: start::flag_of(&[SIGHUP])?,
        })
    }
}

/// The cycle of a configuration whose parts fit into the period on this machine.
fn make_cycle(validated: &Validated, clock: &impl Clock) -> Result<Cycle> {
    let share = System::this().kernel_share().unwrap_or_else(|error| {
        let error = error.to_string();
        tracing::info!(
            error,
            "cannot read the core share of real-time threads: assuming 95 %"
        );
        None
    });
    let link = CycleRobot::new(validated).context("the simulated robot")?;
    let cycle = Cycle::new(validated, link).context("the solver")?;
    // Without a limit, the kernel's default: otherwise the other tasks on the core would starve.
    let mut cycle = cycle.with_kernel_share(share.unwrap_or(KERNEL_SHARE));
    cycle.check_that_it_fits(clock).map_err(|message| Ended {
        cause: ExitCause::Configuration,
        message,
    })?;
    Ok(cycle)
}

/// Number of cycles for the robot to come to rest: its longest ramp, and a reserve.
fn cycles_to_rest(validated: &Validated) -> u64 {
    let config = &validated.config;
    let ramp_s = config.robot.fastest_rad_s() / config.motion.deceleration_rad_s2;
    let rest_s = (ramp_s + REST_SLACK_S).min(REST_MAX_S);
    (rest_s * 1e3 / config.cycle.period_ms).ceil() as u64
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

fn spawn_exchange(
    validated: &Validated,
    ends: ExchangeEnds,
    shared: &Arc<Shared>,
    daemon_id: u64,
    kept: KeptObstacles,
) -> Result<Started> {
    let realtime = &validated.config.realtime;
    let plan = start::plan(realtime, realtime.exchange_priority);
    let (validated, shared) = (validated.clone(), Arc::clone(shared));
    Started::spawn("cdcr-exchange", move |stage| {
        // iceoryx2's ports stay in the thread that created them.
        let built = services::node(&validated.location).and_then(|node| {
            let ports = services::Ports::create(&node, &validated.config.robot.name)?;
            Ok((node, ports))
        });
        let (node, ports) = match built {
            Ok(built) => built,
            Err(error) => return stage.fail(error.into()),
        };
        let exchange = Exchange::new(&validated, ports, ends, daemon_id);
        let mut exchange = exchange.keeping(kept);
        if let Some(schedule) = stage.prepare(plan, || ()) {
            exchange.run(&schedule, &MonotonicClock, &shared);
        }
        shared.exchange_ended.set(true);
        drop(exchange);
        drop(node);
    })
}

fn spawn_reporter(
    validated: &Validated,
    ends: ReporterEnds,
    shared: &Arc<Shared>,
    daemon_id: u64,
) -> Result<Started> {
    let plan = start::plan_beside(&validated.config.realtime);
    let (validated, shared) = (validated.clone(), Arc::clone(shared));
    Started::spawn("cdcr-reporter", move |stage| {
        let built = services::node(&validated.location).and_then(|node| {
            let telemetry = services::telemetry(&node, &validated.config.robot.name)?;
            Ok((node, telemetry))
        });
        let (node, telemetry) = match built {
            Ok(built) => built,
            Err(error) => return stage.fail(error.into()),
        };
        let mut reporter = Reporter::new(&validated, telemetry, ends, daemon_id);
        if stage.prepare(plan, || ()).is_some() {
            reporter.run(&MonotonicClock, &shared);
        }
        drop(reporter);
        drop(node);
    })
}

fn spawn_cycle(
    validated: &Validated,
    mut cycle: Cycle,
    mut ends: CycleEnds,
    shared: &Arc<Shared>,
    exchange: Thread,
    hook: CycleThreadHook,
) -> Result<Started> {
    let realtime = &validated.config.realtime;
    let plan = start::plan(realtime, realtime.cycle_priority);
    let shared = Arc::clone(shared);
    let cycles_to_rest = cycles_to_rest(validated);
    Started::spawn("cdcr-cycle", move |stage| {
        let clock = MonotonicClock;
        shared.set_cycle_thread(this_thread());
        if let Some(mut schedule) = stage.prepare(plan, || cycle.warm_up(&clock)) {
            take_signal(SIGUSR1, true);
            hook(&mut || {
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
        shared.cycle_ended.set(true);
        exchange.unpark();
    })
}

/// A cycle that starts latched where the previous daemon was, and with an uncertain pose where that daemon left it so.
fn as_left_before(cycle: Cycle, latch: Latch) -> Cycle {
    let Some(reported) = latch.describe() else {
        return cycle;
    };
    tracing::warn!(
        "the robot was {reported} before this daemon started and not reset since: it stays stopped until \
         `cdcrctl reset`"
    );
    let is_uncertain = latch.is_pose_uncertain();
    if is_uncertain {
        tracing::warn!(
            "it was measured far from where its last command had left it: the reset has to accept the pose \
             (`cdcrctl reset --accept-pose`)"
        );
    }
    let reason = if latch.has_lost_obstacles() {
        Reason::ObstaclesLost
    } else {
        Reason::StoppedBefore
    };
    cycle.stopped_before(reason).uncertain_pose(is_uncertain)
}

/// The life of the cycle thread: sleep until the release, run the cycle, hand over the record, wake the
/// exchange. At the end of the process the robot first comes to rest.
pub fn run_cycles(
    cycle: &mut Cycle,
    ends: &mut CycleEnds,
    schedule: &mut Schedule,
    clock: &impl Clock,
    shared: &Shared,
    exchange: &Thread,
    cycles_to_rest: u64,
) {
    let mut cycles_to_rest = cycles_to_rest;
    let mut mode = Mode::default();
    while cycles_to_rest > 0 {
        let release = schedule.wait_with(clock, |number, due_ns| {
            cycle.rehearse(number, due_ns, ends.inputs.read(), clock);
        });
        if shared.is_ending() {
            cycle.shut_down();
            cycles_to_rest = if cycle.is_at_rest() {
                0
            } else {
                cycles_to_rest - 1
            };
        }
        if shared.take_stop() {
            cycle.stop();
        }
        shared.cycle_beats.add(1);
        let inputs = ends.inputs.read();
        ends.records.send(|memory| {
            let next_request = || ends.requests.pop().ok();
            let record = cycle.run_into(memory, release, inputs, next_request, clock);
            // Before any other thread receives the record.
            keep_latched(shared.latch, mode, record.mode);
            if record.mode.is_latched() {
                shared.latch.set_pose_uncertain(record.seen.pose_differs);
            }
            mode = record.mode;
        });
        exchange.unpark();
        cycle.rest(clock);
    }
    shared.still_moving.set(!cycle.is_at_rest());
}

/// Keeps a stop or a fault beyond the process until a reset. The end of the daemon is not a stop, and a latch
/// found at the start remains.
fn keep_latched(latch: Latch, before: Mode, now: Mode) {
    let is_of_itself = matches!(
        now.reason(),
        Reason::Shutdown | Reason::StoppedBefore | Reason::ObstaclesLost
    );
    if now.is_latched() && now != before && !is_of_itself {
        latch.set(now.into(), now.reason().into());
        return;
    }
    // A latch found at the start may be reset within the first cycle with a measurement.
    let reason = Reason::Request;
    let was_latched =
        before.is_latched() || (before, now) == (Mode::Starting, Mode::Holding { reason });
    if was_latched && !now.is_latched() {
        latch.clear();
    }
}

/// An identity for this run, never 0.
fn random_id() -> u64 {
    use std::hash::{BuildHasher, Hasher, RandomState};
    RandomState::new().build_hasher().finish().max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reset_in_the_first_measured_cycle_clears_the_latch_and_motion_never_does() {
        let folder = cdcr_scratch::Scratch::in_memory().unwrap();
        let latch = Latch::open(&folder.path().join("a.latch")).unwrap();
        let reason = Reason::Request;
        latch.stop_asked();
        // A stop during motion that no cycle has seen yet.
        keep_latched(latch, Mode::Homing, Mode::Homing);
        keep_latched(latch, Mode::Homing, Mode::Holding { reason });
        keep_latched(
            latch,
            Mode::Starting,
            Mode::Stopped {
                reason: Reason::StoppedBefore,
            },
        );
        assert!(latch.describe().is_some());
        keep_latched(latch, Mode::Starting, Mode::Holding { reason });
        assert_eq!(latch.describe(), None);
    }
}
