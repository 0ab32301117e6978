//! Computes recorded cycles again, offline: `docs/replay.md`.
//!
//! [`Replayer`] is given what a recording holds, in its order, and says of each cycle whether mode, plan, command and clearance come out
//! as they were, bit for bit. Knows no clock, no service and no file.

mod check;
mod compute;
mod modes;
mod reference;

use std::collections::VecDeque;

use cdcr_controller::nmpc::SettingsError;
use cdcr_controller::robot::RobotError;
use cdcr_shared_types::codes::UnknownCode;
use cdcr_shared_types::{Header, ReferenceChunk, SolverSettings, Telemetry};

use crate::model::robot_of;
pub use check::Difference;
use compute::Computer;
pub use compute::{Made, WhatIf};
use modes::Modes;
use reference::Reference;

/// Records after a cycle that may still tell of what it took in: as many events as wait in a daemon fit into fewer.
const LATER: usize = 64;

/// A record that no daemon writes.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// It describes no robot.
    #[error("the record's robot: {0}")]
    Robot(#[from] RobotError),
    /// Its settings are out of range.
    #[error("the record's settings: {0}")]
    Settings(#[from] SettingsError),
    /// A code has no meaning.
    #[error("the record: {0}")]
    Code(#[from] UnknownCode),
    /// Its robot has another number of sections than its state, or its plan another length than its settings make here.
    #[error(
        "state or plan of the record do not match its robot, or the record is from a version with other control blocks: use cdcrctl of that version"
    )]
    Shape,
}

/// What became of a cycle.
#[derive(Debug, Clone, PartialEq)]
pub enum Outcome {
    /// It came out as it was.
    Reproduced(Made),
    /// It did not.
    Different(Difference),
    /// The reference that it followed is not, or not all, in the recording.
    WithoutReference,
}

/// A cycle that was computed again.
#[derive(Debug)]
pub struct ReplayedCycle {
    /// Its record.
    pub record: Box<Telemetry>,
    /// What became of it.
    pub outcome: Outcome,
}

/// Computes the cycles of a recording again, one after the other.
///
/// Memory: 64 records (0.9 MB), at most 512 reference chunks (4.7 MB), a trajectory.
#[derive(Debug, Default)]
pub struct Replayer {
    waiting: VecDeque<Waiting>,
    newest: Option<Header>,
    of_one_daemon: Option<OfOneDaemon>,
    reference: Reference,
}

/// A record whose cycle is not computed yet.
#[derive(Debug)]
struct Waiting {
    record: Box<Telemetry>,
    /// Records before it are missing.
    follows_gap: bool,
    /// It is the first one of a daemon.
    is_first: bool,
}

/// What lasts as long as a daemon.
#[derive(Debug)]
struct OfOneDaemon {
    computer: Computer,
    modes: Modes,
}

impl Replayer {
    /// A chunk that a client sent, before the record of the cycle that it took effect in.
    pub fn take_chunk(&mut self, chunk: &ReferenceChunk) {
        self.reference.take_chunk(chunk);
    }

    /// The record of the next cycle. Returns an earlier one that is complete by now.
    ///
    /// # Errors
    /// [`ReplayError`].
    pub fn take_record(
        &mut self,
        record: &Telemetry,
    ) -> Result<Option<ReplayedCycle>, ReplayError> {
        let last = self.newest.replace(record.header);
        let is_same = last.is_some_and(|last| last.sender_id == record.header.sender_id);
        if last.is_some() && !is_same {
            self.reference.forget_events();
        }
        self.reference.take_events(record);
        self.waiting.push_back(Waiting {
            follows_gap: last.is_some_and(|last| record.header.sequence != last.sequence + 1),
            is_first: !is_same,
            record: Box::new(*record),
        });
        if self.waiting.len() > LATER {
            self.finish_one()
        } else {
            Ok(None)
        }
    }

    /// The next cycle after the last record was taken; none when all are computed.
    ///
    /// # Errors
    /// [`ReplayError`].
    pub fn finish_one(&mut self) -> Result<Option<ReplayedCycle>, ReplayError> {
        let Some(next) = self.waiting.pop_front() else {
            return Ok(None);
        };
        let Waiting {
            record,
            follows_gap,
            is_first,
        } = next;
        if is_first {
            let robot = robot_of(&record.robot)?;
            self.reference.begin(&robot);
            self.of_one_daemon = Some(OfOneDaemon {
                computer: Computer::new(robot, &record)?,
                modes: Modes::default(),
            });
        }
        let Some(parts) = &mut self.of_one_daemon else {
            return Ok(None);
        };
        if follows_gap {
            self.reference.miss_records();
            parts.modes.forget();
        }
        self.reference.move_on_to(&record);
        let later = self.waiting.front().map(|later| &*later.record);
        let requests = self.reference.requests(&record, later);
        let mode = parts.modes.check(&record, &requests);
        let is_tracking = record.plan_length > 0;
        let outcome = if is_tracking && !self.reference.is_known() {
            Outcome::WithoutReference
        } else {
            parts.computer.check(&record, &mut self.reference)?
        };
        let outcome = match (mode, outcome) {
            (Some(difference), Outcome::Reproduced(_)) => Outcome::Different(difference),
            (_, outcome) => outcome,
        };
        Ok(Some(ReplayedCycle { record, outcome }))
    }

    /// What `settings` would have commanded in the cycle that was returned last, from the same inputs and without a limit of time. None where it
    /// did not solve, or its reference is not known.
    ///
    /// # Errors
    /// [`ReplayError`].
    pub fn what_if(
        &mut self,
        cycle: &ReplayedCycle,
        settings: &SolverSettings,
    ) -> Result<Option<WhatIf>, ReplayError> {
        match &mut self.of_one_daemon {
            Some(parts) if cycle.outcome != Outcome::WithoutReference => {
                let reference = &mut self.reference;
                parts.computer.what_if(&cycle.record, settings, reference)
            }
            _ => Ok(None),
        }
    }

    /// The chunks of the reference about the last cycle that was returned, oldest first: what a file needs from which it can be computed again.
    pub fn chunks_in_force(&self) -> Vec<ReferenceChunk> {
        self.reference.chunks_in_force()
    }
}
