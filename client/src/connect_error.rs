use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use cdcr_shared_types::{Location, LocationError, Presence, ServiceNameError, ipc};
use iceoryx2::service::builder::publish_subscribe::PublishSubscribeOpenError;
use iceoryx2::service::builder::request_response::RequestResponseOpenError;

use crate::link_error::{LinkError, Liveness, process_text};

/// Address of a daemon.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place {
    /// Prefix of the shared-memory files.
    pub prefix: String,
    /// Root path.
    pub root: PathBuf,
    /// Name of the robot.
    pub robot: String,
}

impl Place {
    pub(crate) fn new(location: &Location, robot: &str) -> Self {
        Self {
            prefix: location.prefix().to_owned(),
            root: location.root().to_owned(),
            robot: robot.to_owned(),
        }
    }

    /// Liveness of the daemon, from the lock and the name that a live daemon holds.
    pub(crate) fn liveness(&self) -> Liveness {
        match Location::new(&self.prefix, &self.root) {
            Ok(location) => liveness(&location, &self.robot),
            Err(_) => Liveness::Unknown,
        }
    }
}

fn liveness(location: &Location, robot: &str) -> Liveness {
    match location.presence(robot) {
        Some(Presence { process_id }) => Liveness::Runs { process_id },
        None => Liveness::Ended,
    }
}

impl core::fmt::Display for Place {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(
            f,
            "robot {:?}, prefix {:?}, root {}",
            self.robot,
            self.prefix,
            self.root.display()
        )
    }
}

