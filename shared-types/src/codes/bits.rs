//! Bit fields of the wire protocol.

macro_rules! rtprio {
    () => {
        90
    };
}

/// The priority that the service unit and the package's `limits.d` file grant.
pub const RTPRIO_GRANTED: i32 = rtprio!();

/// Declares bits with their names and, if something is missing, its remedy.
macro_rules! wire_bits {
    ($($(#[$meta:meta])* $module:ident {
        $($(#[doc = $doc:literal])+ $bit:ident = $shift:literal: $name:literal $(, $remedy:expr)?;)+
    })+) => { $(
        $(#[$meta])*
        pub mod $module {
            $($(#[doc = $doc])+ pub const $bit: u32 = 1 << $shift;)+
            /// Every bit with its name and its remedy; empty: none.
            pub const ALL: &[(u32, &str, &str)] = &[$(($bit, $name, concat!($($remedy)?)),)+];

            /// Names and remedies of the bits that are set.
            pub fn set(bits: u32) -> impl Iterator<Item = (&'static str, &'static str)> {
                let set = ALL.iter().filter(move |(bit, ..)| bits & bit != 0);
                set.map(|&(_, name, remedy)| (name, remedy))
            }
        }
    )+ };
}

wire_bits! {
    /// Bits of [`Telemetry::timing_flags`](crate::Telemetry::timing_flags).
    timing {
        /// The cycle started later than the late-start limit after its release.
        LATE_START = 0: "late start";
        /// The command was handed over after the deadline.
        DEADLINE_MISS = 1: "deadline miss";
        /// No gather came between the cycle before and this one: it used the same inputs again.
        STALE_INPUTS = 2: "stale inputs";
    }

    /// Bits of [`Telemetry::guard_flags`](crate::Telemetry::guard_flags).
    guard {
        /// A rate was cut to its limit.
        RATE = 0: "rate";
        /// A bend was kept inside its limit.
        BEND = 1: "bend";
        /// All rates were scaled down to the cable speed limit.
        CABLE_SPEED = 2: "cable speed";
        /// The command was replaced because it was not finite.
        NON_FINITE = 3: "not finite";
        /// The clearance guard changed the command.
        CLEARANCE = 4: "clearance";
        /// All rates were scaled down to keep the strokes of the cables.
        CABLE_STROKE = 5: "cable stroke";
        /// A rate was kept within the largest acceleration.
        ACCELERATION = 6: "acceleration";
        /// All rates were scaled down to the speed limit of the section ends.
        TIP_SPEED = 7: "tip speed";
        /// All rates were scaled down, or are rest, because two parts of the body would have touched.
        SELF_CONTACT = 8: "self-contact";
    }

    /// Bits of [`Status::realtime_missing`](crate::Status::realtime_missing).
    realtime {
        /// The real-time threads do not have `SCHED_FIFO`.
        FIFO = 0: "SCHED_FIFO",
            concat!("grant rtprio ", rtprio!(), ", or realtime.cycle_priority if that is higher (LimitRTPRIO of a unit, limits.d, or --ulimit in a container)");
        /// The real-time threads are not pinned to their core.
        PINNED = 1: "core pinning", "choose a core that the process may use (realtime.core)";
        /// Memory is not locked.
        LOCKED = 2: "locked memory",
            "grant memlock unlimited (LimitMEMLOCK of a unit, limits.d, or --ulimit in a container)";
        /// Real time was switched off in the configuration.
        OFF = 3: "real time", "set realtime.mode to \"prefer\" or \"require\"";
    }
}
