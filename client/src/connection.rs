use std::cell::{Cell, RefCell};
use std::thread;
use std::time::{Duration, Instant};

use cdcr_shared_types::codes::{Interface, RequestKind};
use cdcr_shared_types::limits::REQUEST_AGE_MS_MAX;
use cdcr_shared_types::{
    Incident, Location, Measurement, ObstacleUpdate, ReferenceChunk, Request, Response, Service,
    SolverSettings, Status,
};

use crate::connect_error::{Place, no_status, retry};
use crate::outlet::Outlet;
use crate::request::Control;
use crate::sender::MessageSender;
use crate::services::{Services, check_clock, check_owner};
use crate::status_reader::{STATUS_TIMEOUT, StatusReader};
use crate::{
    CommandStream, ConnectError, Driver, LinkError, ObstacleSender, ReferenceFeed, RequestError,
    Stream, TelemetryStream, TipSensor, monotonic_ns,
};

/// Timeout for a free connection, and for the answer to a request: a daemon answers within a few cycles of 5 ms.
pub(crate) const REQUEST_TIMEOUT: Duration = Duration::from_millis(REQUEST_AGE_MS_MAX as u64);

/// An open connection to one daemon.
///
/// A connection opens the services of the daemon and creates none. Ports made from it (streams, feeds) stay
/// usable without it. It stays on the thread that opened it; a second thread opens a second connection.
///
/// Monitoring (status, telemetry, incidents) is kept apart from the daemon's control loop. The port for
/// requests is created by the first request or by [`prepare_requests`](Self::prepare_requests).
///
/// A connection outlives its daemon, however the daemon ended. When another daemon starts at the same place,
/// streams, requests, [`Driver`] and [`ObstacleSender`] continue with it. State that the old daemon kept for
/// its clients is lost: the obstacles, the reference and the lease. The lease holder gets
/// [`RequestError::Restarted`] or [`FeedError::Restarted`](crate::FeedError::Restarted) and may acquire or feed
/// again. `header.sender_id` identifies a daemon.
///
/// It does not outlive the root folder: once that was emptied or replaced, it reaches no daemon. Silence is then
/// [`Liveness::Replaced`](crate::Liveness::Replaced), and a port that sends fails with [`LinkError::Replaced`]:
/// after 14 seconds, or with its second message where the messages are farther apart. Open a new connection.
#[derive(Debug)]
pub struct Connection {
    place: Place,
    services: Services,
    sender: MessageSender,
    control: Control,
    status: RefCell<StatusReader>,
    /// Number of the newest lease; incremented when a lease begins or is given back.
    leases: Cell<u64>,
}

impl Connection {
    /// Connects to the daemon that controls `robot` at `location`.
    ///
    /// # Errors
    /// [`ConnectError::DaemonNotRunning`] when there is no daemon, or when one was killed and left its
    /// services behind. [`ConnectError::Silent`] when one runs but sends no status. The other variants name
    /// other obstacles.
    pub fn open(location: &Location, robot: &str) -> Result<Self, ConnectError> {
        let place = Place::new(location, robot);
        Service::Control.name(robot)?;
        check_owner(location, &place)?;
        check_clock(location, &place)?;
        let services = Services::open(location, &place)?;
        let memory = |cause: String| ConnectError::Memory {
            place: place.clone(),
            cause,
        };
        let sender = MessageSender::new();
        let control = Control::new(services.control.clone(), sender.clone(), place.clone());
        let stream = Stream::open(&services.status).map_err(|cause| memory(cause.to_string()))?;
        let connection = Self {
            status: RefCell::new(StatusReader::new(stream)),
            place,
            services,
            sender,
            control,
            leases: Cell::new(0),
        };
        match connection.status(STATUS_TIMEOUT) {
            Ok(_) => Ok(connection),
            Err(_) => Err(no_status(location, &connection.place)),
        }
    }

    /// Connects to a daemon that may still be starting: retries until `timeout`.
    ///
    /// # Errors
    /// As [`open`](Self::open), with the error of the last attempt.
    pub fn open_within(
        location: &Location,
        robot: &str,
        timeout: Duration,
    ) -> Result<Self, ConnectError> {
        retry(timeout, ConnectError::may_pass, || {
            Self::open(location, robot)
        })
    }

    /// Place of the daemon.
    pub fn place(&self) -> &Place {
        &self.place
    }

    /// Identity of this connection in the headers of its messages, never 0.
    pub fn sender_id(&self) -> u64 {
        self.sender.id()
    }

    /// The newest status of the daemon; waits at most `timeout` for a fresh one.
    ///
    /// # Errors
    /// [`LinkError::Silent`] when no fresh status arrived.
    pub fn status(&self, timeout: Duration) -> Result<Status, LinkError> {
        let status = self.status.borrow_mut().fresh_within(timeout)?;
        status.ok_or_else(|| self.silent(Service::Status, timeout))
    }

