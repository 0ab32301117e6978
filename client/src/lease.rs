use std::cell::Cell;
use std::time::Duration;

use cdcr_shared_types::codes::RequestKind;
use cdcr_shared_types::{Header, Response};

use crate::{Connection, RequestError, monotonic_ns};

/// How long the end of a lease waits for the daemon: enough for many cycles, short for a person.
const RELEASE_TIMEOUT: Duration = Duration::from_millis(300);

/// The right to send references, held until it is released or dropped.
///
/// The daemon takes it back some time after the last renewal or accepted chunk; a robot that tracks then
/// holds. The daemon's configuration says how long that is, 20 ms to a minute; [`left`](Self::left) is
/// what it told. One client at a time has it. It ends with the daemon that gave it: the next
/// [`renew`](Self::renew) says so.
#[derive(Debug)]
pub struct Lease<'c> {
    connection: &'c Connection,
    /// Number of this lease among those of the connection.
    number: u64,
    grant: Grant,
    /// When the last renewal was asked for, and how long the daemon said that it runs.
    renewed_ns: Cell<u64>,
    left: Cell<Duration>,
}

/// Which daemon gave a lease, and when it was asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Grant {
    pub(crate) daemon_id: u64,
    /// \[ns, `CLOCK_MONOTONIC`\].
    pub(crate) asked_ns: u64,
}

impl Grant {
    /// Whether a message with this header comes from that daemon.
    pub(crate) fn is_from(&self, header: &Header) -> bool {
        header.sender_id == self.daemon_id
    }
}

impl<'c> Lease<'c> {
    pub(crate) fn acquire(
        connection: &'c Connection,
        timeout: Duration,
    ) -> Result<Self, RequestError> {
        let asked_ns = monotonic_ns();
        let response = connection.request_within(RequestKind::AcquireLease, timeout)?;
        Ok(Self {
            connection,
            number: connection.number_lease(),
            grant: Grant {
                daemon_id: response.header.sender_id,
                asked_ns,
            },
            renewed_ns: Cell::new(asked_ns),
            left: Cell::new(Duration::from_nanos(response.lease_left_ns)),
        })
    }

    /// How long it ran from its last renewal, as the daemon told then. Who renews it at a fifth of this
    /// can lose four renewals.
    pub fn left(&self) -> Duration {
        self.left.get()
    }

    pub(crate) fn grant(&self) -> Grant {
        self.grant
    }

    /// When it should be renewed \[ns, `CLOCK_MONOTONIC`\].
    pub(crate) fn renewal_due_ns(&self) -> u64 {
        renewal_due_ns(self.renewed_ns.get(), self.left())
    }

    /// Makes it run for its full time again.
    ///
    /// # Errors
    /// When it was lost to another client, or the daemon does not answer, or another daemon took its place
    /// ([`RequestError::Restarted`]): what was fed to the one before is lost.
    pub fn renew(&self) -> Result<Response, RequestError> {
        let asked_ns = monotonic_ns();
        let kind = RequestKind::AcquireLease;
        let response = self.connection.request(kind)?;
        if !self.grant.is_from(&response.header) {
            self.give_back();
            return Err(RequestError::Restarted { kind });
        }
        self.renewed_ns.set(asked_ns);
        self.left.set(Duration::from_nanos(response.lease_left_ns));
        Ok(response)
    }

    /// Gives it back; a robot that tracks then holds. Dropping does the same, silently.
    ///
    /// # Errors
    /// When the daemon refuses or does not answer.
    pub fn release(self) -> Result<Response, RequestError> {
        // The drop that follows finds that another lease is the newest.
        self.connection.number_lease();
        self.connection.request(RequestKind::ReleaseLease)
    }

    /// The lease is the connection's: a newer one on it must not go with this one.
    fn give_back(&self) {
        if self.connection.newest_lease() == self.number {
            self.connection.number_lease();
            // A daemon that is gone takes the lease back by itself.
            let _ = self
                .connection
                .request_within(RequestKind::ReleaseLease, RELEASE_TIMEOUT);
        }
    }
}

impl Drop for Lease<'_> {
    fn drop(&mut self) {
        self.give_back();
    }
}

/// Renewing at a fifth survives four renewals that came too late or not at all.
fn renewal_due_ns(renewed_ns: u64, left: Duration) -> u64 {
    renewed_ns + left.as_nanos() as u64 / 5
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_short_lease_is_renewed_often_and_a_long_one_seldom() {
        assert_eq!(renewal_due_ns(7, Duration::from_millis(20)), 4_000_007);
        assert_eq!(renewal_due_ns(7, Duration::from_millis(500)), 100_000_007);
    }
}