/// Why a connection to a daemon failed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ConnectError {
    /// No daemon is running there.
    #[error(
        "no daemon is running for {place}: {found}\n{}{}\
         start one with: cdcrd run --robot {robot} --prefix {prefix} --root {root}",
        running_text(running),
        if *as_service { SERVICE_TEXT } else { "" },
        robot = place.robot, prefix = place.prefix, root = place.root.display()
    )]
    DaemonNotRunning {
        /// The place that was searched.
        place: Place,
        /// What was found there instead.
        found: &'static str,
        /// Robots whose daemons run at that place.
        running: Vec<String>,
        /// Whether a daemon for that robot and prefix runs as the service.
        as_service: bool,
    },
    /// A daemon runs but does not respond.
    #[error(
        "the daemon for {place} runs ({process}), but {found}\n\
         to stop the robot anyway: cdcrctl stop, or signal USR1 to that process"
    )]
    Silent {
        /// Place of the daemon.
        place: Place,
        /// Text about its process.
        process: String,
        /// What is missing.
        found: &'static str,
    },
    /// The daemon uses another version of the messages.
    #[error(
        "the daemon for {place} uses another version of the {service} service than this program ({}): {types}; \
         install daemon and clients of the same version and restart the daemon",
        env!("CARGO_PKG_VERSION")
    )]
    VersionMismatch {
        /// Place of the daemon.
        place: Place,
        /// Last part of the service's name.
        service: &'static str,
        /// Text with the message types of the daemon and of this library.
        types: Box<str>,
    },
    /// The files belong to another user.
    #[error(
        "{} belongs to user {owner_id}, this program runs as user {user_id}: only the \
         daemon's own user and the group in transport.group have access. Run as that user (for example sudo -u '#{owner_id}' cdcrctl …), or start \
         a daemon of your own with another --root",
        place.root.display()
    )]
    OtherUser {
        /// Place of the files.
        place: Place,
        /// User id of the owner of the root path.
        owner_id: u32,
        /// User id of this process.
        user_id: u32,
    },
    /// The clock of this process is another one, by which every message would be stamped in the future or long
    /// ago.
    #[error(
        "the daemon for {place} (process {process_id}) runs in another time namespace, where CLOCK_MONOTONIC \
         differs by {shift_s} s: start this program in the same one (nsenter --time --target {process_id} …)\n\
         to stop the robot anyway: cdcrctl stop"
    )]
    OtherClock {
        /// Place of the daemon.
        place: Place,
        /// Process of the daemon.
        process_id: u32,
        /// Time of the daemon's clock less that of this process \[s\].
        shift_s: i64,
    },
    /// This process has read-only access to the files.
    #[error(
        "{root} is read-only for this program, but every client writes there: mount it writable (in a unit: ReadWritePaths={root})",
        root = place.root.display()
    )]
    ReadOnly {
        /// Place of the files.
        place: Place,
    },
    /// The service has as many clients as it allows.
    #[error(
        "the daemon for {place} has reached its limit of clients on the {service} service: close one"
    )]
    Full {
        /// Place of the daemon.
        place: Place,
        /// Last part of the service's name.
        service: &'static str,
    },
    /// The robot's name is invalid.
    #[error(transparent)]
    Robot(#[from] ServiceNameError),
    /// The prefix or root path is invalid.
    #[error(transparent)]
    Location(#[from] LocationError),
    /// A port that the connection needs from the start could not be created.
    #[error(transparent)]
    Port(#[from] LinkError),
    /// Shared memory cannot be used.
    #[error("cannot use the shared memory for {place}: {cause}")]
    Memory {
        /// Place of the daemon.
        place: Place,
        /// Error text of iceoryx2, or the shortage of shared memory.
        cause: String,
    },
}

impl ConnectError {
    pub(crate) fn not_running(place: &Place, found: &'static str) -> Self {
        let location = Location::new(&place.prefix, &place.root);
        Self::DaemonNotRunning {
            place: place.clone(),
            found,
            running: location.map_or_else(|_| Vec::new(), |location| location.robots()),
            as_service: place.root != Path::new(Location::SERVICE_ROOT)
                && Location::new(&place.prefix, Path::new(Location::SERVICE_ROOT))
                    .is_ok_and(|service| service.presence(&place.robot).is_some()),
        }
    }

    /// Whether the error may pass because a daemon is just starting.
    pub(crate) fn may_pass(&self) -> bool {
        matches!(
            self,
            Self::DaemonNotRunning { .. } | Self::Silent { .. } | Self::Memory { .. }
        )
    }

    /// Like `may_pass`, also for errors that pass when another client disconnects.
    pub(crate) fn may_pass_with_others(&self) -> bool {
        self.may_pass() || matches!(self, Self::Full { .. } | Self::Port(_))
    }
}

/// The error for a daemon whose services exist but that has sent no status.
pub(crate) fn no_status(location: &Location, place: &Place) -> ConnectError {
    not_reached(
        location,
        place,
        "it has sent no status for 1 s: it is stopped, delayed or short of memory",
        "its services exist, but no process owns them: it has ended",
    )
}

/// Repeats `connect` until `timeout` while `may_pass` accepts the error.
pub(crate) fn retry<T>(
    timeout: Duration,
    may_pass: impl Fn(&ConnectError) -> bool,
    mut connect: impl FnMut() -> Result<T, ConnectError>,
) -> Result<T, ConnectError> {
    let deadline = Instant::now() + timeout;
    loop {
        match connect() {
            Err(error) if may_pass(&error) && Instant::now() < deadline => {
                thread::sleep(Duration::from_millis(20));
            }
            result => return result,
        }
    }
}

/// The error for a daemon that cannot be reached although its services or its place exist. Its lock and name
/// decide whether it runs.
pub(crate) fn not_reached(
    location: &Location,
    place: &Place,
    found: &'static str,
    found_of_dead: &'static str,
) -> ConnectError {
    match liveness(location, &place.robot) {
        Liveness::Runs { process_id } => ConnectError::Silent {
            process: process_text(process_id),
            place: place.clone(),
            found,
        },
        Liveness::Ended | Liveness::Replaced | Liveness::Unknown => {
            ConnectError::not_running(place, found_of_dead)
        }
    }
}

impl ConnectError {
    /// Where daemons run instead, a line each; empty: nowhere, or not known.
    pub(crate) fn elsewhere(&self) -> String {
        let Self::DaemonNotRunning {
            running,
            as_service,
            ..
        } = self
        else {
            return String::new();
        };
        let service = if *as_service { SERVICE_TEXT } else { "" };
        format!("{}{service}", running_text(running))
    }
}

/// Hint for a daemon that runs as the service: its root folder is not the default one.
const SERVICE_TEXT: &str =
    "one runs as the service cdcrd: use its root folder, --root /run/cdcr or CDCR_ROOT=/run/cdcr\n";

/// Hint with the robots whose daemons run at the place.
fn running_text(running: &[String]) -> String {
    match running {
        [] => String::new(),
        [one] => format!("the robot that runs there: {one} (--robot {one})\n"),
        some => format!(
            "the robots that run there: {} (--robot NAME)\n",
            some.join(", ")
        ),
    }
}

/// Meaning of an iceoryx2 error on opening a service.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum OpenTrouble {
    Missing,
    Mismatch,
    Full,
    Other(String),
}

// The two messaging patterns have error types of their own; only the name of the type-mismatch variant
// differs.
macro_rules! open_trouble {
    ($error:ident, $other_types:ident) => {
        impl From<$error> for OpenTrouble {
            fn from(error: $error) -> Self {
                match error {
                    $error::DoesNotExist
                    | $error::IsMarkedForDestruction
                    | $error::HangsInCreation
                    | $error::ServiceInCorruptedState => Self::Missing,
                    $error::$other_types
                    | $error::IncompatibleMessagingPattern
                    | $error::IncompatibleAttributes
                    | $error::VersionMismatch => Self::Mismatch,
                    $error::ExceedsMaxNumberOfNodes => Self::Full,
                    other => Self::Other(ipc::words(&other)),
                }
            }
        }
    };
}

open_trouble!(PublishSubscribeOpenError, IncompatibleTypes);
open_trouble!(RequestResponseOpenError, IncompatibleRequestOrResponseType);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_a_root_folder_the_error_names_the_service() {
        let location = Location::new("cdcr_unit_", Path::new("/dev/shm/none")).expect("legal");
        let place = Place::new(&location, "trunk");
        let text = |as_service| {
            ConnectError::DaemonNotRunning {
                place: place.clone(),
                found: "nothing",
                running: Vec::new(),
                as_service,
            }
            .to_string()
        };
        assert!(text(true).contains("--root /run/cdcr or CDCR_ROOT=/run/cdcr\nstart one"));
        assert!(!text(false).contains("/run/cdcr"));
        let unasked = ConnectError::not_running(&place, "nothing").to_string();
        assert_eq!(unasked, text(false), "no service has that prefix");
    }
}
