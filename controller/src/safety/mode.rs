//! The mode machine.
//!
//! ```text
//!  Starting ──► Holding ◄─────────────► Tracking      Holding: rates ramp to zero, position kept
//!                │  ▲  track, lease, fresh reference   Tracking: NMPC follows the reference
//!           home │  │ arrived, hold                     Homing: straight line to the straight robot
//!                ▼  │
//!               Homing
//!
//!  any but Faulted ── stop, leaky bucket, suspend ──► Stopped   latched: rates ramp to zero, until reset
//!  any ── measurement lost, jumps or frozen, non-finite, limit, contact, does not follow, cables slack ──► Faulted(cause)   latched
//!  Tracking, Homing ── stale inputs, silent source of obstacles ──► Holding
//!  Tracking ── replaced by a reference that is too far ──► Holding
//!  Stopped, Faulted ── reset, cause gone, measured where the last command left the robot or accepted there ──► Holding
//!  Starting ──► Stopped, not Holding, where the robot was stopped or faulted before the process was started
//! ```

use crate::reference::ReferenceState;

/// Why the machine is in its mode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Reason {
    /// Nothing happened yet.
    #[default]
    Start,
    /// A client asked for it.
    Request,
    /// The reference came to its end.
    ReferenceEnded,
    /// The holder of the reference lease fell silent.
    LeaseExpired,
    /// The straight configuration is reached.
    HomeReached,
    /// Too many deadlines were missed.
    DeadlineMisses,
    /// There is no fresh measurement.
    MeasurementLost,
    /// A measurement or a result was not finite.
    NonFinite,
    /// A measured bend is beyond what the robot can have.
    LimitBroken,
    /// The process ends.
    Shutdown,
    /// The reference lease was given back.
    LeaseReleased,
    /// The body is closer to an obstacle than the fault threshold.
    ClearanceBroken,
    /// The measurement repeatedly jumped farther than the robot can move.
    MeasurementJump,
    /// The measurement stood still while the robot was commanded to move.
    MeasurementFrozen,
    /// The measured configuration is too far from the commanded one.
    FollowingError,
    /// The inputs are too old to compute a command.
    InputsStale,
    /// The machine slept.
    Suspended,
    /// The source of the obstacles is silent.
    ObstacleSourceSilent,
    /// A new reference is too far from the tip to be approached.
    ReferenceTooFar,
    /// The common mode of a section's cables changed.
    CommonMode,
    /// The robot was stopped or faulted before the process was restarted.
    StoppedBefore,
    /// The robot is measured far from where its last command left it: a reason to refuse a reset, not of a mode.
    PoseDiffers,
    /// The obstacles known before the process was restarted are lost.
    ObstaclesLost,
    /// The tip is measured far from where the measured bends place it: a reason to refuse a reset, not of a mode.
    TipElsewhere,
}

/// The mode with its state.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Mode {
    /// Before the first good cycle.
    #[default]
    Starting,
    /// At rest, or on the ramp to it; after a reset, a commanded position first moves to the robot.
    Holding {
        /// Why the robot rests.
        reason: Reason,
    },
    /// Following the reference.
    Tracking {
        /// Whether the reference has begun; before, the robot approaches its first point.
        begun: bool,
    },
    /// On the way to the straight configuration.
    Homing,
    /// Latched at rest.
    Stopped {
        /// Why it was stopped.
        reason: Reason,
    },
    /// Latched at rest by a fault.
    Faulted {
        /// Why it is faulted.
        reason: Reason,
    },
}

impl Mode {
    /// Whether only a reset ends this mode.
    pub fn is_latched(&self) -> bool {
        matches!(self, Self::Stopped { .. } | Self::Faulted { .. })
    }

    /// Whether the robot rests in this mode, or comes to rest: nothing may increase its rates, except where a
    /// commanded position moves to the robot after a reset.
    pub fn comes_to_rest(&self) -> bool {
        !matches!(self, Self::Tracking { .. } | Self::Homing)
    }

    /// Why the machine is in this mode.
    pub fn reason(&self) -> Reason {
        match self {
            Self::Starting => Reason::Start,
            Self::Tracking { .. } | Self::Homing => Reason::Request,
            Self::Holding { reason } | Self::Stopped { reason } | Self::Faulted { reason } => {
                *reason
            }
        }
    }
}

/// Requests to the machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Request {
    /// Track the reference of one lease. A request for one lease does not apply to the next holder's
    /// reference.
    Track {
        /// Number of the lease.
        lease_number: u32,
    },
    /// Stop tracking.
    Hold,
    /// Move to the straight configuration.
    Home,
    /// Stop and latch.
    Stop,
    /// Leave a latched mode.
    Reset,
    /// The same where the robot is measured far from where its last command left it: control begins where it is
    /// measured.
    ResetAcceptingPose,
}

