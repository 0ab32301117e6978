//! Slow and textual: signals, statistics, status, log.
//!
//! Invariant: nothing here is in the way of the cycle. It runs at ordinary priority, and learns of the
//! cycles through a ring of [`Summary`] that never blocks who fills it.

use std::time::{Duration, Instant};

use cdcr_shared_types as wire;
use cdcr_shared_types::codes::{Mode, Outcome, Reason, realtime};
use hdrhistogram::Histogram;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::prelude::{Node, ipc};
use rtrb::Consumer;

use crate::config::{LinkKind, Validated, ns};
use crate::exchange::convert;
use crate::ports::Clock;
use crate::rt::accounting::{Totals, Verdict};
use crate::rt::handoff::Shared;

/// What the supervisor learns of a cycle.
#[derive(Debug, Clone, Copy)]
pub struct Summary {
    /// Number on the grid.
    pub cycle: u64,
    /// Release to start \[ns\].
    pub wake_ns: u64,
    /// The solver \[ns\].
    pub solve_ns: u64,
    /// Whether it ran.
    pub solved: bool,
    /// Whether the budget ended it.
    pub budget_hit: bool,
    /// Release to hand-over \[ns\].
    pub response_ns: u64,
    /// Whether the cycle was late.
    pub verdict: Verdict,
    /// Counts since the start.
    pub totals: Totals,
    /// Mode.
    pub mode: Mode,
    /// Why.
    pub reason: Reason,
    /// Faults since the start.
    pub faults: u64,
    /// Settings of the solver.
    pub settings: wire::SolverSettings,
    /// Holder of the lease, 0: nobody.
    pub lease_holder: u64,
    /// Last time of the reference \[ns\], 0: none.
    pub reference_end_ns: u64,
    /// Points ahead.
    pub reference_points: u32,
    /// Obstacles of this cycle.
    pub obstacle_count: u32,
    /// Obstacle updates refused since the start.
    pub obstacles_refused: u64,
    /// Smallest clearance \[m\].
    pub clearance_m: f64,
    /// Whether the clearance guard changed the command.
    pub clearance_guarded: bool,
    /// Events that no record took.
    pub dropped_events: u64,
    /// Messages by outcome.
    pub outcomes: [u64; Outcome::COUNT],
}

/// How often the supervisor looks.
const LOOK_EVERY: Duration = Duration::from_millis(20);
/// How often the status is published.
const STATUS_EVERY: Duration = Duration::from_millis(100);
/// Latencies above this are counted as this \[ns\].
const LATENCY_MAX_NS: u64 = 10_000_000_000;

/// The statistics of one latency.
#[derive(Debug)]
struct Latency(Histogram<u64>);

impl Latency {
    fn new() -> anyhow::Result<Self> {
        Ok(Self(Histogram::new_with_bounds(1, LATENCY_MAX_NS, 3)?))
    }

    fn record(&mut self, latency_ns: u64) {
        self.0.saturating_record(latency_ns);
    }

    fn summary(&self) -> wire::LatencySummary {
        wire::LatencySummary {
            count: self.0.len(),
            min_ns: if self.0.is_empty() { 0 } else { self.0.min() },
            p50_ns: self.0.value_at_quantile(0.5),
            p99_ns: self.0.value_at_quantile(0.99),
            p999_ns: self.0.value_at_quantile(0.999),
            max_ns: self.0.max(),
        }
    }
}

/// Watches the threads, and tells the world.
#[derive(Debug)]
pub struct Supervisor {
    summaries: Consumer<Summary>,
    publisher: Publisher<ipc::Service, wire::Status, ()>,
    status: wire::Status,
    budget_hits: u64,
    dropped_events: u64,
    wake: Latency,
    solve: Latency,
    response: Latency,
    last_mode: Mode,
    reported_misses: u64,
    last_report: Instant,
}

impl Supervisor {
    /// A supervisor that publishes the status of a daemon.
    ///
    /// # Errors
    /// When the status service cannot be created.
    pub fn new(
        node: &Node<ipc::Service>,
        validated: &Validated,
        summaries: Consumer<Summary>,
        daemon_id: u64,
    ) -> anyhow::Result<Self> {
        let name = &validated.config.robot.name;
        Ok(Self {
            summaries,
            publisher: crate::exchange::services::publisher(node, wire::Service::Status, name)?,
            status: first_status(validated, daemon_id),
            budget_hits: 0,
            dropped_events: 0,
            wake: Latency::new()?,
            solve: Latency::new()?,
            response: Latency::new()?,
            last_mode: Mode::Starting,
            reported_misses: 0,
            last_report: Instant::now(),
        })
    }

    /// Says what the system did not grant, and on which core the real-time threads run.
    pub fn set_realtime(&mut self, missing: u32, core: Option<usize>) {
        self.status.realtime_missing = missing;
        self.status.core = core.map_or(u32::MAX, |core| core as u32);
        if missing == 0 {
            tracing::info!(?core, "real time: SCHED_FIFO, pinned, memory locked");
        }
        for (_, name, remedy) in realtime::ALL
            .iter()
            .filter(|(bit, _, _)| missing & bit != 0)
        {
            tracing::warn!("not real time: {name} is missing; {remedy}");
        }
    }

