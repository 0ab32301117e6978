//! Enumerations of the domain and their codes on the wire, with equal names. A missing variant does not
//! compile.

use cdcr_controller::nmpc::{Constraint, SolveStatus};
use cdcr_controller::optimizer::Candidate;
use cdcr_controller::reference::ReferenceState;
use cdcr_controller::safety::{LeaseState, Mode, Reason, Refusal};
use cdcr_shared_types::codes;

use crate::config::{Interface, LinkKind};
use crate::handover::{MeasurementUse, TipCause};

macro_rules! to_wire {
    ($($(#[$meta:meta])* $vis:vis $name:ident: $domain:ident => $code:ident { $($variant:ident),+ $(,)? })+) => { $(
        $(#[$meta])*
        $vis fn $name(value: $domain) -> codes::$code {
            match value { $($domain::$variant { .. } => codes::$code::$variant,)+ }
        }
    )+ };
}

to_wire! {
    /// A refusal of the mode machine.
    pub refusal: Refusal => Outcome { WrongMode, NoLease, NoReference, TooFar, CauseStands, PoseDiffers, TipElsewhere, Waits, Overruled, Ending }
    pub mode: Mode => Mode { Starting, Holding, Tracking, Homing, Stopped, Faulted }
    /// Reason of a mode.
    pub reason: Reason => Reason {
        Start, Request, ReferenceEnded, LeaseExpired, HomeReached, DeadlineMisses, MeasurementLost, NonFinite,
        LimitBroken, Shutdown, LeaseReleased, ClearanceBroken, MeasurementJump, MeasurementFrozen, FollowingError,
        InputsStale, Suspended, ObstacleSourceSilent, ReferenceTooFar, CommonMode, StoppedBefore, PoseDiffers,
        ObstaclesLost, TipElsewhere,
    }
    /// Part of a command that the driver executes.
    pub interface: Interface => Interface { Velocity, Position }
    pub link: LinkKind => RobotLink { Simulated, Driver }
    pub(super) lease_state: LeaseState => LeaseState { Free, Held, Expired }
    pub(super) measurement_state: MeasurementUse => MeasurementState { None, Used, Repeated, Implausible }
    pub tip_cause: TipCause => TipCause { Far, WasFar, Jumps, Jumped, Frozen }
    /// A violated constraint.
    pub(super) constraint: Constraint => Constraint { Clearance, Limit }
    /// Status of a solve.
    pub(super) solver_status: SolveStatus => SolverStatus {
        Idle, Converged, BudgetSpent, IterationsSpent, ConstraintViolated, NonFinite,
    }
    /// Origin of the solution among the candidates.
    pub(super) winner: Candidate => Winner { WarmStart, Previous, Zero, LeastSquares, Eigenvector, Swarm }
    /// Position of a time relative to the reference.
    pub(super) reference_state: ReferenceState => ReferenceState { None, Before, Inside, Ended }
}
