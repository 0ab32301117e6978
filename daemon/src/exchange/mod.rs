//! Shared memory on one side, hand-over on the other: the exchange thread.
//!
//! ```text
//! loop { sleep to shortly before the next release, or until the cycle has a record
//!        publish: command, answers, a report to the reporter (right after the cycle)
//!        gather:  references, obstacles, measurements, requests → inputs of the next cycle }
//! ```
//!
//! What clients bring is taken in by a desk each: `references`, `measurements`, `obstacles`, `settings`, `requests`.
//!
//! It runs on the core of the cycle at a lower priority, so the cycle pre-empts it, and whatever a
//! client does (connect, flood, stop reading) costs time here and not there. Everything that it reads
//! has a limit per gather, and writers are served in turn. Who only watches costs nothing here, readers of commands excepted: that is the
//! [reporter](crate::reporter)'s.

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
    timing: Timing,
    references: References,
    measurements: Measurements,
    obstacles: Obstacles,
    settings: SettingsInForce,
    requests: RequestDesk,
    /// What became of all that.
    events: Events,
    gather: NewestGather,
    newest: Newest,
    daemon_id: u64,
    commands_sent: u64,
    /// Records so far, also those that the reporter had no room for.
    reports: u64,
    cycle_watch: CycleWatch,
    own_costs: OwnCosts,
    suspend_watch: SuspendWatch,
}

/// What the configuration says of the time of a cycle \[ns\].
#[derive(Debug)]
#[allow(clippy::struct_field_names, reason = "the unit ends each name")]
struct Timing {
    period_ns: u64,
    gather_lead_ns: u64,
    /// How long before its release the cycle thread wakes up.
    spin_ns: u64,
}

/// The gather that is under way, or was the last.
#[derive(Debug, Default)]
struct NewestGather {
    number: u64,
    /// \[ns, `CLOCK_MONOTONIC`\]
    began_ns: u64,
    took_ns: u64,
}

/// Of the newest record.
#[derive(Debug)]
struct Newest {
    cycle: u64,
    mode: Mode,
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

impl Exchange {
    /// The exchange of a validated configuration over `ports`.
    pub fn new(validated: &Validated, ports: Ports, ends: ExchangeEnds, daemon_id: u64) -> Self {
        let config = &validated.config;
        Self {
            ports,
            ends,
            robot: validated.robot.clone(),
            timing: Timing {
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
            },
            daemon_id,
            commands_sent: 0,
            reports: 0,
            cycle_watch: CycleWatch::default(),
            own_costs: OwnCosts::default(),
            suspend_watch: SuspendWatch::default(),
        }
    }

    /// Runs until the cycle thread has ended and its last record is published.
    pub fn run(&mut self, schedule: &Schedule, clock: &impl Clock, shared: &Shared) {
        // While the cycle thread spins to a release, nobody else has the core.
        let lead_ns = self.timing.gather_lead_ns + self.timing.spin_ns;
        let mut next_cycle = schedule.cycle_at(clock.now_ns()) + 1;
        self.cycle_watch = CycleWatch::at(shared.cycle_thread());
        loop {
            shared.exchange_beats.add(1);
            let gather_ns = schedule.release_ns(next_cycle) - lead_ns;
            let left_ns = gather_ns.saturating_sub(clock.now_ns());
            if left_ns > 0 {
                // The cycle ends this early when it has a record.
                std::thread::park_timeout(Duration::from_nanos(left_ns));
            }
            self.publish(clock, shared);
            let now_ns = clock.now_ns();
            if now_ns >= gather_ns {
                self.gather(schedule, next_cycle, now_ns, clock, shared);
                self.gather.took_ns = clock.now_ns() - now_ns;
                next_cycle = (next_cycle + 1).max(schedule.cycle_at(now_ns + lead_ns) + 1);
            }
            // In this order: the last record was handed over before the end was said.
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
