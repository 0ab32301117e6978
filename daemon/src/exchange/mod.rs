//! Shared memory on one side, hand-over on the other: the exchange thread.
//!
//! ```text
//! loop { sleep to shortly before the next release, or until the cycle has a record
//!        publish: command, answers, a report to the reporter (right after the cycle)
//!        gather:  references, obstacles, measurements, requests → inputs of the next cycle
//!        look:    requests once more, just before the release }
//! ```
//!
//! It runs on the core of the cycle at a lower priority, so the cycle pre-empts it, and whatever a
//! client does (connect, flood, stop reading) costs time here and not there. Everything that it reads
//! has a limit per gather, and writers are served in turn. Who only watches costs nothing here, readers of commands excepted: that is the
//! [reporter](crate::reporter)'s.

mod bound_driver;
mod events;
mod gather;
mod lease;
mod obstacle_sources;
mod publish;
mod requests;

use std::thread::Thread;
use std::time::Duration;

use cdcr_controller::reference::Trajectory;
use cdcr_controller::robot::Robot;
use cdcr_shared_types::Header;
use cdcr_shared_types::codes::Mode;
use cdcr_shared_types::limits::{EVENTS_MAX, REFERENCE_POINTS_MAX};

use crate::config::{Interface, LinkKind, Validated, ns};
use crate::core_budget::RecentCosts;
use crate::handover::{ExchangeEnds, REQUESTS_PER_CYCLE, Settings, Shared, TimedMeasurement};
use crate::obstacles::ObstacleSet;
use crate::rt::clock::Clock;
use crate::rt::schedule::Schedule;
use crate::rt::scheduler::SchedulerLooks;
use crate::rt::suspend::SuspendWatch;
use crate::services::Ports;
use bound_driver::BoundDriver;
use events::Events;
use lease::Lease;
use obstacle_sources::ObstacleSources;
use requests::Waiting;

/// The exchange of one daemon.
#[derive(Debug)]
pub struct Exchange {
    ports: Ports,
    ends: ExchangeEnds,
    robot: Robot,
    has_driver: bool,
    period_ns: u64,
    gather_lead_ns: u64,
    interface: Interface,
    trajectory: Trajectory,
    lease: Lease,
    last_chunk: Option<LastChunk>,
    /// A measurement that is older than this when it arrives is refused \[ns\].
    measurement_timeout_ns: u64,
    driver: BoundDriver,
    measurement: Option<TimedMeasurement>,
    obstacles: ObstacleSet,
    obstacle_sources: ObstacleSources,
    obstacles_refused: u64,
    settings: Settings,
    settings_revision: u64,
    /// The least safe distance that clients may set: the configured one \[m\].
    safe_distance_min_m: f64,
    gather: u64,
    /// When the newest gather began \[ns\].
    gather_began_ns: u64,
    events: Events,
    waiting: Waiting,
    daemon_id: u64,
    commands_sent: u64,
    /// Records so far, also those that the reporter had no room for.
    reports: u64,
    scheduler: SchedulerLooks,
    last_cycle: u64,
    last_mode: Mode,
    /// Stops that were asked for so far.
    stops: u64,
    suspend_watch: SuspendWatch,
    /// Times that the machine slept so far.
    suspends: u64,
    /// Requests that were carried out since the newest gather began.
    requests_taken: usize,
    /// How long the newest gather took \[ns\].
    gather_took_ns: u64,
    /// How long before its release the cycle thread wakes up \[ns\].
    spin_ns: u64,
    /// What this thread takes of the core in a period.
    own_costs: RecentCosts,
    /// Its time on the core until the newest record \[ns\].
    on_core_ns: u64,
}

/// The look for requests between a gather and the release of its cycle: a stop that was sent meanwhile need not wait
/// for another period.
#[derive(Debug, Clone, Copy)]
struct LastLook {
    cycle: u64,
    due_ns: u64,
}

impl LastLook {
    /// So long before the cycle thread wakes up it is due \[ns\]: about as late as it can be over in time.
    const LEAD_NS: u64 = 50_000;
    /// Longer than it takes \[ns\]: who comes later leaves the requests to the next gather, whole.
    const TAKES_NS: u64 = 15_000;
    /// A shorter period is soon over, and has no time to spare \[ns\].
    const PERIOD_MIN_NS: u64 = 1_000_000;

    fn before(schedule: &Schedule, cycle: u64, spin_ns: u64) -> Option<Self> {
        let due_ns = schedule.release_ns(cycle) - spin_ns - Self::LEAD_NS;
        (schedule.period_ns() >= Self::PERIOD_MIN_NS).then_some(Self { cycle, due_ns })
    }
}

