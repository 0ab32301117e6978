use std::thread;
use std::time::{Duration, Instant};

use cdcr_shared_types::codes::RequestKind;
use cdcr_shared_types::{Location, Response, Service, SolverSettings};

use crate::connect_error::{Place, not_reached};
use crate::request::{Control, LOOK_AGAIN};
use crate::sender::Sender;
use crate::services::{ControlChannel, DEAD_NODES, check_owner, open_control};
use crate::{ConnectError, LinkError, RequestError};

/// How long a request tries to find a place, and then waits for its answer.
const TIMEOUT: Duration = Duration::from_secs(1);
/// How long a stop tries to be answered before it goes as a signal, too. With the start of a program that is within 0.3 s.
const SIGNAL_AFTER: Duration = Duration::from_millis(200);
/// How long it waits for an answer, however long it took to find a place: enough for a few cycles.
const ANSWER_MIN: Duration = Duration::from_millis(20);

/// Asks a daemon for one thing after the other, and does nothing else.
///
/// It opens the service for requests alone. So it needs no status, and no place that clients who watch or feed could
/// have taken; what dead processes left it does not look at.
#[derive(Debug)]
pub struct Requester {
    control: Control,
    location: Location,
}

/// Why a stop was not confirmed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum StopError {
    /// It could not be asked for at all.
    #[error(transparent)]
    Connect(#[from] ConnectError),
    /// It was asked for, and no answer said that it is done.
    #[error(transparent)]
    Request(#[from] RequestError),
    /// It went another way, which knows no answer.
    #[error(
        "the stop is not confirmed: it was sent to the daemon (process {process_id}) as signal SIGUSR1, which takes \
         effect in its next cycle\nwatch the robot; the daemon cannot answer: {cause}"
    )]
    Unconfirmed {
        /// Process of the daemon.
        process_id: u32,
        /// Why it went that way.
        cause: String,
    },
}

impl Requester {
    /// Opens the way to the daemon that controls `robot` at `location`.
    ///
    /// # Errors
    /// As [`Connection::open`](crate::Connection::open), but for the status, which it does not need.
    pub fn open(location: &Location, robot: &str) -> Result<Self, ConnectError> {
        Self::open_until(location, robot, Instant::now() + TIMEOUT)
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
        let channel = find_place(location, &place, deadline)?;
        Ok(Self {
            control: Control::new(channel, Sender::new(), place),
            location: location.clone(),
        })
    }

    /// Asks for something and waits for the answer, at most 1 s.
    ///
    /// # Errors
    /// As [`Connection::request`](crate::Connection::request).
    pub fn request(&self, kind: RequestKind) -> Result<Response, RequestError> {
        self.control.ask(kind, SolverSettings::default(), TIMEOUT)
    }

    /// Stops the robot, by whatever way there is: a place of its own among those who ask, and where shared memory
    /// cannot be used or nobody answers within 0.2 s, the signal `SIGUSR1`, too. After that it asks for up to 1 s more,
    /// for an answer that confirms it. Where no daemon runs, it waits for up to 1 s for one that is just started again.
    ///
    /// # Errors
    /// No daemon runs, or nothing confirmed the stop: then [`StopError`] says what was done.
    pub fn stop(location: &Location, robot: &str) -> Result<Response, StopError> {
        let deadline = Instant::now() + TIMEOUT;
        let mut first = Self::ask_for_stop(location, robot, SIGNAL_AFTER);
        // A daemon that is just started again carries out what others asked of the one before.
        while finds_no_daemon(&first) && Instant::now() < deadline {
            thread::sleep(LOOK_AGAIN);
            first = Self::ask_for_stop(location, robot, SIGNAL_AFTER);
        }
        if is_answered(&first) {
            return first;
        }
        let signalled = location.stop_by_signal(robot);
        // A robot that is stopped twice is stopped.
        let second = Self::ask_for_stop(location, robot, TIMEOUT);
        match (second, signalled) {
            (second, _) if is_answered(&second) => second,
            (Err(failed), Ok(process_id)) => Err(StopError::Unconfirmed {
                process_id,
                // What to do instead has just been done.
                cause: failed
                    .to_string()
                    .lines()
                    .next()
                    .unwrap_or_default()
                    .to_owned(),
            }),
            (second, _) => second,
        }
    }

    fn ask_for_stop(
        location: &Location,
        robot: &str,
        patience: Duration,
    ) -> Result<Response, StopError> {
        let deadline = Instant::now() + patience;
        let Self { control, location } = Self::open_until(location, robot, deadline)?;
        let control = control.with_kept_places();
        // Who has a kept place leaves it soon: it only stops, too.
        while let Err(LinkError::Askers { .. }) = control.port() {
            if Instant::now() >= deadline {
                break;
            }
            location.clear_dead_nodes(DEAD_NODES);
            thread::sleep(LOOK_AGAIN);
        }
        let left = deadline.saturating_duration_since(Instant::now());
        let waits = left.max(ANSWER_MIN);
        Ok(control.ask(RequestKind::Stop, SolverSettings::default(), waits)?)
    }
}

/// Whether the daemon has said what came of it, so that a signal could add nothing.
fn is_answered(stop: &Result<Response, StopError>) -> bool {
    matches!(
        stop,
        Ok(_) | Err(StopError::Request(RequestError::Refused { .. }))
    )
}

fn finds_no_daemon(stop: &Result<Response, StopError>) -> bool {
    matches!(
        stop,
        Err(StopError::Connect(ConnectError::DaemonNotRunning { .. }))
    )
}

/// Opens the service. Where others have all places, it waits for one: they are for those who stay for a moment.
fn find_place(
    location: &Location,
    place: &Place,
    deadline: Instant,
) -> Result<ControlChannel, ConnectError> {
    loop {
        match open_control(location, place) {
            Err(ConnectError::Full { .. }) if Instant::now() < deadline => {
                location.clear_dead_nodes(DEAD_NODES);
                thread::sleep(LOOK_AGAIN);
            }
            // It has just been seen to run.
            Err(ConnectError::DaemonNotRunning { found, .. }) => {
                let missing = "files of its root folder are missing: the daemon is just starting, or the folder was emptied";
                return Err(not_reached(location, place, missing, found));
            }
            result => return result,
        }
    }
}