/// Why a request is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// The mode does not allow it.
    WrongMode,
    /// Nobody holds the reference lease, or its holder changed after the request.
    NoLease,
    /// No reference lies ahead.
    NoReference,
    /// The reference is too far from the tip to be approached.
    TooFar,
    /// The cause of the fault persists.
    CauseStands,
    /// The robot is measured far from where its last command left it, and the request does not accept this.
    PoseDiffers,
    /// The tip is measured far from where the measured bends place it, whether the request accepts the pose or not.
    TipElsewhere,
    /// The robot must wait, without a fault: [`Observation::wait`].
    Waits,
    /// A stop or a fault came after the request, or in the same cycle.
    Overruled,
    /// The process ends.
    Ending,
}

/// State of the reference lease in a cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LeaseState {
    /// Nobody holds it: it was never taken, or given back.
    #[default]
    Free,
    /// A client holds it.
    Held,
    /// Its holder fell silent.
    Expired,
}

/// Inputs of the machine in one cycle.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Observation {
    /// Whether the configuration of the robot is known. The machine stays in `Starting` until it is.
    pub measured: bool,
    /// Position of this release relative to the reference.
    pub reference: ReferenceState,
    /// Whether the reference is too far from the tip to be tracked.
    pub too_far: bool,
    /// The reference lease.
    pub lease: LeaseState,
    /// Number of the lease; each acquisition increments it.
    pub lease_number: u32,
    /// Whether the robot is straight.
    pub at_home: bool,
    /// Whether the leaky bucket of deadline misses overflows.
    pub misses_overflow: bool,
    /// Whether the machine slept since the cycle before.
    pub suspended: bool,
    /// Why the robot must wait now, without a fault.
    pub wait: Option<Reason>,
    /// A fault that is present in this cycle.
    pub fault: Option<Reason>,
    /// Whether the newest measurement was rejected: where the robot is measured is not known.
    pub measurement_rejected: bool,
    /// Distance of the measured tip from where the measured bends place it (m), where it is so far that one of the two is wrong;
    /// else 0.
    pub tip_contradiction_m: f64,
    /// Whether the robot is measured far from where its last command left it.
    pub pose_differs: bool,
}

impl Observation {
    /// Why a reset is refused in this cycle; `None`: it is not.
    pub fn reset_refused_by(&self) -> Option<Reason> {
        if !self.measured {
            return Some(Reason::MeasurementLost);
        }
        let misses = self.misses_overflow.then_some(Reason::DeadlineMisses);
        let rejected = self.measurement_rejected.then_some(Reason::MeasurementJump);
        let tip = (self.tip_contradiction_m > 0.0).then_some(Reason::TipElsewhere);
        let pose = self.pose_differs.then_some(Reason::PoseDiffers);
        (self.fault.or(misses).or(rejected)).or(tip).or(pose)
    }
}

/// The mode and its transitions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ModeMachine {
    mode: Mode,
    /// Number of the lease that is tracked, or was tracked last.
    tracked_lease: u32,
    faults: u64,
    ends: bool,
    stopped_before: Option<Reason>,
}

impl ModeMachine {
    /// A machine that resumes from a record, with the number of the tracked lease.
    pub fn resumed(mode: Mode, lease_number: u32) -> Self {
        Self {
            mode,
            tracked_lease: lease_number,
            ..Self::default()
        }
    }

    /// A machine for a robot that waits for a reset from the start on: it was stopped or faulted before, or its obstacles are lost.
    pub fn stopped_before(reason: Reason) -> Self {
        Self {
            stopped_before: Some(reason),
            ..Self::default()
        }
    }

    /// The present mode.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// Faults since the start.
    pub fn faults(&self) -> u64 {
        self.faults
    }

    /// Updates the mode from the observation, once per cycle and before requests.
    pub fn observe(&mut self, seen: &Observation) {
        if !seen.measured {
            return;
        }
        if let Some(cause) = seen.fault {
            self.fault(cause);
        } else if seen.suspended && !self.mode.is_latched() {
            self.mode = Mode::Stopped {
                reason: Reason::Suspended,
            };
        } else if seen.misses_overflow && !self.mode.is_latched() {
            self.mode = Mode::Stopped {
                reason: Reason::DeadlineMisses,
            };
        }
        if let (Some(reason), Mode::Tracking { .. } | Mode::Homing) = (seen.wait, self.mode) {
            self.hold(reason);
        }
        match self.mode {
            Mode::Starting => match self.stopped_before {
                Some(reason) => self.mode = Mode::Stopped { reason },
                None => self.hold(Reason::Start),
            },
            Mode::Tracking { .. } => self.keep_tracking(seen),
            Mode::Homing if seen.at_home => self.hold(Reason::HomeReached),
            _ => {}
        }
    }

