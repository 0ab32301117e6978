//! Enumerations of the domain and their codes on the wire, with equal names. A missing variant does not
//! compile.

use cdcr_controller::nmpc::{Constraint, SolveStatus};
use cdcr_controller::optimizer::Candidate;
use cdcr_controller::reference::ReferenceState;
use cdcr_controller::safety::{LeaseState, Mode, Reason, Refusal};
use cdcr_shared_types::{
    codes, lease_states, measurement_states, modes, reasons, reference_states, robot_links,
    solver_statuses, winners,
};

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
    /// Part of a command that the driver executes.
    pub interface: Interface => Interface { Velocity, Position }
    pub tip_cause: TipCause => TipCause { Far, WasFar, Jumps, Jumped, Frozen }
    /// A violated constraint.
    pub(super) constraint: Constraint => Constraint { Clearance, Limit }
}

// Enumerations with the same variants.
modes!(to_wire pub mode: Mode =>);
reasons!(to_wire pub reason: Reason =>);
robot_links!(to_wire pub link: LinkKind =>);
lease_states!(to_wire pub(super) lease_state: LeaseState =>);
measurement_states!(to_wire pub(super) measurement_state: MeasurementUse =>);
reference_states!(to_wire pub(super) reference_state: ReferenceState =>);
solver_statuses!(to_wire pub(super) solver_status: SolveStatus =>);
winners!(to_wire pub(super) winner: Candidate =>);
