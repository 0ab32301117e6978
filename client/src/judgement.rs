use std::time::{Duration, Instant};

use cdcr_shared_types::codes::{EventKind, Outcome};
use cdcr_shared_types::limits::EVENTS_MAX;
use cdcr_shared_types::{Header, InputEvent, Service, Telemetry};

use crate::{LinkError, TelemetryStream};

/// The events of a record: what took effect with it, or was refused.
pub fn events(record: &Telemetry) -> &[InputEvent] {
    let count = (record.event_count as usize).min(EVENTS_MAX);
    &record.events[..count]
}

impl TelemetryStream {
    /// Waits until the daemon has judged the message with this header, at most `timeout`. The stream
    /// must have been opened before the message was sent.
    ///
    /// # Errors
    /// [`LinkError::Silent`] when no verdict came.
    pub fn verdict_on(
        &mut self,
        kind: EventKind,
        header: &Header,
        timeout: Duration,
    ) -> Result<Outcome, LinkError> {
        let deadline = Instant::now() + timeout;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            let Some(record) = self.next_within(left)? else {
                return Err(LinkError::silent(Service::Telemetry, timeout));
            };
            if let Some(event) = events(&record)
                .iter()
                .find(|event| is_about(event, kind, header))
            {
                return Ok(Outcome::try_from(event.outcome).unwrap_or(Outcome::UnknownCode));
            }
            if Instant::now() >= deadline {
                return Err(LinkError::silent(Service::Telemetry, timeout));
            }
        }
    }
}

fn is_about(event: &InputEvent, kind: EventKind, header: &Header) -> bool {
    event.kind == kind.code()
        && event.sender_id == header.sender_id
        && event.sequence == header.sequence
}
