use core::fmt::Debug;
use std::io;
use std::ops::Deref;
use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;
use std::sync::Once;

use cdcr_shared_types::message::{MessageLayout, Struct};
use cdcr_shared_types::shm_space::{self, NODE_FILES, PORT_BYTES, PORT_FILES};
use cdcr_shared_types::{
    Command, Incident, Location, Measurement, ObstacleUpdate, ReferenceChunk, Request, Response,
    Service, Status, Telemetry, ipc,
};
use iceoryx2::prelude::{LogLevel, Node, ServiceName, set_log_level_from_env_or};
use iceoryx2::service::Service as _;
use iceoryx2::service::messaging_pattern::MessagingPattern;
use iceoryx2::service::port_factory::{publish_subscribe, request_response};
use iceoryx2::service::static_config::messaging_pattern::MessagingPattern as Found;
use iceoryx2_log::get_log_level;

use crate::connect_error::{OpenTrouble, Place};
use crate::{ConnectError, LinkError, Message};

/// Shared memory of a connection without further ports \[bytes\]. Kept minimal, so that a stop can connect.
const CONNECTION_BYTES: u64 = 64 * 1024;

/// An open publish-subscribe service.
pub(crate) type Channel<T> = Open<publish_subscribe::PortFactory<ipc::Variant, T, ()>>;
/// The request-response service.
pub(crate) type ControlChannel =
    Open<request_response::PortFactory<ipc::Variant, Request, (), Response, ()>>;

/// An open service, and the folder that needs space for each of its ports.
#[derive(Debug, Clone)]
pub(crate) struct Open<S> {
    service: S,
    root: PathBuf,
    pub(crate) file: ServiceFile,
}

/// The file through which clients find a service, as it was when the service was opened.
///
/// A daemon that ends leaves it to the clients that have the service open, and the next daemon uses it. Only emptying or
/// replacing the root folder removes it; then no later daemon finds those clients.
#[derive(Debug, Clone)]
pub(crate) struct ServiceFile {
    path: PathBuf,
    /// Device and inode: a new mount over the folder may give the number of the old file to the new one.
    identity: Option<(u64, u64)>,
}

impl ServiceFile {
    pub(crate) fn new(path: PathBuf) -> Self {
        let file = path.symlink_metadata().ok();
        let identity = file.map(|file| (file.dev(), file.ino()));
        Self { path, identity }
    }

    /// Whether it was deleted or replaced. A file that cannot be examined was not: systemd changes the mode of the folder
    /// for a moment when it reloads a daemon.
    pub(crate) fn is_replaced(&self) -> bool {
        match self.path.symlink_metadata() {
            Ok(file) => self
                .identity
                .is_some_and(|identity| identity != (file.dev(), file.ino())),
            Err(cause) => cause.kind() == io::ErrorKind::NotFound,
        }
    }
}

impl<S> Open<S> {
    /// Creates a port whose messages take `bytes`, if there is space. If space runs out during creation, the
    /// error reports that instead of iceoryx2's text.
    pub(crate) fn make_port<P, E: Debug>(
        &self,
        service: Service,
        bytes: u64,
        create: impl FnOnce(&S) -> Result<P, E>,
        refused: impl FnOnce(String) -> LinkError,
    ) -> Result<P, LinkError> {
        let ask = || {
            shm_space::check(&self.root, bytes + PORT_BYTES, PORT_FILES)
                .map_err(|shortage| LinkError::memory(service, shortage))
        };
        ask()?;
        create(&self.service).map_err(|cause| match ask() {
            Err(shortage) => shortage,
            Ok(()) => refused(ipc::words(&cause)),
        })
    }
}

impl<S> Deref for Open<S> {
    type Target = S;

    fn deref(&self) -> &S {
        &self.service
    }
}

/// All services of one daemon, opened together, so that a version mismatch shows on connecting and not during
/// operation.
#[derive(Debug)]
pub(crate) struct Services {
    pub(crate) reference: Channel<ReferenceChunk>,
    pub(crate) obstacles: Channel<ObstacleUpdate>,
    pub(crate) measurement: Channel<Measurement>,
    pub(crate) command: Channel<Command>,
    pub(crate) telemetry: Channel<Telemetry>,
    pub(crate) status: Channel<Status>,
    pub(crate) incidents: Channel<Incident>,
    pub(crate) control: ControlChannel,
}

