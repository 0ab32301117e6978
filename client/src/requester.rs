use std::thread;
use std::time::{Duration, Instant};

use cdcr_shared_types::codes::RequestKind;
use cdcr_shared_types::{Location, Request, Response, Service};

use crate::connect_error::{Place, not_reached};
use crate::connection::REQUEST_TIMEOUT;
use crate::request::{Control, POLL_INTERVAL};
use crate::sender::MessageSender;
use crate::services::{ControlChannel, DEAD_NODES, check_clock, check_owner, open_control};
use crate::{ConnectError, LinkError, RequestError};

/// Time after which an unanswered stop is also sent as a signal. The program start included, that is within
/// 0.3 s.
const SIGNAL_AFTER: Duration = Duration::from_millis(200);
/// Minimum time for the answer, however long connecting took: enough for a few cycles.
const ANSWER_MIN: Duration = Duration::from_millis(20);

/// Sends requests to a daemon, one at a time.
///
/// It opens only the service for requests. So it needs no status, and no connection that monitoring or
/// feeding clients could have taken. It skips the leftovers of dead processes.
#[derive(Debug)]
pub struct Requester {
    control: Control,
    location: Location,
}

/// Why a stop is not confirmed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum StopError {
    /// No daemon runs: the answer is about the robot, not about how to start one.
    #[error("{}", nothing_stopped(.0))]
    NoDaemon(Box<ConnectError>),
    /// The request could not be sent.
    #[error(transparent)]
    Connect(#[from] ConnectError),
    /// The request was sent but not confirmed.
    #[error(transparent)]
    Request(#[from] RequestError),
    /// The stop was sent as a signal, which has no answer.
    #[error(
        "the stop is not confirmed: it was sent to the daemon (process {process_id}) as signal SIGUSR1, which takes \
         effect in its next cycle\nwatch the robot; the daemon cannot answer: {cause}"
    )]
    Unconfirmed {
        /// Process of the daemon.
        process_id: u32,
        /// Why the request failed.
        cause: String,
    },
}

fn nothing_stopped(error: &ConnectError) -> String {
    let ConnectError::DaemonNotRunning { place, found, .. } = error else {
        return error.to_string();
    };
    format!(
        "nothing was stopped: no daemon is running for {place}: {found}\n\
         if the robot moves, use its emergency stop\n{}\
         a daemon that starts later is not stopped by this: repeat it then",
        error.elsewhere()
    )
}

impl Requester {
    /// Opens the service for requests of the daemon that controls `robot` at `location`.
    ///
    /// # Errors
    /// As [`Connection::open`](crate::Connection::open), except for the status, which is not needed.
    pub fn open(location: &Location, robot: &str) -> Result<Self, ConnectError> {
        check_clock(location, &Place::new(location, robot))?;
        Self::open_until(location, robot, Instant::now() + REQUEST_TIMEOUT)
    }

    fn open_until(
        location: &Location,
        robot: &str,
        deadline: Instant,
    ) -> Result<Self, ConnectError> {
        let place = Place::new(location, robot);
        Service::Control.name(robot)?;
        check_owner(location, &place)?;
        if location.presence(robot).is_none() {
            return Err(ConnectError::not_running(
                &place,
                "no process holds its lock",
            ));
        }
        let channel = open_when_free(location, &place, deadline)?;
        Ok(Self {
            control: Control::new(channel, MessageSender::new(), place),
            location: location.clone(),
        })
    }

    /// Sends a request and waits for the answer, at most 1 s.
    ///
    /// # Errors
    /// As [`Connection::request`](crate::Connection::request).
    pub fn request(&self, kind: RequestKind) -> Result<Response, RequestError> {
        self.control
            .request(kind, Request::default(), REQUEST_TIMEOUT)
    }

    /// Sends a reset and waits for the answer, at most 1 s.
    ///
    /// # Errors
    /// As [`Connection::reset`](crate::Connection::reset).
    pub fn reset(&self, accept_pose: bool) -> Result<Response, RequestError> {
        self.control.reset(accept_pose, REQUEST_TIMEOUT)
    }

