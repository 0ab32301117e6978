use std::time::Duration;

use cdcr_client::{Connection, LinkError, Liveness, obstacles};
use cdcr_shared_types::{Obstacle, Service};

/// The obstacles known to the next cycle.
pub(crate) fn known(
    connection: &Connection,
    timeout: Duration,
) -> Result<Vec<Obstacle>, LinkError> {
    let record = connection.telemetry()?.next_within(timeout)?;
    let record = record.ok_or(LinkError::Silent {
        service: Service::Telemetry.key(),
        waited: timeout,
        liveness: Liveness::Unknown,
    })?;
    Ok(obstacles(&record).to_vec())
}
