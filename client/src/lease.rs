use std::time::Duration;

use cdcr_shared_types::Response;
use cdcr_shared_types::codes::RequestKind;

use crate::{Connection, RequestError};

/// How long the end of a lease waits for the daemon: enough for many cycles, short for a person.
const RELEASE_TIMEOUT: Duration = Duration::from_millis(300);

/// The right to send references, held until it is released or dropped.
///
/// The daemon takes it back 500 ms after the last renewal or accepted chunk; a robot that tracks then
/// holds. One client at a time has it.
#[derive(Debug)]
pub struct Lease<'c> {
    connection: &'c Connection,
    held: bool,
}

impl<'c> Lease<'c> {
    pub(crate) fn acquire(connection: &'c Connection) -> Result<Self, RequestError> {
        connection.request(RequestKind::AcquireLease)?;
        Ok(Self {
            connection,
            held: true,
        })
    }

    /// Makes it run for its full time again.
    ///
    /// # Errors
    /// When it was lost to another client, or the daemon does not answer.
    pub fn renew(&self) -> Result<Response, RequestError> {
        self.connection.request(RequestKind::AcquireLease)
    }

    /// Gives it back; a robot that tracks then holds. Dropping does the same, silently.
    ///
    /// # Errors
    /// When the daemon refuses or does not answer.
    pub fn release(mut self) -> Result<Response, RequestError> {
        self.held = false;
        self.connection.request(RequestKind::ReleaseLease)
    }
}

impl Drop for Lease<'_> {
    fn drop(&mut self) {
        if self.held {
            // A daemon that is gone takes the lease back by itself.
            let _ = self
                .connection
                .request_within(RequestKind::ReleaseLease, RELEASE_TIMEOUT);
        }
    }
}