impl Services {
    /// Opens the services of a daemon; creates none. Call [`check_owner`] first.
    pub(crate) fn open(location: &Location, place: &Place) -> Result<Self, ConnectError> {
        let opener = Opener::new(location, place, Service::ALL.len())?;
        // The daemon also clears the leftovers of dead clients, but this client may need their places now.
        location.clear_dead_nodes(DEAD_NODES);
        Ok(Self {
            // First, because it allows the fewest clients: a refused client has then taken no place of a
            // driver.
            reference: opener.channel()?,
            status: opener.channel()?,
            obstacles: opener.channel()?,
            measurement: opener.channel()?,
            command: opener.channel()?,
            telemetry: opener.channel()?,
            incidents: opener.channel()?,
            control: opener.control()?,
        })
    }
}

/// The services of a driver only: the others may be full of monitoring clients.
#[derive(Debug)]
pub(crate) struct DriverServices {
    pub(crate) status: Channel<Status>,
    pub(crate) measurement: Channel<Measurement>,
    pub(crate) command: Channel<Command>,
}

impl DriverServices {
    pub(crate) fn open(location: &Location, place: &Place) -> Result<Self, ConnectError> {
        let opener = Opener::new(location, place, 3)?;
        location.clear_dead_nodes(DEAD_NODES);
        Ok(Self {
            status: opener.channel()?,
            measurement: opener.channel()?,
            command: opener.channel()?,
        })
    }
}

/// Maximum number of dead processes that a connecting client clears away: a few more than a killed daemon
/// leaves.
pub(crate) const DEAD_NODES: usize = 16;

/// Opens the service for requests only: a stop needs no other.
pub(crate) fn open_control(
    location: &Location,
    place: &Place,
) -> Result<ControlChannel, ConnectError> {
    Opener::new(location, place, 1)?.control()
}

struct Opener<'a> {
    node: Node<ipc::Variant>,
    place: &'a Place,
    /// Files of a connection without further ports.
    files: u64,
}

/// Turns off the log of iceoryx2: this library reports the errors itself. `IOX2_LOG_LEVEL` overrides this. A
/// level set by the program is kept, unless it is iceoryx2's default, `Info`.
fn turn_off_iceoryx2_log() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        if get_log_level() == LogLevel::Info as u8 {
            set_log_level_from_env_or(LogLevel::Fatal);
        }
    });
}

impl<'a> Opener<'a> {
    /// Opens a number of services.
    fn new(location: &Location, place: &'a Place, services: usize) -> Result<Self, ConnectError> {
        turn_off_iceoryx2_log();
        let files = NODE_FILES + services as u64;
        check_space(place, files)?;
        let node = location.client_node_builder()?.create::<ipc::Variant>();
        Ok(Self {
            node: node.map_err(|cause| memory_error(place, files, &ipc::words(&cause)))?,
            place,
            files,
        })
    }

    fn channel<T: Message + Struct>(&self) -> Result<Channel<T>, ConnectError> {
        let name = T::SERVICE.name(&self.place.robot)?;
        self.node
            .service_builder(&name)
            .publish_subscribe::<T>()
            .open()
            .map(|service| self.opened(service, &name, MessagingPattern::PublishSubscribe))
            .map_err(|cause| self.error(T::SERVICE, &[T::default().layout()], cause.into()))
    }

    fn control(&self) -> Result<ControlChannel, ConnectError> {
        let name = Service::Control.name(&self.place.robot)?;
        self.node
            .service_builder(&name)
            .request_response::<Request, Response>()
            .open()
            .map(|service| self.opened(service, &name, MessagingPattern::RequestResponse))
            .map_err(|cause| {
                let ours = [Request::default().layout(), Response::default().layout()];
                self.error(Service::Control, &ours, cause.into())
            })
    }

    fn opened<S>(&self, service: S, name: &ServiceName, pattern: MessagingPattern) -> Open<S> {
        let file = ipc::service_file(self.node.config(), name, pattern);
        Open {
            service,
            root: self.place.root.clone(),
            file: ServiceFile::new(file),
        }
    }

    /// Message types of a service: the daemon's, and this library's.
    fn types(&self, service: Service, ours: &[&MessageLayout]) -> String {
        let ours = joined(ours.iter().map(|layout| layout.type_name.to_owned()));
        match self.found(service) {
            Some(theirs) => format!("it has {theirs}, this program {ours}"),
            None => format!("this program has {ours}"),
        }
    }

