//! The enumerations of the wire protocol: `u32` values that another process writes, and their meanings.
//!
//! `TryFrom<u32>` is the only conversion, so unknown codes are rejected. Values are never reused; new ones are added at
//! the end.

mod bits;

pub use bits::{RTPRIO_GRANTED, guard, realtime, timing};

/// Declares a wire enumeration with its values, its checked conversion and a text for users, which begins its
/// documentation. With `($ names)` it also exports the macro `names`, for conversions of an enumeration with the same variants:
/// `names!(with …)` calls the macro `with` with `… Name { Variant, … }`.
macro_rules! wire_enum {
    (($d:tt $names:ident) $(#[$meta:meta])* $name:ident {
        $($(#[doc = $doc:literal])* $variant:ident = $value:literal: $text:literal,)+
    }) => {
        wire_enum! { $(#[$meta])* $name { $($(#[doc = $doc])* $variant = $value: $text,)+ } }

        #[doc = concat!("Calls a macro with the variants of [`codes::", stringify!($name), "`](crate::codes::", stringify!($name), ").")]
        #[macro_export]
        macro_rules! $names {
            ($d with:ident $d($d more:tt)*) => { $d with! { $d($d more)* $name { $($variant,)+ } } };
        }
    };
    ($(#[$meta:meta])* $name:ident { $($(#[doc = $doc:literal])* $variant:ident = $value:literal: $text:literal,)+ }) => {
        $(#[$meta])*
        #[repr(u32)]
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub enum $name { $(#[doc = concat!("“", $text, "”.")] $(#[doc = $doc])* $variant = $value,)+ }

        impl $name {
            /// Every value, in the order of the codes.
            pub const ALL: &'static [Self] = &[$(Self::$variant,)+];
            /// Number of codes; codes run from 0 to `COUNT` - 1.
            pub const COUNT: usize = Self::ALL.len();

            /// The value on the wire.
            pub const fn code(self) -> u32 { self as u32 }

            /// Meaning in words.
            pub const fn text(self) -> &'static str {
                match self { $(Self::$variant => $text,)+ }
            }

            /// Values, names and texts, for code that walks a message.
            pub const CODES: &'static Codes = &Codes {
                name: stringify!($name),
                values: &[$(($value, stringify!($variant), $text),)+],
            };

            /// The text of a code from the wire, known or not.
            pub fn text_of(code: u32) -> &'static str { Self::CODES.text(code) }
        }

        /// The first value: that of a message of zero bytes, if it has the code 0.
        impl Default for $name {
            fn default() -> Self { Self::ALL[0] }
        }

        impl TryFrom<u32> for $name {
            type Error = UnknownCode;
            fn try_from(code: u32) -> Result<Self, UnknownCode> {
                match code { $($value => Ok(Self::$variant),)+ _ => Err(UnknownCode { code }) }
            }
        }

        impl core::fmt::Display for $name {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result { f.write_str(self.text()) }
        }
    };
}

/// Names and texts of an enumeration.
#[derive(Debug)]
pub struct Codes {
    /// Name of the enumeration.
    pub name: &'static str,
    /// Value, name and text of each code.
    pub values: &'static [(u32, &'static str, &'static str)],
}

impl Codes {
    /// Meaning of a code from the wire, in words.
    pub fn text(&self, code: u32) -> &'static str {
        let known = self.values.iter().find(|(value, ..)| *value == code);
        known.map_or("unknown code", |(_, _, text)| text)
    }
}

/// A `u32` that is not a value of the enumeration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UnknownCode {
    /// The value found.
    pub code: u32,
}

impl core::fmt::Display for UnknownCode {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "unknown code {}", self.code)
    }
}

impl core::error::Error for UnknownCode {}

// After the macro that it uses.
mod measured;

pub use measured::{MeasurementKind, MeasurementState, TipCause};

wire_enum! {
    /// The part of a reference point's orientation that is followed.
    OrientationKind {
        /// Position only.
        None = 0: "none",
        /// The direction of the tip axis.
        Axis = 1: "tip axis",
        /// All three angles.
        Full = 2: "full orientation",
        /// The direction of the tip axis that the daemon prefers where the position leaves a choice.
        Preferred = 3: "preferred tip axis",
    }
}

wire_enum! {
    /// Effect of a reference chunk on the trajectory.
    ChunkMode {
        /// Begin a new trajectory; buffered points are discarded.
        Replace = 0: "replace",
        /// Continue the trajectory after its last point.
        Append = 1: "append",
    }
}

wire_enum! {
    ($ interpolations)
    /// Interpolation of positions between points.
    Interpolation {
        /// Straight lines.
        Linear = 0: "linear",
        /// Cubic Hermite curve with finite-difference tangents: fourth order on smooth references.
        Cubic = 1: "cubic",
    }
}

wire_enum! {
    /// Shape of an obstacle.
    ObstacleShape {
        /// All points within a radius of a centre.
        Sphere = 0: "sphere",
        /// All points within a radius of a line segment.
        Capsule = 1: "capsule",
    }
}

wire_enum! {
    /// Effect of an obstacle message.
    ObstacleAction {
        /// Insert, or replace by id.
        Upsert = 0: "upsert",
        /// Remove by id.
        Remove = 1: "remove",
        /// Remove all.
        Clear = 2: "clear",
    }
}

wire_enum! {
    ($ robot_links)
    /// Source of measurements and destination of commands.
    RobotLink {
        /// The simulated robot inside the daemon.
        Simulated = 0: "simulated",
        /// A driver process on the measurement and command services.
        Driver = 1: "driver",
    }
}

wire_enum! {
    /// The part of a command that a driver follows.
    Interface {
        /// Not specified.
        None = 0: "none",
        /// The speeds: motors with their own speed control.
        Velocity = 1: "velocity",
        /// The positions: motors with their own position control.
        Position = 2: "position",
    }
}

wire_enum! {
    ($ modes)
    /// Mode of the daemon.
    Mode {
        /// Before the first good cycle.
        Starting = 0: "starting",
        /// Rates ramp to zero; the position is kept.
        Holding = 1: "holding",
        /// The controller follows the reference.
        Tracking = 2: "tracking",
        /// Moves to the straight configuration.
        Homing = 3: "homing",
        /// Latched until reset: rates zero.
        Stopped = 4: "stopped",
        /// Latched until reset, like stopped, with a cause.
        Faulted = 5: "faulted",
    }
}

impl Mode {
    /// Whether only a reset lets the robot move in the mode with this code.
    pub fn is_latched(code: u32) -> bool {
        [Self::Stopped, Self::Faulted]
            .map(Self::code)
            .contains(&code)
    }
}

wire_enum! {
    ($ reasons)
    /// Reason for the mode of the daemon.
    Reason {
        /// Initial value.
        Start = 0: "started",
        /// A client requested it.
        Request = 1: "requested",
        ReferenceEnded = 2: "the reference ended",
        /// The holder of the lease has been silent.
        LeaseExpired = 3: "the reference lease expired",
        HomeReached = 4: "home is reached",
        DeadlineMisses = 5: "too many deadline misses (cycle.miss_limit)",
        /// The driver sends no fresh measurement.
        MeasurementLost = 6: "the measurement is lost",
        /// A measurement or a result was not a finite number.
        NonFinite = 7: "a value was not finite",
        /// The measured bend is beyond the limits.
        LimitBroken = 8: "a limit is exceeded",
        /// The body came too close to an obstacle.
        ClearanceBroken = 9: "the clearance is too small (safety.clearance_fault_m)",
        Shutdown = 10: "the daemon is shutting down",
        LeaseReleased = 11: "the reference lease was released",
        /// The measurement jumped farther than the robot can move.
        MeasurementJump = 12: "the measurement jumps",
        /// The measurement did not change although the robot was commanded to move.
        MeasurementFrozen = 13: "the measurement is frozen",
        /// The measured configuration is too far from the commanded one.
        FollowingError = 14: "the following error is too large (safety.following_fault_rad)",
        /// No gather brought new inputs for longer than a command is valid.
        InputsStale = 15: "the inputs are stale",
        Suspended = 16: "the machine was suspended",
        ObstacleSourceSilent = 17: "the source of the obstacles is silent (obstacles.source_timeout_ms)",
        ReferenceTooFar = 18: "the reference was replaced by one farther from the tip than motion.approach_distance_m",
        /// The mean length of a section's three cables changed by more than any bend does.
        CommonMode = 19: "the cables of a section went slack, or one broke (safety.cable_common_m)",
        /// The daemon was restarted since, without a reset.
        StoppedBefore = 20: "it was stopped or faulted before the daemon started; use cdcrctl reset",
        /// Refuses a reset that does not accept the measured pose; never the reason of a mode.
        PoseDiffers = 21: "the robot is measured far from where its last command left it",
        /// Another version of cdcrd, or another program, has written their file.
        ObstaclesLost = 22: "the obstacles of the previous daemon are lost; add them again, then use cdcrctl reset",
        /// Refuses a reset, also one that accepts the measured pose; never the reason of a mode.
        TipElsewhere = 23: "the tip is measured far from where the bends place it",
    }
}

wire_enum! {
    /// Kind of a client's request.
    RequestKind {
        /// Follow the reference.
        Track = 1: "track",
        /// Stop following, keep the position.
        Hold = 2: "hold",
        /// Stop and latch.
        Stop = 3: "stop",
        /// Leave the modes stopped and faulted.
        Reset = 4: "reset",
        /// Move to the straight configuration.
        Home = 5: "home",
        /// Acquire or renew the reference lease.
        AcquireLease = 6: "acquire the lease",
        ReleaseLease = 7: "release the lease",
        Settings = 8: "change settings",
        ResetStatistics = 9: "reset the statistics",
        /// Only in events: a reset with `accepts_pose`.
        ResetAcceptingPose = 10: "reset, accepting the measured pose",
    }
}

wire_enum! {
    /// Outcome of an input message or a request.
    Outcome {
        /// It took effect.
        Accepted = 0: "accepted",
        NotFinite = 1: "a value is not a finite number",
        InThePast = 2: "a time is in the past",
        /// A position is farther from the base than the robot is long.
        OutOfReach = 3: "a position is outside the reachable ball",
        /// A time is less than a microsecond after the previous one.
        TimeNotIncreasing = 4: "times do not increase",
        NoLease = 5: "the sender does not hold the reference lease",
        /// A chunk before this one was lost or rejected.
        SequenceGap = 6: "an earlier chunk is missing",
        BufferFull = 7: "the buffer is full",
        CountOutOfRange = 8: "a count is out of range",
        UnknownCode = 9: "a code is unknown",
        /// An orientation is not a unit vector or quaternion.
        NotUnit = 10: "an orientation is not of unit length",
        Unsupported = 11: "this daemon does not support it",
        LeaseHeld = 12: "another client holds the reference lease",
        NoReference = 13: "there is no reference ahead",
        WrongMode = 14: "the mode does not allow it",
        CauseStands = 15: "the cause of the fault persists",
        OutOfRange = 16: "a value is out of range",
        /// Too many requests at once; try again.
        Busy = 17: "too many requests at once",
        /// The message is repeated or older than one already received.
        Stale = 18: "the message is older than one already seen",
        /// The section count is not that of the robot.
        WrongRobot = 19: "the message belongs to another robot",
        /// A stop or a fault came after the request, or in the same cycle.
        Overruled = 20: "the robot was stopped after this request",
        Ending = 21: "the daemon is shutting down",
        /// The driver follows positions and the daemon is configured for speeds, or the reverse.
        WrongInterface = 22: "the driver's interface differs from the configuration (link.interface)",
        OtherDriver = 23: "another driver controls the robot",
        /// The robot waits without a fault; the request may be repeated.
        Waits = 24: "the robot waits: the inputs are stale, a source of obstacles is silent (obstacles.source_timeout_ms), or the commanded position moves to the robot after a reset",
        TooFar = 25: "the reference is farther from the tip than motion.approach_distance_m",
        /// More than a tenth of the backbone: no stroke of a bend changes the mean.
        CableMean = 26: "the mean length of a section's cables is not that of its backbone",
        /// More than a millisecond ahead of the daemon's clock.
        InTheFuture = 27: "a time is in the future",
        /// A reset without `accepts_pose`: a section is measured more than 0.2 rad from where the last command left it.
        PoseDiffers = 28: "the robot is measured far from where its last command left it",
        /// A first bend of a driver beyond 2π rad.
        BeyondTurn = 29: "a bend is larger than a full turn",
        /// More than a ninth of the robot's length, or 0.1 m, when a tip sensor measures beside the first bends of a driver, or in
        /// a reset.
        TipElsewhere = 30: "the tip is measured far from where the bends place it",
    }
}

wire_enum! {
    /// Kind of message that an event reports.
    EventKind {
        Reference = 0: "reference",
        Obstacles = 1: "obstacles",
        /// A measurement; only rejected ones are reported.
        Measurement = 2: "measurement",
        Request = 3: "request",
    }
}

wire_enum! {
    ($ reference_states)
    /// Position of a time relative to the buffered reference.
    ReferenceState {
        None = 0: "no reference",
        /// Before its first point, which is held.
        Before = 1: "before the start",
        Inside = 2: "inside",
        /// After its last point, which is held.
        Ended = 3: "ended",
    }
}

wire_enum! {
    ($ lease_states)
    /// State of the reference lease in a cycle.
    LeaseState {
        /// Nobody holds it.
        Free = 0: "free",
        /// A client holds it.
        Held = 1: "held",
        /// Its holder has been silent.
        Expired = 2: "expired",
    }
}

wire_enum! {
    /// Cause of a late cycle: the largest part of its lateness.
    LateCause {
        None = 0: "in time",
        /// The wake-up itself was late with the core free (timer, firmware), or the hypervisor used the core.
        Platform = 1: "platform",
        Load = 2: "another task had the core",
        /// Memory was not present when it was accessed.
        PageFault = 3: "page fault",
        /// The processor stalled during the computation: interrupt, firmware or hypervisor.
        Stall = 4: "stall of the processor",
        /// The computation of the cycle took too long.
        Compute = 5: "compute",
    }
}

wire_enum! {
    ($ solver_kinds)
    /// Method for the optimal control problem.
    SolverKind {
        /// Knowledge-based particle swarm, Eq. 6-7.
        Kpso = 0: "kpso",
        /// Damped Gauss-Newton steps, projected on the box.
        GaussNewton = 1: "gauss-newton",
        /// Gauss-Newton refines; the swarm selects the basin if an error remains.
        KpsoRefined = 2: "kpso-refined",
    }
}

wire_enum! {
    ($ coordinate_kinds)
    /// Coordinates in which the controls are constant over a block.
    Coordinates {
        /// Bend-vector rates (u̇, v̇).
        BendVector = 0: "bend-vector",
        /// The paper's (θ̇, φ̇).
        BendAngles = 1: "bend-angles",
    }
}

wire_enum! {
    ($ velocity_rules)
    /// Update rule of a particle's velocity.
    VelocityRule {
        /// Eq. 6 with an inertia weight.
        Inertia = 0: "inertia",
        /// Clerc and Kennedy's constriction.
        Constriction = 1: "constriction",
        /// Eq. 6 as printed.
        Verbatim = 2: "verbatim",
    }
}

wire_enum! {
    /// A constraint that a solution breaks.
    Constraint {
        None = 0: "none",
        /// The safe distance from an obstacle.
        Clearance = 1: "clearance",
        /// A limit of bend, cable stroke or cable speed.
        Limit = 2: "limit",
    }
}

wire_enum! {
    ($ solver_statuses)
    /// End of a solve.
    SolverStatus {
        /// It did not run.
        Idle = 0: "idle",
        /// Converged within the tolerance.
        Converged = 1: "converged",
        /// The time budget ended; the best solution so far is used.
        BudgetSpent = 2: "budget spent",
        /// All iterations were used.
        IterationsSpent = 3: "iterations spent",
        /// The best solution violates a constraint.
        ConstraintViolated = 4: "constraint violated",
        /// The problem was not finite.
        NonFinite = 5: "not finite",
    }
}

wire_enum! {
    ($ winners)
    /// Candidate from which the solution descends.
    Winner {
        WarmStart = 0: "warm start",
        /// The previous plan, not shifted.
        Previous = 1: "previous plan",
        /// Zero rates.
        Zero = 2: "zero",
        /// The damped least-squares step.
        LeastSquares = 3: "least squares",
        /// A random particle.
        Swarm = 4: "swarm",
        /// A candidate along a Hessian eigenvector.
        Eigenvector = 5: "eigenvector",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_round_trip_and_unknown_ones_are_refused() {
        for &outcome in Outcome::ALL {
            assert_eq!(Outcome::try_from(outcome.code()), Ok(outcome));
        }
        let code = Outcome::COUNT as u32;
        assert_eq!(Outcome::try_from(code), Err(UnknownCode { code }));
        assert_eq!(Mode::text_of(77), "unknown code");
    }

    #[test]
    fn outcome_codes_index_the_counters_of_the_status() {
        for (index, outcome) in Outcome::ALL.iter().enumerate() {
            assert_eq!(outcome.code() as usize, index);
        }
    }
}
