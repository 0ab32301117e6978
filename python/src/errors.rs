//! Exceptions: the error and, as `.remedy`, what to do. Their classes are in `cdcr/_errors.py`.

use cdcr_client::{
    ConnectError, FeedError, LinkError, Liveness, PlantError, PoseDifference, RequestError,
    StopError, remedy, request_remedy,
};
use cdcr_controller::nmpc::SettingsError;
use cdcr_controller::plant::FlawError;
use cdcr_controller::robot::{ObstacleError, RobotError};
use pyo3::prelude::*;

/// The class of an exception.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Class {
    Argument,
    Connect,
    Link,
    Request,
    Feed,
    Recording,
}

impl Class {
    fn name(self) -> &'static str {
        match self {
            Self::Argument => "ArgumentError",
            Self::Connect => "ConnectError",
            Self::Link => "LinkError",
            Self::Request => "RequestError",
            Self::Feed => "FeedError",
            Self::Recording => "RecordingError",
        }
    }
}

/// An error before its conversion to a Python exception.
#[derive(Debug, Clone)]
pub(crate) struct Failure {
    class: Class,
    message: String,
    remedy: String,
    /// Of a refused reset.
    pose: PoseDifference,
}

impl Failure {
    /// The errors of the client library end with their remedy; here it is only in `remedy`.
    pub(crate) fn new(class: Class, message: impl ToString, remedy: impl ToString) -> Self {
        let (message, remedy) = (message.to_string(), remedy.to_string());
        let what = message.strip_suffix(&remedy).filter(|_| !remedy.is_empty());
        Self {
            class,
            message: what
                .map_or(message.as_str(), |what| what.trim_end_matches(['.', ' ']))
                .to_owned(),
            remedy,
            pose: PoseDifference::default(),
        }
    }

    /// An invalid argument of a function.
    pub(crate) fn argument(message: impl ToString, remedy: impl ToString) -> Self {
        Self::new(Class::Argument, message, remedy)
    }
}

impl From<Failure> for PyErr {
    fn from(failure: Failure) -> Self {
        Python::attach(|py| {
            let class = py
                .import("cdcr._errors")
                .and_then(|module| module.getattr(failure.class.name()));
            let made = class.and_then(|class| {
                let exception = class.call1((failure.message, failure.remedy))?;
                if failure.pose.section != 0 {
                    exception.setattr("section", failure.pose.section)?;
                    exception.setattr("distance_rad", failure.pose.rad)?;
                }
                Ok(exception)
            });
            match made {
                Ok(exception) => Self::from_value(exception),
                Err(error) => error,
            }
        })
    }
}

/// Remedy for errors that only a bug in this package can raise.
pub(crate) const REPORT: &str =
    "This is an error of the package: report it with the call that raised it.";
const FREE_MEMORY: &str =
    "Free memory in the file system of the root folder: df shows how much is left.";
const RANGE: &str = "Give a value inside the range; units are SI and end the names.";

impl From<RobotError> for Failure {
    fn from(error: RobotError) -> Self {
        Self::argument(error, RANGE)
    }
}

impl From<ObstacleError> for Failure {
    fn from(error: ObstacleError) -> Self {
        Self::argument(error, RANGE)
    }
}

impl From<FlawError> for Failure {
    fn from(error: FlawError) -> Self {
        Self::argument(error, RANGE)
    }
}

impl From<SettingsError> for Failure {
    fn from(error: SettingsError) -> Self {
        Self::argument(&error, RANGE)
    }
}

impl From<PlantError> for Failure {
    fn from(error: PlantError) -> Self {
        match error {
            PlantError::Link(error) => error.into(),
            other => Self::argument(other, RANGE),
        }
    }
}

impl From<LinkError> for Failure {
    fn from(error: LinkError) -> Self {
        let remedy = match &error {
            LinkError::Misplaced { .. } => {
                return Self::argument(&error, "Convert to m, or send it anyway with far=True.");
            }
            LinkError::Port { .. } | LinkError::Askers { .. } => "Close another client.",
            LinkError::Memory { .. } => FREE_MEMORY,
            LinkError::Silent { liveness, .. } => next_after_silence(*liveness),
            LinkError::ChunkPoints { .. } | LinkError::Obstacles { .. } => "Send fewer at a time.",
            LinkError::Replaced { .. } | LinkError::Send { .. } | LinkError::Receive { .. } => {
                "Connect again."
            }
        };
        Self::new(Class::Link, &error, remedy)
    }
}

