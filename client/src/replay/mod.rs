//! Recomputes recorded cycles offline: `docs/replay.md`.
//!
//! [`Replayer`] takes the content of a recording in order. For each cycle it reports whether mode, plan,
//! command and clearance are reproduced bit for bit. It knows no clock, no service and no file.

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

/// Later records that may still contain events of a cycle: all events queued in a daemon fit into fewer.
const EVENT_DELAY_RECORDS: usize = 64;

/// An invalid record: no daemon writes it.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The robot description is invalid.
    #[error("the record's robot: {0}")]
    Robot(#[from] RobotError),
    /// The settings are out of range.
    #[error("the record's settings: {0}")]
    Settings(#[from] SettingsError),
    /// A code is unknown.
    #[error("the record: {0}")]
    Code(#[from] UnknownCode),
    /// The state does not fit the number of sections, or the plan does not have the length that its settings
    /// give here.
    #[error(
        "state or plan of the record do not match its robot, or the record is from a version with other control blocks: use cdcrctl of that version"
    )]
    Shape,
}

/// Result of a recomputed cycle.
#[derive(Debug, Clone, PartialEq)]
pub enum Outcome {
    /// The result is the same.
    Reproduced(Made),
    /// The result differs.
    Different(Difference),
    /// The recording lacks the reference of the cycle, or a part of it.
    WithoutReference,
}

/// A recomputed cycle.
#[derive(Debug)]
pub struct ReplayedCycle {
    /// The cycle as it was recorded.
    pub record: Box<Telemetry>,
    /// Result of the cycle.
    pub outcome: Outcome,
}

/// Recomputes the cycles of a recording, one after the other.
///
/// Memory: 64 records (0.9 MB), at most 512 reference chunks (4.7 MB), a trajectory.
#[derive(Debug, Default)]
pub struct Replayer {
    waiting: VecDeque<WaitingRecord>,
    newest: Option<Header>,
    daemon_state: Option<DaemonState>,
    reference: Reference,
}

/// A record whose cycle is not computed yet.
#[derive(Debug)]
struct WaitingRecord {
    record: Box<Telemetry>,
    /// Whether records before it are missing.
    follows_gap: bool,
    /// Whether it is the first record of a daemon.
    is_first: bool,
}

/// State for the records of one daemon.
#[derive(Debug)]
struct DaemonState {
    computer: Computer,
    modes: Modes,
}

impl Replayer {
    /// Adds a reference chunk; call this before the record of the cycle in which the chunk took effect.
    pub fn take_chunk(&mut self, chunk: &ReferenceChunk) {
        self.reference.take_chunk(chunk);
    }

    /// Adds the next record. Returns an earlier cycle whose events are complete.
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
        self.waiting.push_back(WaitingRecord {
            follows_gap: last.is_some_and(|last| record.header.sequence != last.sequence + 1),
            is_first: !is_same,
            record: Box::new(*record),
        });
        if self.waiting.len() > EVENT_DELAY_RECORDS {
            self.finish_one()
        } else {
            Ok(None)
        }
    }

    /// The next cycle, after the last record was added; `None` when all are computed.
    ///
    /// # Errors
    /// [`ReplayError`].
    pub fn finish_one(&mut self) -> Result<Option<ReplayedCycle>, ReplayError> {
        let Some(next) = self.waiting.pop_front() else {
            return Ok(None);
        };
        let WaitingRecord {
            record,
            follows_gap,
            is_first,
        } = next;
        if is_first {
            let robot = robot_of(&record.robot)?;
            self.reference.begin(&robot);
            self.daemon_state = Some(DaemonState {
                computer: Computer::new(robot, &record)?,
                modes: Modes::default(),
            });
        }
        let Some(parts) = &mut self.daemon_state else {
            return Ok(None);
        };
        if follows_gap {
            self.reference.note_missing_records();
            parts.modes.forget();
        }
        self.reference.advance_to(&record);
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

    /// Computes the command of the last returned cycle with other `settings`, from the same inputs and
    /// without a time limit. `None` when the cycle did not solve or its reference is unknown.
    /// did not solve, or its reference is not known.
    ///
    /// # Errors
    /// [`ReplayError`].
    pub fn what_if(
        &mut self,
        cycle: &ReplayedCycle,
        settings: &SolverSettings,
    ) -> Result<Option<WhatIf>, ReplayError> {
        match &mut self.daemon_state {
            Some(parts) if cycle.outcome != Outcome::WithoutReference => {
                let reference = &mut self.reference;
                parts.computer.what_if(&cycle.record, settings, reference)
            }
            _ => Ok(None),
        }
    }

    /// The reference chunks around the last returned cycle, oldest first: a file needs them to make the cycle
    /// reproducible.
    pub fn chunks_in_force(&self) -> Vec<ReferenceChunk> {
        self.reference.chunks_in_force()
    }
}
