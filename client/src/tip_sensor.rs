use cdcr_shared_types::codes::MeasurementKind;
use cdcr_shared_types::{Header, Measurement, Status};

use crate::LinkError;
use crate::outlet::Outlet;
use crate::sender::Sender;
use crate::services::Channel;

/// The port of a process that measures the tip and nothing else, a camera for example, beside the driver of the robot.
///
/// The daemon takes its measurements with `link.tip_sensor = "separate"`. One tip sensor has the robot: the first whose
/// measurement was accepted, until none was for a second. It may pause or end; the robot goes on by its
/// driver's bends or cables.
#[derive(Debug)]
pub struct TipSensor {
    outlet: Outlet<Measurement>,
    sections: u32,
    interface: u32,
}

impl TipSensor {
    pub(crate) fn open(
        channel: &Channel<Measurement>,
        sender: Sender,
        status: &Status,
    ) -> Result<Self, LinkError> {
        Ok(Self {
            outlet: Outlet::open(channel, sender)?,
            sections: status.robot.sections,
            interface: status.interface,
        })
    }

    /// Sends the position of the tip in the base frame \[m\], and when it was there \[ns, `CLOCK_MONOTONIC`\]: when the picture
    /// was exposed, not when it was evaluated.
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
