use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use cdcr_shared_types::{Location, LocationError, Presence, ServiceNameError, ipc};
use iceoryx2::service::builder::publish_subscribe::PublishSubscribeOpenError;
use iceoryx2::service::builder::request_response::RequestResponseOpenError;

use crate::link_error::{LinkError, Liveness, process_text};

/// Where a daemon was looked for.
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
    /// The place of `robot` at `location`.
    pub(crate) fn new(location: &Location, robot: &str) -> Self {
        Self {
            prefix: location.prefix().to_owned(),
            root: location.root().to_owned(),
            robot: robot.to_owned(),
        }
    }

    /// Whether its daemon runs, by what it holds while it lives.
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

/// Why no connection to a daemon could be made.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ConnectError {
    /// Nobody answers there.
    #[error(
        "no daemon is running for {place}: {found}\n{}{}\
         start one with: cdcrd run --robot {robot} --prefix {prefix} --root {root}",
        running_text(running),
        if *as_service { SERVICE_TEXT } else { "" },
        robot = place.robot, prefix = place.prefix, root = place.root.display()
    )]
    DaemonNotRunning {
        /// Where it was looked for.
        place: Place,
        /// What was found instead.
        found: &'static str,
        /// Robots whose daemons run at that place.
        running: Vec<String>,
        /// Whether one for that robot and prefix runs as the service.
        as_service: bool,
    },
    /// A daemon runs, and shows no sign of life.
    #[error(
        "the daemon for {place} runs ({process}), but {found}\n\
         to stop the robot anyway: cdcrctl stop, or signal USR1 to that process"
    )]
    Silent {
        /// Where it was found.
        place: Place,
        /// Its process, in words.
        process: String,
        /// What is missing.
        found: &'static str,
    },
    /// The daemon speaks another version of the messages.
    #[error(
        "the daemon for {place} uses another version of the {service} service than this program ({}): {types}; \
         install daemon and clients of the same version and restart the daemon",
        env!("CARGO_PKG_VERSION")
    )]
    VersionMismatch {
        /// Where it was looked for.
        place: Place,
        /// Last part of the service's name.
        service: &'static str,
        /// The types of the daemon's messages and of this library's, in words.
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
        /// Where it was looked for.
        place: Place,
        /// User id of the owner of the root path.
        owner_id: u32,
        /// User id of this process.
        user_id: u32,
    },
    /// This process may only read the files.
    #[error(
        "{root} is read-only for this program, but every client writes there: mount it writable (in a unit: ReadWritePaths={root})",
        root = place.root.display()
    )]
    ReadOnly {
        /// Where it was looked for.
        place: Place,
    },
    /// As many processes as the service allows are connected already.
    #[error(
        "the daemon for {place} has reached its limit of clients on the {service} service: close one"
    )]
    Full {
        /// Where it was looked for.
        place: Place,
        /// Last part of the service's name.
        service: &'static str,
    },
    /// The robot's name is not legal.
    #[error(transparent)]
    Robot(#[from] ServiceNameError),
    /// The prefix or root path is not legal.
    #[error(transparent)]
    Location(#[from] LocationError),
    /// A port that is needed from the beginning could not be made.
    #[error(transparent)]
    Port(#[from] LinkError),
    /// Shared memory cannot be used at all.
    #[error("cannot use the shared memory for {place}: {cause}")]
    Memory {
        /// Where it was looked for.
        place: Place,
        /// What iceoryx2 says.
        cause: String,
    },
}

impl ConnectError {
    /// Nobody answers at `place`.
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

    /// Whether a daemon that is just starting may make this error go away.
    pub(crate) fn may_pass(&self) -> bool {
        matches!(
            self,
            Self::DaemonNotRunning { .. } | Self::Silent { .. } | Self::Memory { .. }
        )
    }

    /// Whether a client that leaves may, too.
    pub(crate) fn may_pass_with_others(&self) -> bool {
        self.may_pass() || matches!(self, Self::Full { .. } | Self::Port(_))
    }
}

/// A daemon whose services are there, and no status of it came.
pub(crate) fn no_status(location: &Location, place: &Place) -> ConnectError {
    not_reached(
        location,
        place,
        "it has sent no status for 1 s: it is stopped, delayed or short of memory",
        "its services exist, but no process owns them: it was killed",
    )
}

/// Tries again until `timeout`, while the error is one that `may_pass`.
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

/// A daemon that is not reached, though its services or their place are there: the truth by what it holds while it
/// lives.
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
        Liveness::Ended | Liveness::Unknown => ConnectError::not_running(place, found_of_dead),
    }
}

/// A line about the service, whose root folder is not the default one.
const SERVICE_TEXT: &str =
    "one runs as the service cdcrd: use its root folder, --root /run/cdcr or CDCR_ROOT=/run/cdcr\n";

/// A line about the robots that could have been meant.
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

/// What a failure of iceoryx2 to open a service means to us.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum OpenTrouble {
    Missing,
    Mismatch,
    Full,
    Other(String),
}

/// The two patterns have errors of their own, with the same names but for that of other types.
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
    fn who_names_no_root_folder_is_told_of_the_service() {
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
