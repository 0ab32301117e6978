use cdcr_controller::reference::{ReferenceWindow, Trajectory};
use cdcr_controller::robot::Robot;
use cdcr_controller::safety::LeaseState;
use cdcr_shared_types::codes::{ChunkMode, Outcome};
use cdcr_shared_types::limits::REFERENCE_POINTS_MAX;
use cdcr_shared_types::{Header, ReferenceChunk};

use super::lease::Lease;
use crate::convert::{self, Refused};
use crate::rt::schedule::Schedule;

/// The reference and its lease. A reference belongs to its lease and ends with it.
#[derive(Debug)]
pub(super) struct References {
    /// Time by which commands lead the reference \[ns\].
    lead_ns: u64,
    trajectory: Trajectory,
    lease: Lease,
    /// Number of leases so far: each is acquired by a client that did not hold it.
    leases: u32,
    last_chunk: Option<LastChunk>,
}

/// The newest accepted chunk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct LastChunk {
    client: u64,
    sequence: u64,
}

impl References {
    /// No reference, and a free lease.
    pub(super) fn new(robot: &Robot, lease_ns: u64, lead_ns: u64) -> Self {
        Self {
            lead_ns,
            trajectory: Trajectory::with_capacity(REFERENCE_POINTS_MAX, robot.reach_m()),
            lease: Lease::new(lease_ns),
            leases: 0,
            last_chunk: None,
        }
    }

    /// Extends the lease by `paused_ns`, a time without gathers after `paused_since_ns`.
    pub(super) fn extend_lease(&mut self, paused_since_ns: u64, paused_ns: u64) {
        self.lease.extend(paused_since_ns, paused_ns);
    }

    /// Drops the reference of a lease that has expired.
    pub(super) fn end_silent_lease(&mut self, now_ns: u64) {
        if self.is_fed() && self.holder(now_ns).is_none() {
            self.drop_reference();
        }
    }

    /// A chunk was accepted since the reference was last dropped.
    pub(super) fn is_fed(&self) -> bool {
        self.last_chunk.is_some()
    }

    /// Accepts or refuses a chunk as a whole.
    pub(super) fn take(
        &mut self,
        chunk: &ReferenceChunk,
        robot: &Robot,
        now_ns: u64,
    ) -> Result<u32, Refused> {
        let Header {
            sender_id: client,
            sequence,
            ..
        } = chunk.header;
        if self.holder(now_ns) != Some(client) {
            return Err(Refused::whole(Outcome::NoLease));
        }
        if chunk.reserved != 0 {
            return Err(Refused::whole(Outcome::UnknownCode));
        }
        let mode =
            ChunkMode::try_from(chunk.mode).map_err(|_| Refused::whole(Outcome::UnknownCode))?;
        self.check_sequence(mode, client, sequence)?;
        let points = convert::reference_points(chunk, robot, now_ns)?;
        let taken = match mode {
            ChunkMode::Replace => self.trajectory.replace(points),
            ChunkMode::Append => self.trajectory.append(points),
        };
        taken.map_err(|error| convert::trajectory_refusal(&error))?;
        self.last_chunk = Some(LastChunk { client, sequence });
        self.lease.renew(client, now_ns);
        Ok(0)
    }

    /// An appended chunk continues the last one without a gap; a new trajectory is newer than the last chunk.
    fn check_sequence(&self, mode: ChunkMode, client: u64, sequence: u64) -> Result<(), Refused> {
        let last = self.last_chunk.filter(|last| last.client == client);
        match (mode, last) {
            (_, Some(last)) if sequence <= last.sequence => Err(Refused::whole(Outcome::Stale)),
            (ChunkMode::Append, Some(last)) if sequence == last.sequence + 1 => Ok(()),
            (ChunkMode::Append, _) => Err(Refused::whole(Outcome::SequenceGap)),
            (ChunkMode::Replace, _) => Ok(()),
        }
    }

    /// Acquires or renews the lease. A new holder begins without a reference: a lease that expired since the
    /// gather has left its reference behind.
    pub(super) fn acquire_lease(&mut self, client: u64, now_ns: u64) -> Outcome {
        let renews = self.holder(now_ns) == Some(client);
        if !self.lease.acquire(client, now_ns) {
            return Outcome::LeaseHeld;
        }
        if !renews {
            self.leases = self.leases.wrapping_add(1);
            self.drop_reference();
        }
        Outcome::Accepted
    }

    pub(super) fn release_lease(&mut self, client: u64, now_ns: u64) -> Outcome {
        if !self.lease.release(client, now_ns) {
            return Outcome::NoLease;
        }
        self.drop_reference();
        Outcome::Accepted
    }

    fn drop_reference(&mut self) {
        self.trajectory.clear();
        self.last_chunk = None;
    }

    /// Removes the points before the release of the previous cycle.
    pub(super) fn forget_before(&mut self, schedule: &Schedule, cycle: u64) {
        self.trajectory
            .forget_before(schedule.release_ns(cycle.saturating_sub(1)));
    }

    /// Samples the reference at the releases from `cycle` on.
    pub(super) fn fill(
        &self,
        window: &mut ReferenceWindow,
        schedule: &Schedule,
        cycle: u64,
        horizon: usize,
    ) {
        window.fill(
            &self.trajectory,
            cycle,
            schedule.release_ns(cycle),
            schedule.period_ns(),
            horizon,
            self.lead_ns,
        );
    }

    pub(super) fn holder(&self, now_ns: u64) -> Option<u64> {
        self.lease.holder(now_ns)
    }

    /// Remaining time of the lease \[ns\].
    pub(super) fn lease_left_ns(&self, now_ns: u64) -> u64 {
        self.lease.left_ns(now_ns)
    }

    /// State of the lease for the cycle.
    pub(super) fn lease_state(&self, now_ns: u64) -> LeaseState {
        self.lease.state(now_ns)
    }

    /// Number of the lease acquired last.
    pub(super) fn lease_number(&self) -> u32 {
        self.leases
    }

    /// Time of the last point \[ns\].
    pub(super) fn end_ns(&self) -> Option<u64> {
        self.trajectory.end_ns()
    }

    pub(super) fn points_ahead(&self, now_ns: u64) -> usize {
        self.trajectory.points_ahead(now_ns)
    }
}