impl From<ConnectError> for Failure {
    fn from(error: ConnectError) -> Self {
        if let ConnectError::Port(error) = error {
            return error.into();
        }
        let remedy = match &error {
            ConnectError::DaemonNotRunning { .. } => {
                "Start a daemon with cdcrd run, with the same robot, prefix and root."
            }
            ConnectError::Silent { .. } => {
                "End the daemon and start it again; to stop the robot: cdcrctl stop."
            }
            ConnectError::VersionMismatch { .. } => "Install daemon and package of one version.",
            ConnectError::OtherUser { .. } => {
                "Run as the daemon's user, or start a daemon of your own with another root."
            }
            ConnectError::OtherClock { .. } => "Run in the daemon's time namespace.",
            ConnectError::ReadOnly { .. } => "Mount the root folder writable.",
            ConnectError::Full { .. } => "Close another client.",
            ConnectError::Robot(_) => "Use 1 to 40 letters, digits, '-' and '_'.",
            ConnectError::Location(_) => "Give prefix and root as the daemon has them.",
            ConnectError::Port(_) | ConnectError::Memory { .. } => {
                "Check that root is a folder that this user may read and write, and with df that it has memory left."
            }
        };
        Self::new(Class::Connect, &error, remedy)
    }
}

impl From<RequestError> for Failure {
    fn from(error: RequestError) -> Self {
        let next = match &error {
            RequestError::Refused {
                asked,
                outcome,
                mode,
                ..
            } => request_remedy(asked.kind(), *outcome, *mode),
            RequestError::Restarted => "Feed again.",
            RequestError::Timeout { liveness, .. } => next_after_silence(*liveness),
            RequestError::Link { .. } => next_after_silence(Liveness::Unknown),
            RequestError::Answer { .. } => "Install daemon and package of one version.",
        };
        let pose = match &error {
            RequestError::Refused { pose, .. } => *pose,
            _ => PoseDifference::default(),
        };
        Self {
            pose,
            ..Self::new(Class::Request, &error, next)
        }
    }
}

impl From<StopError> for Failure {
    fn from(error: StopError) -> Self {
        match error {
            StopError::NoDaemon(_) => {
                let text = error.to_string();
                let (what, next) = text.split_once('\n').unwrap_or((&text, ""));
                Self::new(Class::Connect, what, next)
            }
            StopError::Connect(error) => error.into(),
            StopError::Request(error) => error.into(),
            unconfirmed @ StopError::Unconfirmed { .. } => {
                Self::new(Class::Request, unconfirmed, "Watch the robot.")
            }
        }
    }
}

impl From<FeedError> for Failure {
    fn from(error: FeedError) -> Self {
        let next = match error {
            FeedError::Request(error) => return error.into(),
            FeedError::Link(error) => return error.into(),
            FeedError::Option { .. } | FeedError::Duration { .. } => {
                return Self::argument(&error, RANGE);
            }
            FeedError::Refused { outcome, .. } => remedy(outcome),
            FeedError::Ignored => next_after_silence(Liveness::Unknown),
            FeedError::Restarted { .. } => "Feed again.",
            FeedError::LeaseLost { .. } => {
                "End the client that holds the lease (cdcrctl status), or wait for it; then feed again."
            }
            FeedError::TooLate { .. } => "Feed again, with a longer lead.",
            FeedError::LeftTracking { remedy, .. } => remedy,
        };
        Self::new(Class::Feed, &error, next)
    }
}

fn next_after_silence(liveness: Liveness) -> &'static str {
    match liveness {
        Liveness::Ended => {
            "Start a daemon with cdcrd run; this connection is used by the next one, too."
        }
        Liveness::Runs { .. } => {
            "Wait and try again; cdcrctl stop stops the robot. A daemon that stays silent needs to be started again."
        }
        Liveness::Replaced => "Connect again.",
        Liveness::Unknown => "Check with cdcrctl status whether the daemon runs.",
    }
}