    /// Whether the daemon no longer waits for the silent source of obstacles `source_id` (`silent_obstacle_source` of its status), at most
    /// `timeout` from now. A removal of the newest obstacle that it sent ends the wait, also of one that has expired. The daemon may then
    /// wait for another source.
    ///
    /// # Errors
    /// [`LinkError::Silent`] when the daemon sends no status.
    pub fn ends_wait_for(&self, source_id: u64, timeout: Duration) -> Result<bool, LinkError> {
        let until = Instant::now() + timeout;
        while Instant::now() < until {
            if self.status(timeout)?.silent_obstacle_source != source_id {
                return Ok(true);
            }
            thread::sleep(Duration::from_millis(10));
        }
        Ok(false)
    }

    /// The error for a daemon that has sent nothing on `service` for so long, with the cause as far as it is found.
    pub fn silent(&self, service: Service, waited: Duration) -> LinkError {
        LinkError::silent(service, waited, self.control.liveness())
    }

    /// The solver settings used by the first cycle that starts after this call; waits for it, at most 1 s.
    ///
    /// # Errors
    /// [`LinkError::Silent`] when no cycle ran, [`LinkError::Port`] when the telemetry has as many readers as
    /// it allows.
    pub fn settings(&self) -> Result<SolverSettings, LinkError> {
        let begun_ns = monotonic_ns();
        let deadline = Instant::now() + REQUEST_TIMEOUT;
        let mut telemetry = self.telemetry()?;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            match telemetry.next_within(left)? {
                // Records of earlier cycles may still be queued, with settings that have changed since.
                Some(record) if record.start_ns < begun_ns => {}
                Some(record) => return Ok(record.settings),
                None => return Err(self.silent(Service::Telemetry, REQUEST_TIMEOUT)),
            }
        }
    }

    /// Creates the port for requests. The first request does the same but takes a little longer: call this
    /// beforehand where a stop may be urgent.
    ///
    /// # Errors
    /// [`LinkError::Askers`] when the daemon has as many requesting clients as it allows,
    /// [`LinkError::Memory`] when shared memory is full.
    pub fn prepare_requests(&self) -> Result<(), LinkError> {
        self.control.port().map(|_| ())
    }

    /// Sends a request to the daemon and waits for the answer, at most 1 s.
    ///
    /// If the daemon ends without an answer, this call sends the request to the next daemon at the same
    /// place. It repeats the request while that daemon has not measured its robot yet. So the next daemon may
    /// execute a `home` or a `track` a second time, but only while this call waits: after an error, no later
    /// daemon executes it. To avoid this, wait for a shorter time ([`request_within`](Self::request_within)),
    /// or compare `header.sender_id` of the answer with that of an earlier status.
    ///
    /// # Errors
    /// A refusal, with its reason and a remedy, or a timeout.
    pub fn request(&self, kind: RequestKind) -> Result<Response, RequestError> {
        self.request_within(kind, REQUEST_TIMEOUT)
    }

    /// Like [`request`](Self::request), waiting at most `timeout`.
    ///
    /// # Errors
    /// As [`request`](Self::request).
    pub fn request_within(
        &self,
        kind: RequestKind,
        timeout: Duration,
    ) -> Result<Response, RequestError> {
        self.control.request(kind, Request::default(), timeout)
    }

    /// Leaves the modes stopped and faulted. The daemon refuses a reset where the robot is measured far from where
    /// its last command left it ([`Outcome::PoseDiffers`](cdcr_shared_types::codes::Outcome::PoseDiffers)):
    /// encoders may have lost their zero. `accept_pose`: the measured pose is right, for example after a motion by
    /// hand, and control begins there. Without it this is [`request`](Self::request) of a reset.
    ///
    /// # Errors
    /// As [`request`](Self::request).
    pub fn reset(&self, accept_pose: bool) -> Result<Response, RequestError> {
        self.reset_within(accept_pose, REQUEST_TIMEOUT)
    }

    /// Like [`reset`](Self::reset), waiting at most `timeout`.
    ///
    /// # Errors
    /// As [`request`](Self::request).
    pub fn reset_within(
        &self,
        accept_pose: bool,
        timeout: Duration,
    ) -> Result<Response, RequestError> {
        self.control.reset(accept_pose, timeout)
    }

    /// Resets the statistics of the status, for all clients.
    ///
    /// # Errors
    /// As [`request`](Self::request).
    pub fn reset_statistics(&self) -> Result<Response, RequestError> {
        self.request(RequestKind::ResetStatistics)
    }

    /// Changes the solver settings. Start from those of [`settings`](Self::settings).
    ///
    /// # Errors
    /// As [`request`](Self::request).
    pub fn change_settings(&self, settings: SolverSettings) -> Result<Response, RequestError> {
        let content = Request {
            settings,
            ..Request::default()
        };
        self.control
            .request(RequestKind::Settings, content, REQUEST_TIMEOUT)
    }

    /// A port that sends single reference chunks. [`feed`](Self::feed) is simpler to use.
    ///
    /// # Errors
    /// When the service has as many writers as it allows.
    pub fn reference_feed(&self) -> Result<ReferenceFeed, LinkError> {
        let outlet = Outlet::open(&self.services.reference, self.sender.clone())?;
        Ok(ReferenceFeed { outlet })
    }

    /// A port that sends obstacles, and checks them against the robot of the present status. Without a status
    /// it checks nothing.
    ///
    /// # Errors
    /// When the service has as many writers as it allows.
    pub fn obstacle_sender(&self) -> Result<ObstacleSender, LinkError> {
        let status = self.status(STATUS_TIMEOUT).ok();
        let robot = status.map(|status| status.robot);
        let outlet = Outlet::open(&self.services.obstacles, self.sender.clone())?;
        Ok(ObstacleSender { outlet, robot })
    }

    /// The ports of a driver that obeys `interface`: measurements out, commands in. The driver refuses
    /// commands beyond the robot limits in the daemon's status. A driver that needs no other part of a
    /// connection uses [`Driver::connect`].
    ///
    /// # Errors
    /// When the services have as many writers or readers as they allow, or [`LinkError::Silent`] when the
    /// daemon sends no status.
    pub fn driver(&self, interface: Interface) -> Result<Driver, LinkError> {
        let robot = self.status(STATUS_TIMEOUT)?.robot;
        let Services {
            measurement,
            command,
            ..
        } = &self.services;
        Driver::open(measurement, command, self.sender.clone(), &robot, interface)
    }

    /// The port of a process that measures the tip beside the driver (`link.tip_sensor = "separate"`).
    ///
    /// # Errors
    /// When the service has as many writers as it allows, or [`LinkError::Silent`] when the daemon sends no
    /// status.
    pub fn tip_sensor(&self) -> Result<TipSensor, LinkError> {
        let status = self.status(STATUS_TIMEOUT)?;
        TipSensor::open(&self.services.measurement, self.sender.clone(), &status)
    }

    /// Telemetry from now on: one record per cycle.
    ///
    /// # Errors
    /// When the service has as many readers as it allows.
    pub fn telemetry(&self) -> Result<TelemetryStream, LinkError> {
        Stream::open(&self.services.telemetry)
    }

    /// All commands from now on.
    ///
    /// # Errors
    /// When the service has as many readers as it allows.
    pub fn commands(&self) -> Result<CommandStream, LinkError> {
        Stream::open(&self.services.command)
    }

    /// The newest status and all later ones.
    ///
    /// # Errors
    /// When the service has as many readers as it allows.
    pub fn statuses(&self) -> Result<Stream<Status>, LinkError> {
        Stream::open(&self.services.status)
    }

    /// The last incidents, at most 64, oldest first, and each new one from now on. The old ones arrive after
    /// a short delay, about when the next status does.
    ///
    /// # Errors
    /// When the service has as many readers as it allows.
    pub fn incidents(&self) -> Result<Stream<Incident>, LinkError> {
        Stream::open(&self.services.incidents)
    }

    /// The reference chunks of all clients from now on.
    ///
    /// # Errors
    /// When the service has as many readers as it allows.
    pub fn references(&self) -> Result<Stream<ReferenceChunk>, LinkError> {
        Stream::open(&self.services.reference)
    }

    /// The obstacle messages of all clients from now on.
    ///
    /// # Errors
    /// When the service has as many readers as it allows.
    pub fn obstacle_updates(&self) -> Result<Stream<ObstacleUpdate>, LinkError> {
        Stream::open(&self.services.obstacles)
    }

    /// The measurements of the driver from now on.
    ///
    /// # Errors
    /// When the service has as many readers as it allows.
    pub fn measurements(&self) -> Result<Stream<Measurement>, LinkError> {
        Stream::open(&self.services.measurement)
    }

    /// Increments the lease number, when a lease begins or ends.
    pub(crate) fn number_lease(&self) -> u64 {
        self.leases.set(self.leases.get() + 1);
        self.leases.get()
    }

    pub(crate) fn newest_lease(&self) -> u64 {
        self.leases.get()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn a_missing_root_is_a_missing_daemon_and_nothing_is_created() {
        let root = Path::new("/tmp/cdcr-client-test-no-such-root");
        let location = Location::new("cdcr_client_test_", root).expect("legal");
        let error = Connection::open(&location, "trunk").expect_err("there is no daemon");
        let text = error.to_string();
        assert!(matches!(error, ConnectError::DaemonNotRunning { .. }));
        assert!(
            text.contains(
                "cdcrd run --robot trunk --prefix cdcr_client_test_ \
                 --root /tmp/cdcr-client-test-no-such-root"
            ),
            "{text}"
        );
        assert!(!root.exists());
    }

    #[test]
    fn a_bad_robot_name_is_refused_before_anything_is_opened() {
        let location = Location::new("cdcr_client_test_", Path::new("/tmp/x")).expect("legal");
        assert!(matches!(
            Connection::open(&location, "a/b"),
            Err(ConnectError::Robot(_))
        ));
    }
}
