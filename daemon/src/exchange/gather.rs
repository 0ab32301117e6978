//! Shortly before each release: drain, check, hand over.

use cdcr_shared_types::codes::{ChunkMode, EventKind, Mode, Outcome};
use cdcr_shared_types::{Header, Measurement, ObstacleUpdate, ReferenceChunk, Service};

use super::{Exchange, LastChunk, LastLook};
use crate::convert::{self, Refused};
use crate::handover::{Shared, TimedMeasurement};
use crate::rt::clock::Clock;
use crate::rt::schedule::Schedule;
use crate::services::Received;

/// Chunks that one gather takes or refuses. A client streams one in half a second; more than this wait.
pub(super) const CHUNKS_PER_GATHER: usize = 4;
/// Obstacle updates that one gather takes or refuses, where there is time for them: half of what one client's queue holds;
/// more than this wait.
pub(super) const UPDATES_PER_GATHER: usize = 8;
/// Time before a release that is there for one obstacle update \[ns\]. A full one takes a fifth of it.
const UPDATE_NS: u64 = 25_000;
/// Measurements that one gather looks at: all that the queues can hold.
const MEASUREMENTS_PER_GATHER: usize = {
    let queues = Service::Measurement.queues();
    queues.publishers * queues.queue
};

/// Obstacle updates that a gather so long before its release takes or refuses.
pub(super) fn updates_per_gather(gather_lead_ns: u64) -> usize {
    ((gather_lead_ns / UPDATE_NS) as usize).clamp(1, UPDATES_PER_GATHER)
}

impl Exchange {
    /// Takes in what clients and driver sent, and hands the inputs of `cycle` over.
    pub(super) fn gather(
        &mut self,
        schedule: &Schedule,
        cycle: u64,
        now_ns: u64,
        clock: &impl Clock,
        shared: &Shared,
    ) {
        let unheard_ns = now_ns.saturating_sub(self.gather_began_ns + 2 * self.period_ns);
        self.lease.extend(self.gather_began_ns, unheard_ns);
        self.driver.extend(unheard_ns);
        self.obstacle_sources
            .extend(self.gather_began_ns, unheard_ns);
        self.suspends = self.suspend_watch.look(&clock.slept_ns());
        self.gather += 1;
        self.gather_began_ns = now_ns;
        self.events.begin_gather();
        self.requests_taken = 0;
        self.end_silent_lease(now_ns);
        self.take_references(now_ns);
        self.take_obstacles(now_ns, clock);
        self.take_measurements(clock);
        self.take_requests(now_ns, shared);
        self.trajectory
            .forget_before(schedule.release_ns(cycle.saturating_sub(1)));
        self.hand_over(schedule, cycle, now_ns);
    }

    /// Takes requests once more shortly before the release of `cycle`. What they change is handed over whole, as if the
    /// gather had seen it; when there is no time left for that, the next gather takes them.
    pub(super) fn look_again(
        &mut self,
        schedule: &Schedule,
        cycle: u64,
        now_ns: u64,
        shared: &Shared,
    ) {
        let end_ns = schedule.release_ns(cycle) - self.spin_ns - LastLook::TAKES_NS;
        if now_ns < end_ns && self.take_requests(now_ns, shared) {
            self.hand_over(schedule, cycle, now_ns);
        }
    }

    fn hand_over(&mut self, schedule: &Schedule, cycle: u64, now_ns: u64) {
        let inputs = self.ends.inputs.input_buffer_mut();
        inputs.gather = self.gather;
        inputs.gather_ns = self.gather_began_ns;
        inputs.window.fill(
            &self.trajectory,
            cycle,
            schedule.release_ns(cycle),
            schedule.period_ns(),
            self.settings.nmpc.horizon_steps as usize,
        );
        inputs.lease = self.lease.state(now_ns);
        inputs.exchange_ns = self.own_costs.high_on_core_ns();
        inputs.measurement = self.measurement;
        inputs.obstacles = self.obstacles;
        let sources = &self.obstacle_sources;
        inputs
            .obstacles
            .change(|known| sources.hand_over(known, now_ns));
        inputs.obstacle_source_silent = sources.want_hold(now_ns);
        inputs.stops = self.stops;
        inputs.suspends = self.suspends;
        inputs.settings = self.settings;
        inputs.settings_revision = self.settings_revision;
        self.ends.inputs.publish();
    }

    /// A reference belongs to its lease: when that ends, so does the reference.
    fn end_silent_lease(&mut self, now_ns: u64) {
        if self.last_chunk.is_some() && self.lease.holder(now_ns).is_none() {
            self.drop_reference();
        }
    }

    pub(super) fn drop_reference(&mut self) {
        self.trajectory.clear();
        self.last_chunk = None;
    }

    fn take_references(&mut self, now_ns: u64) {
        for _ in 0..CHUNKS_PER_GATHER {
            let Some(received) = self.ports.reference.receive() else {
                break;
            };
            let chunk = received.message;
            let result = self.take_chunk(&chunk, now_ns);
            self.events.note(
                self.gather,
                EventKind::Reference,
                &chunk.header,
                now_ns,
                result,
            );
        }
    }