    fn found(&self, service: Service) -> Option<String> {
        let name = service.name(&self.place.robot).ok()?;
        let pattern = match service {
            Service::Control => MessagingPattern::RequestResponse,
            _ => MessagingPattern::PublishSubscribe,
        };
        let found = ipc::Variant::details(&name, self.node.config(), pattern).ok()??;
        let types = match found.static_details.messaging_pattern() {
            Found::PublishSubscribe(found) => vec![found.message_type_details()],
            Found::RequestResponse(found) => vec![
                found.request_message_type_details(),
                found.response_message_type_details(),
            ],
            _ => return None,
        };
        let names = types
            .iter()
            .map(|details| details.payload.type_name().to_string());
        Some(joined(names))
    }

    fn error(
        &self,
        service: Service,
        ours: &[&MessageLayout],
        trouble: OpenTrouble,
    ) -> ConnectError {
        let place = self.place.clone();
        match trouble {
            OpenTrouble::Missing => {
                ConnectError::not_running(&place, "no services of that name exist")
            }
            OpenTrouble::Mismatch => ConnectError::VersionMismatch {
                place,
                service: service.key(),
                types: self.types(service, ours).into(),
            },
            OpenTrouble::Full => ConnectError::Full {
                place,
                service: service.key(),
            },
            OpenTrouble::Other(cause) => memory_error(self.place, self.files, &cause),
        }
    }
}

fn joined(types: impl Iterator<Item = String>) -> String {
    types.collect::<Vec<_>>().join(" and ")
}

/// Checks, before iceoryx2 does, whether this user may use the root path. A node would create a missing root
/// path, with a file that blocks a daemon of another user.
pub(crate) fn check_owner(location: &Location, place: &Place) -> Result<(), ConnectError> {
    let missing = |cause: io::Error| {
        let found = if cause.kind() == io::ErrorKind::PermissionDenied {
            "this user cannot read the root path (permission denied)"
        } else {
            "the root path does not exist"
        };
        ConnectError::not_running(place, found)
    };
    if location.is_read_only() {
        return Err(ConnectError::ReadOnly {
            place: place.clone(),
        });
    }
    if location.is_open_to_us().map_err(missing)? {
        return Ok(());
    }
    let owner_id = std::fs::metadata(&place.root).map_err(missing)?.uid();
    let user_id = rustix::process::geteuid().as_raw();
    Err(if owner_id == user_id {
        let found = "every user can write to the root path, which the daemon does not accept";
        ConnectError::not_running(place, found)
    } else {
        ConnectError::OtherUser {
            place: place.clone(),
            owner_id,
            user_id,
        }
    })
}

/// Checks that the daemon and this process are in time namespaces of equal clocks. Where `/proc` does not show
/// the daemon, they count as equal.
pub(crate) fn check_clock(location: &Location, place: &Place) -> Result<(), ConnectError> {
    let presence = location.presence(&place.robot);
    let Some(process_id) = presence.and_then(|presence| presence.process_id) else {
        return Ok(());
    };
    let offsets_s = [process_id, std::process::id()].map(clock_offset_s);
    match offsets_s {
        [Some(daemon_s), Some(own_s)] if daemon_s != own_s => Err(ConnectError::OtherClock {
            place: place.clone(),
            process_id,
            shift_s: daemon_s - own_s,
        }),
        _ => Ok(()),
    }
}

/// Offset of the process's `CLOCK_MONOTONIC` by its time namespace \[s\]; whole seconds, because nobody shifts
/// it by less.
fn clock_offset_s(process_id: u32) -> Option<i64> {
    // The file has the offsets of the namespace of its children.
    let namespace = |name: &str| std::fs::read_link(format!("/proc/{process_id}/ns/{name}")).ok();
    if namespace("time")? != namespace("time_for_children")? {
        return None;
    }
    let offsets = std::fs::read_to_string(format!("/proc/{process_id}/timens_offsets")).ok()?;
    let mut words = offsets.split_whitespace();
    words.find(|word| *word == "monotonic")?;
    words.next()?.parse().ok()
}

/// Checks for enough shared memory for a connection.
fn check_space(place: &Place, files: u64) -> Result<(), ConnectError> {
    shm_space::check(&place.root, CONNECTION_BYTES, files).map_err(|shortage| {
        ConnectError::Memory {
            place: place.clone(),
            cause: shortage.to_string(),
        }
    })
}

/// The shortage of shared memory, if there is one by now, otherwise `cause`.
fn memory_error(place: &Place, files: u64, cause: &str) -> ConnectError {
    check_space(place, files)
        .err()
        .unwrap_or_else(|| ConnectError::Memory {
            place: place.clone(),
            cause: cause.to_owned(),
        })
}
