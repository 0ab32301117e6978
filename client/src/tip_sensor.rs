use cdcr_shared_types::codes::MeasurementKind;
use cdcr_shared_types::{Header, Measurement, Status};

use crate::LinkError;
use crate::outlet::Outlet;
use crate::sender::MessageSender;
use crate::services::Channel;

/// The port of a process beside the driver that measures the tip only, for example a camera.
///
/// The daemon uses its measurements with `link.tip_sensor = "separate"`. A robot has one tip sensor at a
/// time: the first whose measurement was accepted, until none has been accepted for a second. The tip sensor
/// may pause or end; the robot then continues with the driver's measurements of bends or cables.
#[derive(Debug)]
pub struct TipSensor {
    outlet: Outlet<Measurement>,
    sections: u32,
    interface: u32,
}

impl TipSensor {
    pub(crate) fn open(
        channel: &Channel<Measurement>,
        sender: MessageSender,
        status: &Status,
    ) -> Result<Self, LinkError> {
        Ok(Self {
            outlet: Outlet::open(channel, sender)?,
            sections: status.robot.sections,
            interface: status.interface,
        })
    }

    /// Sends the tip position in the base frame \[m\] and its time \[ns, `CLOCK_MONOTONIC`\]: that of the
    /// camera exposure, not of the image evaluation.
    ///
    /// # Errors
    /// When iceoryx2 fails.
    pub fn send(&self, measured_ns: u64, tip_position_m: [f64; 3]) -> Result<Header, LinkError> {
        self.outlet.send(Measurement {
            measured_ns,
            kind: MeasurementKind::TipPose.code(),
            sections: self.sections,
            interface: self.interface,
            tip_position_m,
            ..Measurement::default()
        })
    }
}
