use std::io;
use std::os::unix::fs::MetadataExt;

use cdcr_shared_types::{
    Command, Incident, Location, Measurement, ObstacleUpdate, ReferenceChunk, Request, Response,
    Service, Status, Telemetry,
};
use iceoryx2::prelude::{Node, ipc};
use iceoryx2::service::port_factory::{publish_subscribe, request_response};

use crate::connect_error::{OpenTrouble, Place};
use crate::{ConnectError, Message};

/// A publish-subscribe service that is open.
pub(crate) type Channel<T> = publish_subscribe::PortFactory<ipc::Service, T, ()>;
/// The request-response service.
pub(crate) type ControlChannel =
    request_response::PortFactory<ipc::Service, Request, (), Response, ()>;

/// All services of one daemon, open, so that a difference of version shows at once and not in the
/// middle of the work.
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
    /// Opens what a daemon has created; creates nothing. [`check_root`] comes first.
    pub(crate) fn open(location: &Location, place: &Place) -> Result<Self, ConnectError> {
        let opener = Opener {
            node: location
                .node_builder()?
                .create::<ipc::Service>()
                .map_err(|cause| memory_error(place, &format!("{cause:?}")))?,
            place,
        };
        Ok(Self {
            status: opener.channel()?,
            reference: opener.channel()?,
            obstacles: opener.channel()?,
            measurement: opener.channel()?,
            command: opener.channel()?,
            telemetry: opener.channel()?,
            incidents: opener.channel()?,
            control: opener.control()?,
        })
    }
}

struct Opener<'a> {
    node: Node<ipc::Service>,
    place: &'a Place,
}

impl Opener<'_> {
    fn channel<T: Message>(&self) -> Result<Channel<T>, ConnectError> {
        let name = T::SERVICE.name(&self.place.robot)?;
        self.node
            .service_builder(&name)
            .publish_subscribe::<T>()
            .open()
            .map_err(|cause| self.error(T::SERVICE, cause.into()))
    }

    fn control(&self) -> Result<ControlChannel, ConnectError> {
        let name = Service::Control.name(&self.place.robot)?;
        self.node
            .service_builder(&name)
            .request_response::<Request, Response>()
            .open()
            .map_err(|cause| self.error(Service::Control, cause.into()))
    }

    fn error(&self, service: Service, trouble: OpenTrouble) -> ConnectError {
        let place = self.place.clone();
        let service = service.key();
        match trouble {
            OpenTrouble::Missing => ConnectError::DaemonNotRunning {
                place,
                found: "there are no services of that name",
            },
            OpenTrouble::Mismatch => ConnectError::VersionMismatch {
                place,
                service,
                version: env!("CARGO_PKG_VERSION"),
            },
            OpenTrouble::Full => ConnectError::Full { place, service },
            OpenTrouble::Other(cause) => memory_error(self.place, &cause),
        }
    }
}

/// Looks at the root path before iceoryx2 does. A node would create one that is missing, and would
/// leave a file of ours in the way of a daemon that runs as another user.
pub(crate) fn check_root(place: &Place) -> Result<(), ConnectError> {
    let missing = |cause: io::Error| ConnectError::DaemonNotRunning {
        place: place.clone(),
        found: if cause.kind() == io::ErrorKind::PermissionDenied {
            "this user cannot look into the root path (permission denied)"
        } else {
            "the root path does not exist"
        },
    };
    let root = std::fs::metadata(&place.root).map_err(missing)?;
    // The files are private to their owner (0600), and to the superuser.
    let user_id = rustix::process::geteuid();
    if user_id.is_root() || root.uid() == user_id.as_raw() {
        return Ok(());
    }
    Err(ConnectError::OtherUser {
        place: place.clone(),
        owner_id: root.uid(),
        user_id: user_id.as_raw(),
    })
}

fn memory_error(place: &Place, cause: &str) -> ConnectError {
    ConnectError::Memory {
        place: place.clone(),
        cause: cause.to_owned(),
    }
}
