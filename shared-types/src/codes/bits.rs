//! The fields of bits on the wire.

/// Bits of [`Telemetry::timing_flags`](crate::Telemetry::timing_flags).
pub mod timing {
    /// The cycle started later than the late-start limit after its release.
    pub const LATE_START: u32 = 1;
    /// The command was handed over after the deadline.
    pub const DEADLINE_MISS: u32 = 1 << 1;
    /// No gather came between the cycle before and this one: it used the same inputs again.
    pub const STALE_INPUTS: u32 = 1 << 2;
}

/// Bits of [`Telemetry::guard_flags`](crate::Telemetry::guard_flags).
pub mod guard {
    /// A rate was cut to its limit.
    pub const RATE: u32 = 1;
    /// A bend was kept inside its limit.
    pub const BEND: u32 = 1 << 1;
    /// All rates were scaled down to the cable speed limit.
    pub const CABLE_SPEED: u32 = 1 << 2;
    /// The command was replaced because it was not finite.
    pub const NON_FINITE: u32 = 1 << 3;
    /// The clearance guard changed the command.
    pub const CLEARANCE: u32 = 1 << 4;
    /// All rates were scaled down to keep the strokes of the cables.
    pub const CABLE_STROKE: u32 = 1 << 5;
    /// A rate was kept within the largest acceleration.
    pub const ACCELERATION: u32 = 1 << 6;

    /// Every bit with its name.
    pub const ALL: &[(u32, &str)] = &[
        (RATE, "rate"),
        (BEND, "bend"),
        (CABLE_SPEED, "cable speed"),
        (NON_FINITE, "not finite"),
        (CLEARANCE, "clearance"),
        (CABLE_STROKE, "cable stroke"),
        (ACCELERATION, "acceleration"),
    ];
}

/// Bits of [`Status::realtime_missing`](crate::Status::realtime_missing).
pub mod realtime {
    /// The real-time threads do not have `SCHED_FIFO`.
    pub const FIFO: u32 = 1;
    /// The real-time threads are not pinned to their core.
    pub const PINNED: u32 = 1 << 1;
    /// Memory is not locked.
    pub const LOCKED: u32 = 1 << 2;
    /// Real time was switched off in the configuration.
    pub const OFF: u32 = 1 << 3;

    /// Every bit with its name and what would mend it.
    pub const ALL: &[(u32, &str, &str)] = &[
        (
            FIFO,
            "SCHED_FIFO",
            "run as the service, or grant rtprio 90 (limits.d, or --ulimit in a container)",
        ),
        (
            PINNED,
            "core pinning",
            "choose a core that the process may use (realtime.core)",
        ),
        (
            LOCKED,
            "locked memory",
            "run as the service, or grant memlock unlimited (limits.d, or --ulimit in a container)",
        ),
        (
            OFF,
            "real time",
            "set realtime.mode to \"prefer\" or \"require\"",
        ),
    ];
}
