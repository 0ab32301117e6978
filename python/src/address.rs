use std::time::Duration;

use cdcr_client::{ConnectError, LinkError, Liveness};
use cdcr_shared_types::{Location, Service};

/// Location and robot of a daemon.
#[derive(Clone)]
pub(crate) struct Address {
    pub(crate) location: Location,
    pub(crate) robot: String,
    pub(crate) timeout: Duration,
}

impl Address {
    pub(crate) fn open(&self) -> Result<cdcr_client::Connection, ConnectError> {
        cdcr_client::Connection::open_within(&self.location, &self.robot, self.timeout)
    }

    /// Fails if the daemon has ended, which explains the silence on a service.
    pub(crate) fn check_runs(&self, service: Service, waited: Duration) -> Result<(), LinkError> {
        let error = self.silent(service, waited);
        match error {
            LinkError::Silent {
                liveness: Liveness::Ended,
                ..
            } => Err(error),
            _ => Ok(()),
        }
    }

    /// The error for silence on a service.
    pub(crate) fn silent(&self, service: Service, waited: Duration) -> LinkError {
        let presence = self.location.presence(&self.robot);
        LinkError::Silent {
            service: service.key(),
            waited,
            liveness: presence.map_or(Liveness::Ended, |presence| Liveness::Runs {
                process_id: presence.process_id,
            }),
        }
    }
}
