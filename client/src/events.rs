use std::time::{Duration, Instant};

use cdcr_shared_types::codes::{EventKind, Outcome};
use cdcr_shared_types::limits::{EVENTS_MAX, OBSTACLES_MAX};
use cdcr_shared_types::{Header, InputEvent, Obstacle, Service, Telemetry};

use crate::{LinkError, Liveness, TelemetryStream};

/// The obstacles of a record, at their positions at its release.
pub fn obstacles(record: &Telemetry) -> &[Obstacle] {
    let count = (record.obstacle_count as usize).min(OBSTACLES_MAX);
    &record.obstacles[..count]
}

/// The events of a record: messages that took effect with it or were refused.
pub fn events(record: &Telemetry) -> &[InputEvent] {
    let count = (record.event_count as usize).min(EVENTS_MAX);
    &record.events[..count]
}

/// The event of a record about the message with this header, if any.
pub fn event_about(record: &Telemetry, kind: EventKind, header: &Header) -> Option<InputEvent> {
    let is_about = |event: &&InputEvent| {
        event.kind == kind.code()
            && event.sender_id == header.sender_id
            && event.sequence == header.sequence
    };
    events(record).iter().find(is_about).copied()
}

impl TelemetryStream {
    /// Waits for the daemon's decision on the message with this header, at most `timeout`. Open the stream
    /// before the message is sent.
    ///
    /// # Errors
    /// [`LinkError::Silent`] when no outcome arrived.
    pub fn outcome_on(
        &mut self,
        kind: EventKind,
        header: &Header,
        timeout: Duration,
    ) -> Result<Outcome, LinkError> {
        let event = self.event_on(kind, header, timeout)?;
        Ok(Outcome::try_from(event.outcome).unwrap_or(Outcome::UnknownCode))
    }

    /// Like [`outcome_on`](Self::outcome_on), with the whole event: the point or obstacle that was refused,
    /// or the number of known obstacles.
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
        // What is queued is read after the deadline, too: this program may have stood still.
        while let Some(record) = self.next_within(left())? {
            if let Some(event) = event_about(&record, kind, header) {
                return Ok(event);
            }
        }
        let service = Service::Telemetry;
        Err(LinkError::silent(service, timeout, Liveness::Unknown))
    }
}
