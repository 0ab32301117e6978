//! Shortly before each release: receive and check messages, hand over the inputs.

use cdcr_shared_types::Service;
use cdcr_shared_types::codes::{EventKind, Mode};

use super::Exchange;
use super::measurements::Arrival;
use crate::handover::{RuntimeSettings, Shared};
use crate::rt::clock::Clock;
use crate::rt::schedule::Schedule;
use crate::services::Received;

/// Chunks accepted or refused by one gather. A client streams one in half a second; any more wait.
pub(super) const CHUNKS_PER_GATHER: usize = 4;
/// Obstacle updates accepted or refused by one gather, if its time allows: half of one client's queue. Any
/// more wait.
pub(super) const UPDATES_PER_GATHER: usize = 8;
/// Time before a release that is planned for one obstacle update \[ns\]. A full one takes a fifth of it.
const UPDATE_NS: u64 = 25_000;
/// Measurements read by one gather: all that the queues can hold.
const MEASUREMENTS_PER_GATHER: usize = {
    let queues = Service::Measurement.queues();
    queues.publishers * queues.queue
};

/// Obstacle updates accepted or refused by a gather that begins `gather_lead_ns` before its release.
pub(super) fn updates_per_gather(gather_lead_ns: u64) -> usize {
    ((gather_lead_ns / UPDATE_NS) as usize).clamp(1, UPDATES_PER_GATHER)
}

impl Exchange {
    /// Receives the messages of clients and driver, and hands over the inputs of `cycle`.
    pub(super) fn gather(
        &mut self,
        schedule: &Schedule,
        cycle: u64,
        now_ns: u64,
        clock: &impl Clock,
        shared: &Shared,
    ) {
        let paused_ns = now_ns.saturating_sub(self.gather.began_ns + 2 * self.timing.period_ns);
        self.references
            .extend_lease(self.gather.began_ns, paused_ns);
        self.measurements.extend(paused_ns);
        self.obstacles.extend(self.gather.began_ns, paused_ns);
        self.gather.number += 1;
        self.gather.began_ns = now_ns;
        self.events.begin_gather();
        self.requests.begin_gather();
        self.references.end_silent_lease(now_ns);
        self.take_references(now_ns);
        self.take_obstacles(now_ns, clock);
        self.take_measurements(clock);
        while let Ok(changed) = self.ends.reloaded.pop() {
            self.settings.reload(&changed);
        }
        self.take_requests(now_ns, clock, shared);
        self.references.forget_before(schedule, cycle);
        self.hand_over(schedule, cycle, now_ns, clock);
    }

    fn hand_over(&mut self, schedule: &Schedule, cycle: u64, now_ns: u64, clock: &impl Clock) {
        let inputs = self.ends.inputs.input_buffer_mut();
        inputs.gather = self.gather.number;
        inputs.gather_ns = self.gather.began_ns;
        let RuntimeSettings { nmpc, .. } = self.settings.settings;
        let horizon = nmpc.horizon_steps as usize;
        self.references
            .fill(&mut inputs.window, schedule, cycle, horizon);
        inputs.lease = self.references.lease_state(now_ns);
        inputs.lease_number = self.references.lease_number();
        inputs.exchange_ns = self.own_costs.high_ns();
        inputs.interruptions = self.cycle_watch.interruptions();
        inputs.measurement = self.measurements.newest();
        inputs.drivers = self.measurements.drivers();
        inputs.tip = self.measurements.newest_tip();
        inputs.tip_sensors = self.measurements.tip_sensors();
        self.obstacles.hand_over(&mut inputs.obstacles, now_ns);
        inputs.obstacle_source_silent = self.obstacles.requires_hold(now_ns);
        inputs.stops = self.requests.stops();
        inputs.suspends = self.suspend_watch.update(&clock.slept_ns());
        inputs.settings = self.settings.settings;
        inputs.settings_revision = self.settings.revision;
        self.ends.inputs.publish();
    }

    fn take_references(&mut self, now_ns: u64) {
        for _ in 0..CHUNKS_PER_GATHER {
            let Some(received) = self.ports.reference.receive() else {
                break;
            };
            let chunk = received.message;
            let result = self.references.take(&chunk, &self.robot, now_ns);
            self.events.note(
                self.gather.number,
                EventKind::Reference,
                &chunk.header,
                now_ns,
                result,
            );
        }
    }

    fn take_obstacles(&mut self, now_ns: u64, clock: &impl Clock) {
        self.obstacles.remove_expired(now_ns);
        for _ in 0..updates_per_gather(self.timing.gather_lead_ns) {
            let Some(Received { message, is_newer }) = self.ports.obstacles.receive() else {
                break;
            };
            // The thread may have stalled since the gather began: a time stamp from meanwhile is not in the
            // future.
            let now_ns = clock.now_ns();
            let gather_ns = self.gather.began_ns;
            let result = self.obstacles.take(&message, is_newer, gather_ns, now_ns);
            let (kind, header) = (EventKind::Obstacles, &message.header);
            self.events
                .note(self.gather.number, kind, header, now_ns, result);
        }
        self.obstacles.unwatch_relieved(now_ns);
    }

    /// Accepted measurements are many and only counted.
    fn take_measurements(&mut self, clock: &impl Clock) {
        for _ in 0..MEASUREMENTS_PER_GATHER {
            let Some(Received { message, is_newer }) = self.ports.measurement.receive() else {
                break;
            };
            let arrival = Arrival {
                gather_ns: self.gather.began_ns,
                // As for obstacles, the measurement may be newer than the gather.
                now_ns: clock.now_ns(),
                is_faulted: self.newest.mode == Mode::Faulted && self.newest.rests,
            };
            let taken = self
                .measurements
                .take(&message, is_newer, &self.robot, arrival);
            match taken {
                Ok(outcome) => self.events.count(outcome),
                Err(refused) => {
                    let (kind, header) = (EventKind::Measurement, &message.header);
                    let result = Err(refused);
                    self.events
                        .note(self.gather.number, kind, header, arrival.now_ns, result);
                }
            }
        }
    }
}