    /// Watches until `is_over` says that the threads are done; asks them to end when `should_end`.
    pub fn run(
        &mut self,
        clock: &impl Clock,
        shared: &Shared,
        mut should_end: impl FnMut() -> bool,
        mut is_over: impl FnMut() -> bool,
    ) {
        let mut next_status = Instant::now();
        loop {
            let over = is_over();
            self.take_summaries();
            if over || Instant::now() >= next_status {
                next_status = Instant::now() + STATUS_EVERY;
                self.publish(clock, shared);
            }
            if over {
                return;
            }
            if !shared.is_ending() && should_end() {
                tracing::info!("ending: the robot comes to rest first");
                shared.end();
            }
            std::thread::sleep(LOOK_EVERY);
        }
    }

    fn take_summaries(&mut self) {
        while let Ok(summary) = self.summaries.pop() {
            self.wake.record(summary.wake_ns);
            self.response.record(summary.response_ns);
            if summary.solved {
                self.solve.record(summary.solve_ns);
            }
            self.budget_hits += u64::from(summary.budget_hit);
            self.log(&summary);
            self.take_over(&summary);
        }
    }

    /// Mode changes one by one; late cycles at most once a second.
    fn log(&mut self, summary: &Summary) {
        if summary.mode != self.last_mode {
            self.last_mode = summary.mode;
            let (mode, reason) = (summary.mode.text(), summary.reason.text());
            if summary.mode == Mode::Faulted {
                tracing::error!(cycle = summary.cycle, reason, "{mode}");
            } else {
                tracing::info!(cycle = summary.cycle, reason, "{mode}");
            }
        }
        let misses = summary.totals.deadline_misses + summary.totals.skipped_periods;
        if misses > self.reported_misses && self.last_report.elapsed() >= Duration::from_secs(1) {
            self.last_report = Instant::now();
            self.reported_misses = misses;
            tracing::warn!(
                cycle = summary.cycle,
                wake_us = summary.wake_ns / 1000,
                response_us = summary.response_ns / 1000,
                deadline_misses = summary.totals.deadline_misses,
                skipped_periods = summary.totals.skipped_periods,
                "late"
            );
        }
    }

    fn take_over(&mut self, summary: &Summary) {
        self.status.mode = summary.mode.code();
        self.status.reason = summary.reason.code();
        self.status.cycles = summary.totals.cycles;
        self.status.late_starts = summary.totals.late_starts;
        self.status.deadline_misses = summary.totals.deadline_misses;
        self.status.skipped_periods = summary.totals.skipped_periods;
        self.status.faults = summary.faults;
        self.status.outcomes = summary.outcomes;
        self.dropped_events = summary.dropped_events;
        self.status.lease_holder = summary.lease_holder;
        self.status.reference_end_ns = summary.reference_end_ns;
        self.status.reference_points = summary.reference_points;
        self.status.obstacle_count = summary.obstacle_count;
        self.status.obstacles_refused = summary.obstacles_refused;
        self.status.clearance_m = summary.clearance_m;
        self.status.clearance_guarded += u64::from(summary.clearance_guarded);
        self.status.settings = summary.settings;
    }

    fn publish(&mut self, clock: &impl Clock, shared: &Shared) {
        self.status.header.sequence += 1;
        self.status.header.sent_ns = clock.now_ns();
        self.status.origin_ns = shared.origin_ns();
        self.status.dropped_records = shared.dropped_records() + self.dropped_events;
        self.status.budget_hits = self.budget_hits;
        self.status.wake = self.wake.summary();
        self.status.solve = self.solve.summary();
        self.status.response = self.response.summary();
        if let Err(error) = self.publisher.send_copy(self.status) {
            tracing::warn!(%error, "the status could not be published");
        }
    }
}

/// What is known of the daemon before its first cycle.
fn first_status(validated: &Validated, daemon_id: u64) -> wire::Status {
    let config = &validated.config;
    let period_ns = ns(config.cycle.period_ms);
    wire::Status {
        header: wire::Header {
            sender_id: daemon_id,
            ..wire::Header::default()
        },
        robot_name: convert::text(&config.robot.name),
        build: convert::text(env!("CARGO_PKG_VERSION")),
        process_id: std::process::id(),
        mode: Mode::Starting.code(),
        link: match config.link.kind {
            LinkKind::Simulated => wire::codes::RobotLink::Simulated,
            LinkKind::Driver => wire::codes::RobotLink::Driver,
        }
        .code(),
        period_ns,
        deadline_ns: config.cycle.deadline_ns(),
        robot: convert::robot(&validated.robot),
        settings: convert::settings_to_wire(&config.controller),
        clearance_m: f64::INFINITY,
        ..wire::Status::default()
    }
}
