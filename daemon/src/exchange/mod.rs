//! The exchange thread: transfers messages between shared memory and the cycle.
//!
//! ```text
//! loop { sleep until shortly before the next release, or until the cycle has a record
//!        publish: command, answers, a report to the reporter (right after the cycle)
//!        gather:  references, obstacles, measurements, requests → inputs of the next cycle }
//! ```
//!
//! One part handles each kind of message: `references`, `measurements`, `obstacles`, `settings`, `requests`.
//!
//! The exchange runs on the core of the cycle at a lower priority: with `SCHED_FIFO` the cycle pre-empts it.
//! Clients that connect, flood or stop reading cost time here, not in the cycle. Each kind of message has a
//! limit per gather, and writers are served in turn. Except readers of commands, monitoring clients cost
//! nothing here: the [reporter](crate::reporter) serves them.

mod bound_sender;
mod cycle_watch;
mod events;
mod gather;
mod lease;
mod measurements;
mod obstacle_sources;
mod obstacles;
mod own_costs;
mod publish;
mod references;
mod requests;
mod settings;

use std::time::Duration;

use cdcr_controller::robot::Robot;
use cdcr_shared_types::Header;
use cdcr_shared_types::codes::Mode;
use cdcr_shared_types::limits::EVENTS_MAX;

use crate::config::{Validated, ns};
use crate::handover::{ExchangeEnds, REQUESTS_PER_CYCLE, Shared};
use crate::kept_obstacles::KeptObstacles;
use crate::rt::clock::Clock;
use crate::rt::schedule::Schedule;
use crate::rt::suspend::SuspendWatch;
use crate::services::Ports;
use cycle_watch::CycleWatch;
use events::Events;
use measurements::Measurements;
use obstacles::Obstacles;
use own_costs::OwnCosts;
use references::References;
use requests::RequestDesk;
use settings::SettingsInForce;

#[derive(Debug)]
pub struct Exchange {
    ports: Ports,
    ends: ExchangeEnds,
    robot: Robot,
    timing: CycleTimes,
    references: References,
    measurements: Measurements,
    obstacles: Obstacles,
    settings: SettingsInForce,
    requests: RequestDesk,
    /// Outcomes of all messages.
    events: Events,
    gather: NewestGather,
    newest: Newest,
    daemon_id: u64,
    commands_sent: u64,
    /// Records so far, including those dropped because the reporter's ring was full.
    reports: u64,
    cycle_watch: CycleWatch,
    own_costs: OwnCosts,
    suspend_watch: SuspendWatch,
}

/// Times of a cycle, from the configuration \[ns\].
#[derive(Debug)]
#[allow(clippy::struct_field_names, reason = "the unit ends each name")]
struct CycleTimes {
    period_ns: u64,
    gather_lead_ns: u64,
    /// Time before its release at which the cycle thread wakes up.
    spin_ns: u64,
}

/// The gather in progress, or the last one.
#[derive(Debug, Default)]
struct NewestGather {
    number: u64,
    /// \[ns, `CLOCK_MONOTONIC`\]
    began_ns: u64,
    took_ns: u64,
}

/// Data of the newest record.
#[derive(Debug)]
struct Newest {
    cycle: u64,
    mode: Mode,
    /// It commanded rest.
    rests: bool,
}

/// All events of one gather and its cycle fit into one record: chunks, obstacle updates, other refusals, and
/// requests answered at once or by the cycle.
const _: () = assert!(
    gather::CHUNKS_PER_GATHER
        + gather::UPDATES_PER_GATHER
        + events::REFUSALS_PER_GATHER
        + requests::REQUESTS_PER_GATHER
        + REQUESTS_PER_CYCLE
        <= EVENTS_MAX
);

impl Exchange {
    pub fn new(validated: &Validated, ports: Ports, ends: ExchangeEnds, daemon_id: u64) -> Self {
        let config = &validated.config;
        Self {
            ports,
            ends,
            robot: validated.robot.clone(),
            timing: CycleTimes {
                period_ns: ns(config.cycle.period_ms),
                gather_lead_ns: ns(config.cycle.gather_lead_ms),
                spin_ns: config.realtime.spin_ns(config.cycle.period_ms),
            },
            references: References::new(
                &validated.robot,
                ns(config.reference.lease_ms),
                ns(config.actuator.lead_ms()),
            ),
            measurements: Measurements::new(config),
            obstacles: Obstacles::new(&config.obstacles),
            settings: SettingsInForce::new(config),
            requests: RequestDesk::new(),
            events: Events::new(),
            gather: NewestGather::default(),
            newest: Newest {
                cycle: 0,
                mode: Mode::Starting,
                rests: true,
            },
            daemon_id,
            commands_sent: 0,
            reports: 0,
            cycle_watch: CycleWatch::default(),
            own_costs: OwnCosts::default(),
            suspend_watch: SuspendWatch::default(),
        }
    }

    /// Begins with the obstacles in `kept`, and keeps those without a lifetime there.
    #[must_use]
    pub fn keeping(mut self, kept: KeptObstacles) -> Self {
        self.obstacles.keep(kept);
        self
    }

    /// Runs until the cycle thread has ended and its last record is published.
    pub fn run(&mut self, schedule: &Schedule, clock: &impl Clock, shared: &Shared) {
        // While the cycle thread rehearses and spins before a release, no other thread gets the core.
        let lead_ns = self.timing.gather_lead_ns + self.timing.spin_ns;
        let mut next_cycle = schedule.cycle_at(clock.now_ns()) + 1;
        self.cycle_watch = CycleWatch::new(shared.cycle_thread());
        loop {
            shared.exchange_beats.add(1);
            let gather_ns = schedule.release_ns(next_cycle) - lead_ns;
            let left_ns = gather_ns.saturating_sub(clock.now_ns());
            if left_ns > 0 {
                // The cycle ends this sleep when it has a record.
                std::thread::park_timeout(Duration::from_nanos(left_ns));
            }
            self.publish(clock, shared);
            let now_ns = clock.now_ns();
            if now_ns >= gather_ns {
                self.gather(schedule, next_cycle, now_ns, clock, shared);
                self.gather.took_ns = clock.now_ns() - now_ns;
                next_cycle = (next_cycle + 1).max(schedule.cycle_at(now_ns + lead_ns) + 1);
            }
            // In this order: the cycle hands over its last record before it sets the flag.
            if shared.cycle_ended.is_set() {
                self.publish(clock, shared);
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
