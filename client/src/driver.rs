use std::time::Duration;

use cdcr_shared_types::codes::Interface;
use cdcr_shared_types::{Command, Header, Measurement};

use crate::outlet::Outlet;
use crate::sender::Sender;
use crate::services::Services;
use crate::stream::Stream;
use crate::{CommandStream, LinkError};

/// The ports of a driver process: it sends what the robot measures and obeys what the daemon commands.
///
/// The daemon sends no command before it has a first measurement, because it does not know before how
/// the robot is bent: a driver that waits for a command before it measures waits for ever. A driver must
/// hold the robot still before the first command, and from the newest one's `valid_until_ns` on.
///
/// A driver goes on measuring while the daemon is away: the next one begins with its measurements, and its
/// commands arrive here.
#[derive(Debug)]
pub struct Driver {
    interface: Interface,
    measurements: Outlet<Measurement>,
    commands: CommandStream,
}

impl Driver {
    pub(crate) fn open(
        services: &Services,
        sender: Sender,
        interface: Interface,
    ) -> Result<Self, LinkError> {
        Ok(Self {
            interface,
            measurements: Outlet::open(&services.measurement, sender)?,
            commands: Stream::open_kept(&services.command)?,
        })
    }

    /// Sends what was measured, and by the way which interface this driver obeys.
    ///
    /// # Errors
    /// When iceoryx2 fails.
    pub fn send(&self, measurement: Measurement) -> Result<Header, LinkError> {
        self.measurements.send(Measurement {
            interface: self.interface.code(),
            ..measurement
        })
    }

    /// The newest command that waits, or `None`; older ones are out of date and thrown away.
    ///
    /// # Errors
    /// When iceoryx2 fails.
    pub fn newest_command(&mut self) -> Result<Option<Command>, LinkError> {
        self.commands.newest()
    }

    /// The next command, or `None` when none came within `timeout`.
    ///
    /// # Errors
    /// When iceoryx2 fails.
    pub fn next_command(&mut self, timeout: Duration) -> Result<Option<Command>, LinkError> {
        self.commands.next_within(timeout)
    }
}