    /// Executes a request or refuses it. A stop is never refused.
    ///
    /// # Errors
    /// [`Refusal`]; the mode is then unchanged.
    pub fn request(&mut self, request: Request, seen: &Observation) -> Result<(), Refusal> {
        if self.ends && request != Request::Stop {
            return Err(Refusal::Ending);
        }
        match (request, self.mode) {
            // A latched mode keeps its first reason, except that a request to stop replaces a shutdown.
            (
                Request::Stop,
                Mode::Stopped {
                    reason: Reason::Shutdown,
                },
            ) => {
                self.mode = Mode::Stopped {
                    reason: Reason::Request,
                };
                Ok(())
            }
            (Request::Stop, Mode::Faulted { .. } | Mode::Stopped { .. })
            | (Request::Reset | Request::ResetAcceptingPose, Mode::Holding { .. })
            | (Request::Track { .. }, Mode::Tracking { .. }) => Ok(()),
            (Request::Stop, _) => {
                self.mode = Mode::Stopped {
                    reason: Reason::Request,
                };
                Ok(())
            }
            (
                Request::Reset | Request::ResetAcceptingPose,
                Mode::Stopped { .. } | Mode::Faulted { .. },
            ) => self.reset(request, seen),
            (Request::Hold, Mode::Holding { .. } | Mode::Tracking { .. } | Mode::Homing) => {
                self.hold(Reason::Request);
                Ok(())
            }
            (Request::Track { .. } | Request::Home, Mode::Holding { .. })
                if seen.wait.is_some() =>
            {
                Err(Refusal::Waits)
            }
            (Request::Track { lease_number }, Mode::Holding { .. }) => {
                self.track(lease_number, seen)
            }
            (Request::Home, Mode::Holding { .. } | Mode::Homing) => {
                self.mode = Mode::Homing;
                Ok(())
            }
            _ => Err(Refusal::WrongMode),
        }
    }

    /// Executes the requests of one cycle in order. If a stop is among them, or `stop_at_once` is set, only
    /// the stop is executed. Returns the answers.
    pub fn requests<const N: usize>(
        &mut self,
        requests: &[Option<Request>; N],
        stop_at_once: bool,
        seen: &Observation,
    ) -> [Option<Result<(), Refusal>>; N] {
        let stops = stop_at_once || requests.contains(&Some(Request::Stop));
        if stops {
            // Never refused.
            let _ = self.request(Request::Stop, seen);
        }
        requests.map(|asked| {
            asked.map(|request| match request {
                Request::Stop => Ok(()),
                _ if self.ends => Err(Refusal::Ending),
                _ if stops => Err(Refusal::Overruled),
                request => self.request(request, seen),
            })
        })
    }

    /// Enters `Faulted` for a fault found after the observation of this cycle, in the solution or the
    /// command.
    pub fn fault(&mut self, cause: Reason) {
        if !matches!(self.mode, Mode::Faulted { .. }) {
            self.faults += 1;
            self.mode = Mode::Faulted { reason: cause };
        }
    }

    /// The process ends: the robot comes to rest, and all further requests but stops are refused. A fault
    /// keeps its cause.
    pub fn shut_down(&mut self) {
        let is_new = !core::mem::replace(&mut self.ends, true);
        if is_new && !matches!(self.mode, Mode::Faulted { .. }) {
            self.mode = Mode::Stopped {
                reason: Reason::Shutdown,
            };
        }
    }

    /// Tracking continues while its lease is held and its reference lasts.
    fn keep_tracking(&mut self, seen: &Observation) {
        match (seen.lease, seen.reference) {
            (LeaseState::Expired, _) => self.hold(Reason::LeaseExpired),
            (LeaseState::Free, _) => self.hold(Reason::LeaseReleased),
            // The lease was acquired again: the reference is another client's, who has not requested
            // tracking.
            (LeaseState::Held, _) if seen.lease_number != self.tracked_lease => {
                self.hold(Reason::LeaseExpired);
            }
            (LeaseState::Held, ReferenceState::Ended | ReferenceState::None) => {
                self.hold(Reason::ReferenceEnded);
            }
            (LeaseState::Held, ReferenceState::Inside) => {
                self.mode = Mode::Tracking { begun: true };
            }
            (LeaseState::Held, ReferenceState::Before) => {}
        }
    }

    fn hold(&mut self, reason: Reason) {
        self.mode = Mode::Holding { reason };
    }

    fn track(&mut self, lease_number: u32, seen: &Observation) -> Result<(), Refusal> {
        match seen.reference {
            _ if seen.lease != LeaseState::Held || seen.lease_number != lease_number => {
                Err(Refusal::NoLease)
            }
            ReferenceState::None | ReferenceState::Ended => Err(Refusal::NoReference),
            ReferenceState::Before | ReferenceState::Inside if seen.too_far => Err(Refusal::TooFar),
            ReferenceState::Before | ReferenceState::Inside => {
                self.mode = Mode::Tracking { begun: false };
                self.tracked_lease = lease_number;
                Ok(())
            }
        }
    }

    fn reset(&mut self, request: Request, seen: &Observation) -> Result<(), Refusal> {
        match seen.reset_refused_by() {
            Some(Reason::PoseDiffers) if request == Request::ResetAcceptingPose => {}
            Some(Reason::PoseDiffers) => return Err(Refusal::PoseDiffers),
            // Who accepts the pose has it from the same bends.
            Some(Reason::TipElsewhere) => return Err(Refusal::TipElsewhere),
            Some(_) => return Err(Refusal::CauseStands),
            None => {}
        }
        self.hold(Reason::Request);
        Ok(())
    }
}

#[cfg(test)]
mod tests;