    /// Stops the robot by every available means. It first sends a request over a port reserved for stops. If
    /// shared memory cannot be used or no answer arrives within 0.2 s, it also sends the signal `SIGUSR1`.
    /// Then it requests the stop for up to 1 s more, to get it confirmed. If no daemon is running, it waits
    /// up to 1 s for one that is restarting.
    ///
    /// # Errors
    /// No daemon is running, or the stop is not confirmed: [`StopError`] describes what was done.
    pub fn stop(location: &Location, robot: &str) -> Result<Response, StopError> {
        let deadline = Instant::now() + REQUEST_TIMEOUT;
        let mut first = Self::request_stop(location, robot, SIGNAL_AFTER);
        // A restarting daemon executes requests that clients made of its predecessor.
        while is_no_daemon(&first) && Instant::now() < deadline {
            thread::sleep(POLL_INTERVAL);
            first = Self::request_stop(location, robot, SIGNAL_AFTER);
        }
        if is_answered(&first) {
            return first;
        }
        let signalled = location.stop_by_signal(robot);
        // A second stop does no harm.
        let second = Self::request_stop(location, robot, REQUEST_TIMEOUT);
        match (second, signalled) {
            (second, _) if is_answered(&second) => second,
            (Err(failed), Ok(process_id)) => Err(StopError::Unconfirmed {
                process_id,
                // Only the first line: the remedy in the others, a signal, has just been applied.
                cause: failed
                    .to_string()
                    .lines()
                    .next()
                    .unwrap_or_default()
                    .to_owned(),
            }),
            (Err(StopError::Connect(error @ ConnectError::DaemonNotRunning { .. })), _) => {
                Err(StopError::NoDaemon(Box::new(error)))
            }
            (second, _) => second,
        }
    }

    fn request_stop(
        location: &Location,
        robot: &str,
        timeout: Duration,
    ) -> Result<Response, StopError> {
        let deadline = Instant::now() + timeout;
        let Self { control, location } = Self::open_until(location, robot, deadline)?;
        let control = control.with_reserved_places();
        // Clients on reserved ports only stop the robot, too, and leave soon.
        while let Err(LinkError::Askers { .. }) = control.port() {
            if Instant::now() >= deadline {
                break;
            }
            location.clear_dead_nodes(DEAD_NODES);
            thread::sleep(POLL_INTERVAL);
        }
        let left = deadline.saturating_duration_since(Instant::now());
        let waits = left.max(ANSWER_MIN);
        Ok(control.request(RequestKind::Stop, Request::default(), waits)?)
    }
}

/// Whether the daemon has answered the stop; then a signal is not needed.
fn is_answered(stop: &Result<Response, StopError>) -> bool {
    matches!(
        stop,
        Ok(_) | Err(StopError::Request(RequestError::Refused { .. }))
    )
}

fn is_no_daemon(stop: &Result<Response, StopError>) -> bool {
    matches!(
        stop,
        Err(StopError::Connect(ConnectError::DaemonNotRunning { .. }))
    )
}

/// Opens the service. While it has as many clients as it allows, this waits: its clients stay only briefly.
fn open_when_free(
    location: &Location,
    place: &Place,
    deadline: Instant,
) -> Result<ControlChannel, ConnectError> {
    loop {
        match open_control(location, place) {
            Err(ConnectError::Full { .. }) if Instant::now() < deadline => {
                location.clear_dead_nodes(DEAD_NODES);
                thread::sleep(POLL_INTERVAL);
            }
            // The daemon was found running before.
            Err(ConnectError::DaemonNotRunning { found, .. }) => {
                let missing = "files of its root folder are missing: the daemon is just starting, or the folder was emptied";
                return Err(not_reached(location, place, missing, found));
            }
            result => return result,
        }
    }
}
