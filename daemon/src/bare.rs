//! The bare loop: the latencies of the cycle thread of a configuration, without any work.
//!
//! It uses the daemon's own code: thread plan, order at the start, grid, and evaluation of lateness. Any
//! additional lateness in `cdcrd run` is caused by the daemon.
//!
//! Invariant: nothing here knows a robot or shared memory; only the summary uses terms of the messages. After
//! the first release nothing allocates until the loop is over.

mod summary;

use std::hint::black_box;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use cdcr_shared_types::BareSummary;

use crate::accounting::{Accounting, Totals};
use crate::config::{Config, Validated, ns};
use crate::exit::{Ended, ExitCause};
use crate::handover::Policy;
use crate::rt::attribution::{Attribution, CauseAssignment, EvaluatedCycle, Scheduling, Timing};
use crate::rt::clock::Clock;
use crate::rt::clock::MonotonicClock;
use crate::rt::schedule::Lateness;
use crate::rt::schedule::{Release, Schedule};
use crate::rt::scheduler::{SchedulerDeltas, this_thread};
use crate::start::{self, Started, abandon_threads, arm, end_signals};
use crate::system::with_core;

/// Largest number of recorded cycles: 800 MB of memory.
pub const CYCLES_MAX: u64 = 10_000_000;
/// Time between two checks of the main thread for the end of the loop.
const CHECK_INTERVAL: Duration = Duration::from_millis(20);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BareCycle {
    pub release: Release,
    /// The clock, read right after the start \[ns\].
    pub handed_over_ns: u64,
    pub lateness: Lateness,
    pub assignment: CauseAssignment,
    /// Scheduler statistics of the thread since the previous cycle; `None` if not available.
    pub interference: Option<Interference>,
}

/// Scheduler statistics of the thread during one cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Interference {
    /// Time ready to run while another task had the core \[ns\].
    pub run_delay_ns: u64,
    /// Page faults, minor and major.
    pub page_faults: u32,
}

impl From<&Scheduling> for Interference {
    fn from(scheduling: &Scheduling) -> Self {
        Self {
            run_delay_ns: scheduling.run_delay_ns,
            page_faults: scheduling.page_faults,
        }
    }
}

/// Result of a completed loop.
#[derive(Debug, Clone)]
pub struct Outcome {
    pub summary: BareSummary,
    /// Cycles, oldest first.
    pub cycles: Vec<BareCycle>,
}

/// Runs the loop for `duration`, or until a signal ends it.
pub fn run(validated: &Validated, duration: Duration) -> Result<Outcome> {
    let ending = end_signals()?;
    run_until(validated, duration, || ending.load(Ordering::Relaxed))
}

/// Runs the loop for `duration`, or until `should_end`.
pub fn run_until(
    validated: &Validated,
    duration: Duration,
    mut should_end: impl FnMut() -> bool,
) -> Result<Outcome> {
    let config = &with_core(validated).config;
    let recorder = Recorder::new(config, last_cycle(config, duration)?)?;
    let ending = Arc::new(AtomicBool::new(false));
    let thread = spawn(config, recorder, &ending)?;
    let armed = match arm(&config.realtime, &[&thread]) {
        Ok(armed) => armed,
        Err(error) => {
            abandon_threads([thread]);
            return Err(error);
        }
    };
    thread.start_loop(&start::schedule(config, &MonotonicClock));
    tracing::info!(
        period_ms = config.cycle.period_ms,
        "running the loop without work"
    );
    while !thread.is_finished() {
        if should_end() {
            ending.store(true, Ordering::Relaxed);
        }
        std::thread::sleep(CHECK_INTERVAL);
    }
    let recorder = thread.join()?;
    Ok(Outcome {
        summary: summary::summary(config, &recorder, armed.missing, armed.core)?,
        cycles: recorder.cycles,
    })
}

fn spawn(
    config: &Config,
    mut recorder: Recorder,
    ending: &Arc<AtomicBool>,
) -> Result<Started<Recorder>> {
    let plan = start::plan(&config.realtime, config.realtime.cycle_priority);
    let ending = Arc::clone(ending);
    Started::spawn("cdcr-cycle", move |stage| {
        let mut deltas = SchedulerDeltas::new(Some(this_thread()));
        if let Some(mut schedule) = stage.prepare(plan, || ()) {
            recorder.run(&mut schedule, &MonotonicClock, &mut deltas, &ending);
        }
        recorder
    })
}

