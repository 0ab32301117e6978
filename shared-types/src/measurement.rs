use iceoryx2::prelude::ZeroCopySend;

use crate::Header;
use crate::limits::{CABLES_MAX, COORDINATES_MAX};

/// What a driver knows of the robot: one of configuration, tip pose or cable lengths.
///
/// One driver has the robot: the first whose measurement was accepted, by its `header.sender_id`, until it is lost. Those
/// of another one are refused, and so are those that are older than `link.measurement_timeout_ms` when they arrive.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, ZeroCopySend)]
#[type_name("cdcr.Measurement.v2")]
pub struct Measurement {
    /// Sender, sequence, time of sending.
    pub header: Header,
    /// When it was measured \[ns, `CLOCK_MONOTONIC`\].
    pub measured_ns: u64,
    /// [`codes::MeasurementKind`](crate::codes::MeasurementKind): which of the fields below is meant.
    pub kind: u32,
    /// Sections of the robot it belongs to; must be the daemon's.
    pub sections: u32,
    /// [`codes::Interface`](crate::codes::Interface) that the driver obeys; must be the daemon's `link.interface`.
    pub interface: u32,
    /// Zero.
    pub reserved: u32,
    /// Bend vector (u₁, v₁, u₂, v₂, …) \[rad\].
    pub bend_rad: [f64; COORDINATES_MAX],
    /// Tip position in the base frame \[m\].
    pub tip_position_m: [f64; 3],
    /// Tip orientation, unit quaternion (x, y, z, w) base → tip.
    pub tip_orientation: [f64; 4],
    /// Cable lengths, section by section, three each \[m\].
    pub cable_length_m: [f64; CABLES_MAX],
}

impl Default for Measurement {
    fn default() -> Self {
        Self {
            header: Header::default(),
            measured_ns: 0,
            kind: 0,
            sections: 0,
            interface: 0,
            reserved: 0,
            bend_rad: [0.0; COORDINATES_MAX],
            tip_position_m: [0.0; 3],
            tip_orientation: [0.0; 4],
            cable_length_m: [0.0; CABLES_MAX],
        }
    }
}
