use std::thread;
use std::time::{Duration, Instant};

use cdcr_shared_types::Status;

use crate::{LinkError, Stream, monotonic_ns};

/// Maximum age of a status, and time to wait for one. A daemon publishes ten per second: one that is silent for
/// this long counts as dead.
pub const STATUS_TIMEOUT: Duration = Duration::from_secs(1);

/// Keeps the newest status, so that frequent reads do not wait each time.
#[derive(Debug)]
pub(crate) struct StatusReader {
    stream: Stream<Status>,
    newest: Option<Status>,
}

impl StatusReader {
    pub(crate) fn new(stream: Stream<Status>) -> Self {
        Self {
            stream,
            newest: None,
        }
    }

    /// The newest status if it is fresh; `None` when none arrives within `timeout`.
    pub(crate) fn fresh_within(&mut self, timeout: Duration) -> Result<Option<Status>, LinkError> {
        let deadline = Instant::now() + timeout;
        loop {
            if let Some(status) = self.stream.newest()? {
                self.newest = Some(status);
            }
            let now_ns = monotonic_ns();
            match &self.newest {
                Some(status) if is_fresh(status, now_ns) => return Ok(Some(*status)),
                _ if Instant::now() >= deadline => return Ok(None),
                _ => thread::sleep(Duration::from_millis(2)),
            }
        }
    }
}

fn is_fresh(status: &Status, now_ns: u64) -> bool {
    now_ns.saturating_sub(status.header.sent_ns) < STATUS_TIMEOUT.as_nanos() as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_status_older_than_a_second_is_of_a_dead_daemon() {
        let mut status = Status::default();
        status.header.sent_ns = 5_000_000_000;
        assert!(is_fresh(&status, 5_900_000_000));
        assert!(!is_fresh(&status, 6_000_000_000));
    }
}