    /// Takes a chunk whole, or refuses it whole.
    fn take_chunk(&mut self, chunk: &ReferenceChunk, now_ns: u64) -> Result<u32, Refused> {
        let Header {
            sender_id: client,
            sequence,
            ..
        } = chunk.header;
        if self.lease.holder(now_ns) != Some(client) {
            return Err(Refused::whole(Outcome::NoLease));
        }
        if chunk.reserved != 0 {
            return Err(Refused::whole(Outcome::UnknownCode));
        }
        let mode =
            ChunkMode::try_from(chunk.mode).map_err(|_| Refused::whole(Outcome::UnknownCode))?;
        self.check_sequence(mode, client, sequence)?;
        let points = convert::reference_points(chunk, &self.robot, now_ns)?;
        let taken = match mode {
            ChunkMode::Replace => self.trajectory.replace(points),
            ChunkMode::Append => self.trajectory.append(points),
        };
        taken.map_err(|error| convert::trajectory_refusal(&error))?;
        self.last_chunk = Some(LastChunk { client, sequence });
        self.lease.renew(client, now_ns);
        Ok(0)
    }

    /// An appended chunk continues the last one without a gap; a new trajectory is newer than it.
    fn check_sequence(&self, mode: ChunkMode, client: u64, sequence: u64) -> Result<(), Refused> {
        let last = self.last_chunk.filter(|last| last.client == client);
        match (mode, last) {
            (_, Some(last)) if sequence <= last.sequence => Err(Refused::whole(Outcome::Stale)),
            (ChunkMode::Append, Some(last)) if sequence == last.sequence + 1 => Ok(()),
            (ChunkMode::Append, _) => Err(Refused::whole(Outcome::SequenceGap)),
            (ChunkMode::Replace, _) => Ok(()),
        }
    }

    fn take_obstacles(&mut self, now_ns: u64, clock: &impl Clock) {
        let sources = &self.obstacle_sources;
        self.obstacles
            .retain(|known| !sources.let_expire(known, now_ns));
        for _ in 0..updates_per_gather(self.gather_lead_ns) {
            let Some(received) = self.ports.obstacles.receive() else {
                break;
            };
            let update = received.message;
            // This thread may have stood still since the gather began: what was seen meanwhile is not of the future.
            let now_ns = clock.now_ns();
            let result = if received.is_newer {
                self.take_update(&update, now_ns)
            } else {
                Err(Refused::whole(Outcome::Stale))
            };
            self.obstacles_refused += u64::from(result.is_err());
            self.events.note(
                self.gather,
                EventKind::Obstacles,
                &update.header,
                now_ns,
                result,
            );
        }
    }

    /// Takes an update whole, or refuses it whole. Says how many obstacles are known after it.
    fn take_update(&mut self, update: &ObstacleUpdate, now_ns: u64) -> Result<u32, Refused> {
        let full = Refused::whole(Outcome::BufferFull);
        let updated = if self.obstacle_sources.have_room_for(update) {
            convert::updated_obstacles(update, &self.obstacles, now_ns)
        } else {
            Err(full)
        };
        // Where there is no room, its own obstacles that are out of date may take it: they go when their source is heard.
        let is_full = |refused: &Refused| refused.outcome == full.outcome;
        if updated.as_ref().err().is_none_or(is_full) {
            self.obstacle_sources.hear(update, self.gather_began_ns);
        }
        self.obstacles = updated?;
        Ok(self.obstacles.count() as u32)
    }

    /// Keeps the newest measurement. Good ones are many and not reported one by one.
    fn take_measurements(&mut self, clock: &impl Clock) {
        for _ in 0..MEASUREMENTS_PER_GATHER {
            let Some(Received { message, is_newer }) = self.ports.measurement.receive() else {
                break;
            };
            // As for obstacles: it may be newer than the gather.
            let now_ns = clock.now_ns();
            let result = self.judge_measurement(&message, now_ns);
            match result {
                Ok(timed)
                    if !is_newer
                        || self
                            .measurement
                            .is_some_and(|last| timed.measured_ns <= last.measured_ns) =>
                {
                    self.events.count(Outcome::Stale);
                }
                Ok(timed) => {
                    self.measurement = Some(timed);
                    let sender = message.header.sender_id;
                    self.driver.hear(sender, self.gather_began_ns);
                    self.events.count(Outcome::Accepted);
                }
                Err(refused) => {
                    let (kind, header) = (EventKind::Measurement, &message.header);
                    self.events
                        .note(self.gather, kind, header, now_ns, Err(refused));
                }
            }
        }
    }

    /// One that is old at its arrival does not tell where the robot is, though its driver may be well: it is never
    /// believed, and a first one least of all.
    fn judge_measurement(
        &self,
        message: &Measurement,
        now_ns: u64,
    ) -> Result<TimedMeasurement, Refused> {
        if !self.has_driver {
            return Err(Refused::whole(Outcome::Unsupported));
        }
        // The cycle sees first that the driver is lost, and the robot rests before another one has it.
        let is_faulted = self.last_mode == Mode::Faulted;
        let sender = message.header.sender_id;
        if !self.driver.is(sender, self.gather_began_ns, is_faulted) {
            return Err(Refused::whole(Outcome::OtherDriver));
        }
        let interface = convert::interface(self.interface);
        let timed = convert::measurement(message, &self.robot, interface, now_ns)?;
        let age_ns = now_ns.saturating_sub(timed.measured_ns);
        if age_ns > self.measurement_timeout_ns {
            return Err(Refused::whole(Outcome::InThePast));
        }
        Ok(timed)
    }
}
