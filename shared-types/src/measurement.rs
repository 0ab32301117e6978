use crate::Header;
use crate::limits::{CABLES_MAX, COORDINATES_MAX};
use crate::message::message;

message! {
    /// A measurement by a driver or tip sensor: one of configuration, tip pose or cable lengths.
    ///
    /// A driver that measures the tip beside bends or cables sends each in separate messages, as often as it can. The
    /// bends then determine the configuration and must continue; the tip corrects the error of the model at the tip. If
    /// a driver sends only tips, they determine the configuration.
    ///
    /// With `link.tip_sensor = "separate"`, tips come from one process and bends or cables from another, the driver.
    /// The tip alone then never determines the configuration.
    ///
    /// One driver has the robot: the first whose measurement was accepted, by its `header.sender_id`, until it is lost.
    /// Measurements of another driver are rejected (likewise of another tip sensor), and so are those older than
    /// `link.measurement_timeout_ms` on arrival, for a tip beside bends or cables `link.tip_age_max_ms`.
    pub struct Measurement "cdcr.Measurement.v3" {
        /// Sender, sequence, time of sending.
        header: Header,
        /// When it was measured \[ns, `CLOCK_MONOTONIC`\].
        measured_ns: u64,
        /// [`codes::MeasurementKind`](crate::codes::MeasurementKind): which of the fields below is meant.
        kind: u32 [code MeasurementKind],
        /// Sections of the robot it belongs to; must be the daemon's.
        sections: u32,
        /// [`codes::Interface`](crate::codes::Interface) that the driver of the robot obeys; must be the daemon's `link.interface`.
        interface: u32 [code Interface],
        /// Zero.
        reserved: u32 [reserved],
        /// Begin of the newest time in which velocity-controlled motors rested because their command had run out \[ns, `CLOCK_MONOTONIC`\], along the
        /// commands: where the driver took the last one 2 ms after its release, 2 ms before the time of its clock. The daemon compares it with the
        /// measured bends.
        rested_from_ns: u64,
        /// End of that time, or when this is sent if the motors still rest, likewise. 0: the driver does not state it, or the motors have
        /// not rested since the first command. Ignored where the driver obeys positions, whose motors make up for a rest.
        rested_until_ns: u64,
        /// Bend vector (u₁, v₁, u₂, v₂, …) \[rad\].
        bend_rad: [f64; COORDINATES_MAX] [when kind = MeasurementKind::Configuration] [used 2 sections],
        /// Tip position in the base frame \[m\].
        tip_position_m: [f64; 3] [when kind = MeasurementKind::TipPose],
        /// Tip orientation, quaternion (x, y, z, w) base → tip: finite. For recordings and calibration: the daemon controls by the position alone.
        tip_orientation: [f64; 4] [when kind = MeasurementKind::TipPose],
        /// Cable lengths, section by section, three each \[m\].
        cable_length_m: [f64; CABLES_MAX] [when kind = MeasurementKind::CableLengths] [used 3 sections],
    }
}
