use std::time::Duration;

use cdcr_client::{
    Connection, Driver, LinkError, ObstacleSender, ReferenceFeed, TelemetryStream, TipSensor,
};
use cdcr_shared_types::codes::{ChunkMode, EventKind, Interpolation, ObstacleAction, RequestKind};
use cdcr_shared_types::limits::CABLES_MAX;
use cdcr_shared_types::{
    Header, InputEvent, Obstacle, ReferencePoint, Response, Status, Telemetry,
};

use crate::failure::Failure;

/// Timeout for the release of the lease at the end of a session.
const RELEASE_TIMEOUT: Duration = Duration::from_millis(300);

/// A connection with its ports, each opened on first use.
#[derive(Debug)]
pub(crate) struct Session {
    connection: Connection,
    reference: Option<ReferenceFeed>,
    obstacles: Option<ObstacleSender>,
    tip: Option<TipSensor>,
    telemetry: Option<TelemetryStream>,
    holds_lease: bool,
}

impl Session {
    pub(crate) fn new(connection: Connection) -> Self {
        Self {
            connection,
            reference: None,
            obstacles: None,
            tip: None,
            telemetry: None,
            holds_lease: false,
        }
    }

    pub(crate) fn status(&self, timeout: Duration) -> Result<Status, Failure> {
        Ok(self.connection.status(timeout)?)
    }

    pub(crate) fn request(
        &mut self,
        kind: RequestKind,
        timeout: Duration,
    ) -> Result<Response, Failure> {
        if kind == RequestKind::Settings {
            return Err(Failure::argument(
                "this library changes no settings: use cdcrctl settings set",
            ));
        }
        let response = self.connection.request_within(kind, timeout)?;
        match kind {
            RequestKind::AcquireLease => self.holds_lease = true,
            RequestKind::ReleaseLease => self.holds_lease = false,
            _ => {}
        }
        Ok(response)
    }

    pub(crate) fn reset(
        &mut self,
        accept_pose: bool,
        timeout: Duration,
    ) -> Result<Response, Failure> {
        Ok(self.connection.reset_within(accept_pose, timeout)?)
    }

    pub(crate) fn feed(
        &mut self,
        mode: ChunkMode,
        interpolation: Interpolation,
        points: &[ReferencePoint],
    ) -> Result<Header, Failure> {
        let open = || self.connection.reference_feed();
        let port = opened(&mut self.reference, open)?;
        Ok(port.send(mode, interpolation, points)?)
    }

    pub(crate) fn send_obstacles(
        &mut self,
        action: ObstacleAction,
        obstacles: &[Obstacle],
    ) -> Result<Header, Failure> {
        let open = || self.connection.obstacle_sender();
        let port = opened(&mut self.obstacles, open)?;
        Ok(match action {
            ObstacleAction::Upsert => port.upsert(obstacles)?,
            ObstacleAction::Remove => {
                let ids: Vec<_> = obstacles.iter().map(|obstacle| obstacle.id).collect();
                port.remove(&ids)?
            }
            ObstacleAction::Clear => port.clear()?,
        })
    }

    pub(crate) fn send_tip(
        &mut self,
        measured_ns: u64,
        tip_position_m: [f64; 3],
    ) -> Result<Header, Failure> {
        let open = || self.connection.tip_sensor();
        let port = opened(&mut self.tip, open)?;
        Ok(port.send(measured_ns, tip_position_m)?)
    }

    pub(crate) fn open_telemetry(&mut self) -> Result<(), Failure> {
        let open = || self.connection.telemetry();
        opened(&mut self.telemetry, open)?;
        Ok(())
    }

    fn telemetry(&mut self) -> Result<&mut TelemetryStream, Failure> {
        let closed = || Failure::argument("no telemetry is open: call cdcr_telemetry_open first");
        self.telemetry.as_mut().ok_or_else(closed)
    }

    /// Waits for a record, then passes the queued records to `write`, at most `capacity`. Returns their
    /// number, and the number of lost records so far.
    pub(crate) fn read_telemetry(
        &mut self,
        capacity: usize,
        timeout: Duration,
        mut write: impl FnMut(usize, Telemetry),
    ) -> Result<(usize, u64), Failure> {
        if capacity == 0 {
            return Err(Failure::argument("capacity is 0: it must be at least 1"));
        }
        let telemetry = self.telemetry()?;
        let mut count = 0;
        let mut next = telemetry.next_within(timeout)?;
        while let Some(record) = next {
            write(count, record);
            count += 1;
            next = if count < capacity {
                telemetry.try_next()?
            } else {
                None
            };
        }
        Ok((count, telemetry.lost()))
    }

    pub(crate) fn event_on(
        &mut self,
        kind: EventKind,
        header: &Header,
        timeout: Duration,
    ) -> Result<InputEvent, Failure> {
        Ok(self.telemetry()?.event_on(kind, header, timeout)?)
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        if self.holds_lease {
            // When the daemon is down, its lease has ended with it.
            let release = RequestKind::ReleaseLease;
            let _ = self.connection.request_within(release, RELEASE_TIMEOUT);
        }
    }
}

/// The port, opened on first use.
fn opened<T>(
    port: &mut Option<T>,
    open: impl FnOnce() -> Result<T, LinkError>,
) -> Result<&mut T, LinkError> {
    let opened = match port.take() {
        Some(port) => port,
        None => open()?,
    };
    Ok(port.insert(opened))
}

/// Sends cable lengths; their number must be that of the robot's cables.
pub(crate) fn send_cable_lengths(
    driver: &Driver,
    measured_ns: u64,
    cable_length_m: &[f64],
) -> Result<(), Failure> {
    let cables = CABLES_MAX.min(3 * driver.robot().sections as usize);
    let given = cable_length_m.len();
    if given != cables {
        let text = format!("cable_length_m has {given} lengths, and the robot has {cables} cables");
        return Err(Failure::argument(text));
    }
    let mut lengths_m = [0.0; CABLES_MAX];
    lengths_m[..cables].copy_from_slice(cable_length_m);
    Ok(driver
        .send_cable_lengths(measured_ns, lengths_m)
        .map(drop)?)
}