/// The number of the last cycle on the grid.
fn last_cycle(config: &Config, duration: Duration) -> Result<u64> {
    let period_ms = config.cycle.period_ms;
    let periods = duration.as_nanos() / u128::from(ns(period_ms));
    let problem = match u64::try_from(periods) {
        Ok(0) => "is shorter than one period",
        Ok(periods) if periods <= CYCLES_MAX => return Ok(periods),
        _ => "exceeds 10 million cycles",
    };
    bail!(Ended {
        cause: ExitCause::Usage,
        message: format!(
            "invalid --duration {}: it {problem}, with cycle.period_ms = {period_ms}; use {} s to {} s",
            humantime::format_duration(duration),
            period_ms / 1e3,
            CYCLES_MAX as f64 * period_ms / 1e3
        ),
    })
}

/// Evaluates and records the cycles of the bare loop.
#[derive(Debug)]
struct Recorder {
    last_cycle: u64,
    /// Time before its release at which the thread wakes up \[ns\].
    spin_ns: u64,
    accounting: Accounting,
    attribution: Attribution,
    cycles: Vec<BareCycle>,
}

impl Recorder {
    /// A recorder up to `last_cycle` on the grid. Allocates and touches all memory.
    fn new(config: &Config, last_cycle: u64) -> Result<Self> {
        Ok(Self {
            last_cycle,
            spin_ns: config.realtime.spin_ns(config.cycle.period_ms),
            accounting: Accounting::new(Policy::new(config).limits()),
            attribution: Attribution::default(),
            cycles: memory(last_cycle as usize)?,
        })
    }

    /// The life of the thread: sleep until the release, read the clock, evaluate, record.
    fn run(
        &mut self,
        schedule: &mut Schedule,
        clock: &impl Clock,
        deltas: &mut SchedulerDeltas,
        ending: &AtomicBool,
    ) {
        // Discards the statistics before the first cycle.
        deltas.read();
        let mut newest = 0;
        while newest < self.last_cycle && !ending.load(Ordering::Relaxed) {
            let release = schedule.wait(clock);
            let handed_over_ns = clock.now_ns();
            newest = release.cycle;
            let lateness = self.accounting.evaluate(&release, handed_over_ns, false);
            let scheduling = deltas.read();
            let evaluated = self.evaluated(&release, handed_over_ns, lateness);
            // Within the capacity: cycle numbers increase, and only the last one exceeds the limit.
            self.cycles.push(BareCycle {
                release,
                handed_over_ns,
                lateness,
                assignment: self.attribution.evaluate(&evaluated, scheduling.as_ref()),
                interference: scheduling.as_ref().map(Interference::from),
            });
        }
    }

    /// The times of a cycle that concern its lateness: its whole computation is one reading of the clock.
    fn evaluated(
        &self,
        release: &Release,
        handed_over_ns: u64,
        lateness: Lateness,
    ) -> EvaluatedCycle {
        let compute_ns = handed_over_ns - release.start_ns;
        EvaluatedCycle {
            count: self.totals().cycles,
            lateness,
            skipped: release.skipped,
            timing: Timing {
                early_ns: self.spin_ns,
                woke_early: false,
                wake_ns: release.start_ns - release.due_ns,
                compute_ns,
                planned_ns: 0,
                longest_gap_ns: compute_ns,
                after_solve_ns: 0,
            },
        }
    }

    fn totals(&self) -> &Totals {
        self.accounting.totals()
    }
}

