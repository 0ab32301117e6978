use std::cell::Cell;
use std::time::Duration;

use cdcr_shared_types::codes::RequestKind;
use cdcr_shared_types::{Header, Response};

use crate::connection::REQUEST_TIMEOUT;
use crate::{Connection, RequestError, monotonic_ns};

/// Timeout of the request that ends a lease: enough for many cycles, short for a person.
const RELEASE_TIMEOUT: Duration = Duration::from_millis(300);

/// The right to send references, held until it is released or dropped.
///
/// The daemon withdraws the lease a certain time after the last renewal or accepted chunk; a tracking robot
/// then holds. That time is configured in the daemon, 20 ms to one minute; see [`left`](Self::left). One
/// client holds the lease at a time. The lease ends with the daemon that granted it: the next
/// [`renew`](Self::renew) reports this.
#[derive(Debug)]
pub struct Lease<'c> {
    connection: &'c Connection,
    /// Number of this lease among those of the connection.
    number: u64,
    grant: Grant,
    /// Time of the last renewal request, and the lease time that the daemon returned.
    renewed_ns: Cell<u64>,
    left: Cell<Duration>,
}

/// The daemon that granted a lease, and the time of the request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Grant {
    pub(crate) daemon_id: u64,
    /// Time of the request \[ns, `CLOCK_MONOTONIC`\].
    pub(crate) asked_ns: u64,
}

impl Grant {
    /// Whether the daemon that granted the lease sent a message with this header.
    pub(crate) fn is_from(&self, header: &Header) -> bool {
        header.sender_id == self.daemon_id
    }
}

impl Connection {
    /// Acquires the lease: the right to send references until it is dropped.
    ///
    /// # Errors
    /// When another client holds it.
    pub fn acquire_lease(&self) -> Result<Lease<'_>, RequestError> {
        self.acquire_lease_within(REQUEST_TIMEOUT)
    }

    /// Like [`acquire_lease`](Self::acquire_lease), waiting at most `timeout` for the daemon's answer.
    ///
    /// # Errors
    /// As [`acquire_lease`](Self::acquire_lease).
    pub fn acquire_lease_within(&self, timeout: Duration) -> Result<Lease<'_>, RequestError> {
        Lease::acquire(self, timeout)
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

    /// Lease time at the last renewal, as reported by the daemon. With renewals at a fifth of it, four
    /// renewals may be lost.
    pub fn left(&self) -> Duration {
        self.left.get()
    }

    pub(crate) fn grant(&self) -> Grant {
        self.grant
    }

    /// Whether it expires before `now_ns` without a further renewal.
    pub(crate) fn is_expired(&self, now_ns: u64) -> bool {
        now_ns > self.renewed_ns.get() + self.left().as_nanos() as u64
    }

    /// Time of the next renewal \[ns, `CLOCK_MONOTONIC`\].
    pub(crate) fn renewal_due_ns(&self) -> u64 {
        renewal_due_ns(self.renewed_ns.get(), self.left())
    }

    /// Renews the lease for its full time.
    ///
    /// # Errors
    /// When another client has the lease, the daemon does not answer, or the daemon was restarted
    /// ([`RequestError::Restarted`]): the reference fed so far is lost then.
    pub fn renew(&self) -> Result<Response, RequestError> {
        let asked_ns = monotonic_ns();
        let answer = self.connection.request(RequestKind::AcquireLease);
        let response = answer.map_err(RequestError::of_renewal)?;
        if !self.grant.is_from(&response.header) {
            self.give_back();
            return Err(RequestError::Restarted);
        }
        self.renewed_ns.set(asked_ns);
        self.left.set(Duration::from_nanos(response.lease_left_ns));
        Ok(response)
    }

    /// Gives the lease back; a tracking robot then holds. Dropping the lease does the same and ignores
    /// errors.
    ///
    /// # Errors
    /// When the daemon refuses or does not answer.
    pub fn release(self) -> Result<Response, RequestError> {
        // This makes the following drop find a newer lease, so it sends nothing.
        self.connection.number_lease();
        self.connection.request(RequestKind::ReleaseLease)
    }

    /// The lease belongs to the connection: the end of this lease must not release a newer one.
    fn give_back(&self) {
        if self.connection.newest_lease() == self.number {
            self.connection.number_lease();
            // When the daemon is down, its lease has ended with it.
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

/// Renewal at a fifth of the lease time tolerates four late or lost renewals.
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
