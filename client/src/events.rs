use std::time::{Duration, Instant};

use cdcr_shared_types::codes::{EventKind, Outcome};
use cdcr_shared_types::limits::{EVENTS_MAX, OBSTACLES_MAX};
use cdcr_shared_types::{Header, InputEvent, Obstacle, Service, Telemetry};

use crate::{LinkError, Liveness, TelemetryStream};

/// The obstacles of a record, where they are at its release.
pub fn obstacles(record: &Telemetry) -> &[Obstacle] {
    let count = (record.obstacle_count as usize).min(OBSTACLES_MAX);
    &record.obstacles[..count]
}

/// The events of a record: what took effect with it, or was refused.
pub fn events(record: &Telemetry) -> &[InputEvent] {
    let count = (record.event_count as usize).min(EVENTS_MAX);
    &record.events[..count]
}

/// What a record tells of the message with this header, if it does.
pub fn event_about(record: &Telemetry, kind: EventKind, header: &Header) -> Option<InputEvent> {
    let is_about = |event: &&InputEvent| {
        event.kind == kind.code()
            && event.sender_id == header.sender_id
            && event.sequence == header.sequence
    };
    events(record).iter().find(is_about).copied()
}

impl TelemetryStream {
    /// Waits until the daemon has decided on the message with this header, at most `timeout`. The stream
    /// must have been opened before the message was sent.
    ///
    /// # Errors
    /// [`LinkError::Silent`] when no outcome came.
    pub fn outcome_on(
        &mut self,
        kind: EventKind,
        header: &Header,
        timeout: Duration,
    ) -> Result<Outcome, LinkError> {
        let event = self.event_on(kind, header, timeout)?;
        Ok(Outcome::try_from(event.outcome).unwrap_or(Outcome::UnknownCode))
    }

    /// As [`outcome_on`](Self::outcome_on), with all that the daemon says of the message: at which of its
    /// points or obstacles it was refused, or how many obstacles are known since.
    ///
    /// # Errors
    /// As [`outcome_on`](Self::outcome_on).
    pub fn event_on(
        &mut self,
        kind: EventKind,
        header: &Header,
        timeout: Duration,
    ) -> Result<InputEvent, LinkError> {
        let deadline = Instant::now() + timeout;
        let left = || deadline.saturating_duration_since(Instant::now());
        while let Some(record) = self.next_within(left())? {
            if let Some(event) = event_about(&record, kind, header) {
                return Ok(event);
            }
            if left().is_zero() {
                break;
            }
        }
        let service = Service::Telemetry;
        Err(LinkError::silent(service, timeout, Liveness::Unknown))
    }
}