/// An empty list with capacity for `count` cycles and resident pages.
fn memory(count: usize) -> Result<Vec<BareCycle>> {
    // Not zeros: the kernel allocates zeroed pages only when they are touched.
    let touched = BareCycle {
        release: Release {
            cycle: u64::MAX,
            ..Release::default()
        },
        handed_over_ns: u64::MAX,
        lateness: Lateness::default(),
        assignment: CauseAssignment::InTime,
        interference: None,
    };
    let mut cycles = Vec::new();
    cycles.try_reserve_exact(count).with_context(|| {
        format!("not enough memory to record {count} cycles: use a shorter duration")
    })?;
    cycles.resize(count, touched);
    black_box(&mut cycles).clear();
    Ok(cycles)
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;
    use cdcr_shared_types::codes::LateCause;

    const MS: u64 = 1_000_000;

    /// A clock that advances only by sleeps. The sleep until the release `late.0` ends late by `late.1`
    /// \[ns\].
    struct Simulated {
        now: Cell<u64>,
        late: (u64, u64),
    }

    impl Clock for Simulated {
        fn now_ns(&self) -> u64 {
            self.now.get()
        }

        fn sleep_until(&self, time_ns: u64) {
            let (release_ns, late_ns) = self.late;
            let late_ns = if time_ns == release_ns { late_ns } else { 0 };
            self.now.set(self.now.get().max(time_ns) + late_ns);
        }
    }

    /// A loop of 5 ms up to `last_cycle`, on a grid with the origin 0.
    fn run(last_cycle: u64, late: (u64, u64), ending: bool) -> Recorder {
        let mut recorder = Recorder::new(&Config::default(), last_cycle).unwrap();
        let clock = Simulated {
            now: Cell::new(0),
            late,
        };
        let capacity = recorder.cycles.capacity();
        let mut schedule = Schedule::new(0, 5 * MS);
        let mut deltas = SchedulerDeltas::default();
        recorder.run(&mut schedule, &clock, &mut deltas, &AtomicBool::new(ending));
        assert_eq!(recorder.cycles.capacity(), capacity, "nothing is allocated");
        recorder
    }

    #[test]
    fn a_punctual_loop_has_every_cycle_once() {
        let recorder = run(100, (0, 0), false);
        let numbers: Vec<u64> = recorder.cycles.iter().map(|c| c.release.cycle).collect();
        assert_eq!(numbers, (1..=100).collect::<Vec<_>>());
        for cycle in &recorder.cycles {
            assert_eq!(cycle.release.due_ns, cycle.release.cycle * 5 * MS);
            assert_eq!(cycle.handed_over_ns, cycle.release.start_ns);
            assert_eq!(cycle.assignment, CauseAssignment::InTime);
        }
    }

    #[test]
    fn a_stall_is_one_late_cycle_with_its_cause_and_what_it_skipped() {
        let recorder = run(100, (50 * MS, 12 * MS), false);
        let totals = Totals {
            cycles: 98,
            late_starts: 1,
            deadline_misses: 1,
            skipped_periods: 2,
        };
        assert_eq!(*recorder.totals(), totals);
        let late = recorder.cycles[9];
        assert_eq!((late.release.cycle, late.release.due_ns), (12, 50 * MS));
        assert_eq!(late.assignment, CauseAssignment::Own(LateCause::Platform));
        assert_eq!(recorder.cycles[10].assignment, CauseAssignment::InTime);
    }

    #[test]
    fn a_stall_over_the_end_ends_the_loop() {
        let recorder = run(100, (500 * MS, 73 * MS), false);
        assert_eq!(recorder.cycles.len(), 100);
        assert_eq!(recorder.cycles[99].release.cycle, 114);
    }

    #[test]
    fn a_loop_that_is_to_end_keeps_what_there_is() {
        let recorder = run(100, (0, 0), true);
        assert!(recorder.cycles.is_empty());
        let summary = summary::summary(&Config::default(), &recorder, 0, Some(1)).unwrap();
        assert_eq!((summary.cycles, summary.duration_s), (0, 0.0));
        assert_eq!(summary.wake.max_ns, 0);
    }

    #[test]
    fn a_duration_has_a_cycle_at_least_and_ten_million_at_most() {
        let mut config = Config::default();
        let last = |config: &Config, duration| last_cycle(config, duration);
        let millis = Duration::from_millis;
        assert_eq!(last(&config, millis(5)).unwrap(), 1);
        assert_eq!(last(&config, millis(504)).unwrap(), 100);
        assert_eq!(last(&config, millis(50_000_000)).unwrap(), CYCLES_MAX);
        config.cycle.period_ms = 0.1;
        assert_eq!(last(&config, millis(1)).unwrap(), 10);
        config.cycle.period_ms = 5.0;
        for (duration, word) in [
            (Duration::ZERO, "shorter"),
            (millis(4), "shorter"),
            (millis(50_000_005), "10 million"),
            (Duration::MAX, "10 million"),
        ] {
            let error = last(&config, duration).unwrap_err();
            assert_eq!(ExitCause::from_error(&error), ExitCause::Usage);
            let message = error.to_string();
            assert!(message.contains(word), "{message}");
            assert!(message.contains("0.005 s to 50000 s"), "{message}");
        }
    }
}
