//! What a measurement is, and how it was used.

use super::{Codes, UnknownCode};

wire_enum! {
    /// Quantity of a measurement.
    MeasurementKind {
        None = 0: "none",
        /// The bend vector of every section.
        Configuration = 1: "configuration",
        /// Position and orientation of the tip.
        TipPose = 2: "tip pose",
        /// The length of every cable.
        CableLengths = 3: "cable lengths",
    }
}

wire_enum! {
    ($ measurement_states)
    /// Use of the measurement in a cycle.
    MeasurementState {
        /// No measurement yet.
        None = 0: "none",
        /// A new one corrected the estimate.
        Used = 1: "used",
        /// None since the previous cycle: the estimate was predicted.
        Repeated = 2: "repeated",
        /// A new one was rejected, because no robot can follow it.
        Implausible = 3: "implausible",
    }
}

wire_enum! {
    /// Why tips measured beside bends or cables are not used. One with the bits of the one before changes nothing: a sensor of
    /// coarse resolution repeats them at rest.
    TipCause {
        /// They are used, or were not measured.
        None = 0: "none",
        /// More than a ninth of the robot's length, or 0.1 m.
        Far = 1: "it is too far from where the bends place it",
        /// Three times in a row; it is used again after some time within the limit.
        WasFar = 2: "it was too far from where the bends place it, a short time ago",
        Jumps = 3: "it moved faster than the robot can",
        /// It is used again after a stop and reset, or from a sensor that is started again.
        Jumped = 4: "it moved faster than the robot can many times in a row",
        /// It is used again after a stop and reset, or from a sensor that is started again.
        Frozen = 5: "it had the same bits while the robot moved",
    }
}