/// What one gather and its cycle can bring fits one record: chunks and obstacle updates, other refusals, requests that are
/// answered at once, and requests that the cycle decides.
const _: () = assert!(
    gather::CHUNKS_PER_GATHER
        + gather::UPDATES_PER_GATHER
        + events::REFUSALS_PER_GATHER
        + requests::REQUESTS_PER_GATHER
        + REQUESTS_PER_CYCLE
        <= EVENTS_MAX
);

/// The newest chunk that was accepted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct LastChunk {
    client: u64,
    sequence: u64,
}

impl Exchange {
    /// The exchange of a validated configuration over `ports`.
    pub fn new(validated: &Validated, ports: Ports, ends: ExchangeEnds, daemon_id: u64) -> Self {
        let config = &validated.config;
        let period_ns = ns(config.cycle.period_ms);
        let measurement_timeout_ns = ns(config.link.measurement_timeout_ms);
        Self {
            ports,
            ends,
            robot: validated.robot.clone(),
            has_driver: config.link.kind == LinkKind::Driver,
            period_ns,
            gather_lead_ns: ns(config.cycle.gather_lead_ms),
            interface: config.link.interface,
            trajectory: Trajectory::with_capacity(REFERENCE_POINTS_MAX, validated.robot.reach_m()),
            lease: Lease::new(ns(config.reference.lease_ms)),
            last_chunk: None,
            measurement_timeout_ns,
            driver: BoundDriver::new(measurement_timeout_ns),
            measurement: None,
            obstacles: ObstacleSet::default(),
            obstacle_sources: ObstacleSources::new(&config.obstacles),
            obstacles_refused: 0,
            settings: Settings::new(config),
            settings_revision: 0,
            safe_distance_min_m: config.controller.safe_distance_m,
            gather: 0,
            gather_began_ns: 0,
            events: Events::new(),
            waiting: Waiting::new(),
            daemon_id,
            commands_sent: 0,
            reports: 0,
            scheduler: SchedulerLooks::default(),
            last_cycle: 0,
            last_mode: Mode::Starting,
            stops: 0,
            suspend_watch: SuspendWatch::default(),
            suspends: 0,
            requests_taken: 0,
            gather_took_ns: 0,
            spin_ns: ns(config.realtime.spin_us * 1e-3),
            own_costs: RecentCosts::default(),
            on_core_ns: 0,
        }
    }

    /// Runs until the cycle thread has ended and its last record is published. `reporter` is woken up for each report.
    pub fn run(
        &mut self,
        schedule: &Schedule,
        clock: &impl Clock,
        shared: &Shared,
        reporter: &Thread,
    ) {
        // While the cycle thread spins to a release, nobody else has the core.
        let lead_ns = self.gather_lead_ns + self.spin_ns;
        let mut next_cycle = schedule.cycle_at(clock.now_ns()) + 1;
        let mut look: Option<LastLook> = None;
        self.scheduler = SchedulerLooks::at(shared.cycle_thread());
        loop {
            shared.beat_exchange();
            let gather_ns = schedule.release_ns(next_cycle) - lead_ns;
            let due_ns = look.map_or(gather_ns, |look| look.due_ns);
            let left_ns = due_ns.saturating_sub(clock.now_ns());
            if left_ns > 0 {
                // The cycle ends this early when it has a record.
                std::thread::park_timeout(Duration::from_nanos(left_ns));
            }
            self.publish(clock, shared, reporter);
            let now_ns = clock.now_ns();
            if let Some(last) = look.take_if(|look| now_ns >= look.due_ns) {
                self.look_again(schedule, last.cycle, now_ns, shared);
            }
            if now_ns >= gather_ns {
                self.gather(schedule, next_cycle, now_ns, clock, shared);
                self.gather_took_ns = clock.now_ns() - now_ns;
                look = LastLook::before(schedule, next_cycle, self.spin_ns);
                next_cycle = (next_cycle + 1).max(schedule.cycle_at(now_ns + lead_ns) + 1);
            }
            // In this order: the last record was handed over before the end was said.
            if shared.has_cycle_ended() {
                self.publish(clock, shared, reporter);
                break;
            }
        }
    }

    fn header(&self, sequence: u64, now_ns: u64) -> Header {
        Header {
            sender_id: self.daemon_id,
            sequence,
            sent_ns: now_ns,
        }
    }
}

#[cfg(test)]
#[allow(
    clippy::unwrap_used,
    reason = "in a test a panic is the report, in its helpers, too"
)]
mod tests;
