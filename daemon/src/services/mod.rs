//! The iceoryx2 services of one daemon, and its ports.

use std::fmt::Debug;

use cdcr_shared_types::shm_space::{InsufficientSpace, NODE_FILES, PORT_BYTES, PORT_FILES};
use cdcr_shared_types::{
    Command, Header, Incident, Location, Measurement, ObstacleUpdate, QueueLengths, ReferenceChunk,
    Request, Response, Service, Telemetry, ipc,
};
use iceoryx2::port::publisher::{Publisher, PublisherCreateError};
use iceoryx2::port::server::Server;
use iceoryx2::port::subscriber::SubscriberCreateError;
use iceoryx2::prelude::{
    BackpressureStrategy, CallbackProgression, Node, NodeBuilder, PortFactory as _,
    SignalHandlingMode, ZeroCopySend,
};
use iceoryx2::service::messaging_pattern::MessagingPattern;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use iceoryx2::service::port_factory::server::ServerCreateError;

mod inlet;
mod shm_space;
pub mod stale;

use shm_space::ShmSpace;

pub use inlet::{Inlet, Received};
pub use shm_space::daemon_bytes;

/// Errors of shared memory, with their remedies.
#[derive(Debug, thiserror::Error)]
pub enum ServiceError {
    #[error(
        "cannot use shared memory with prefix {prefix} in {root}: {cause}\n\
         check that the folder belongs to you and has free space, and the limits of this process (ulimit -a)"
    )]
    Node {
        prefix: String,
        root: String,
        cause: String,
    },
    #[error(
        "cannot create the service {service}: {cause}\n\
         if a client of another version holds it open, end the clients \
         or use another prefix; or raise the limits of this process (ulimit -a)"
    )]
    Service { service: String, cause: String },
    #[error(
        "another process already writes to the service {service}\n\
         another daemon for this robot runs without a \
         visible lock file or socket: end it, or use another prefix"
    )]
    Taken { service: String },
    /// Shared memory has not enough space.
    #[error(
        "not enough space for {what}: {lack}\n\
         see cdcrd doctor for the memory that is needed"
    )]
    Full {
        what: String,
        /// Needed and free space.
        lack: InsufficientSpace,
    },
}

/// Checks that a daemon has enough space at `location`.
pub(crate) fn ask_for_space(location: &Location) -> Result<(), ServiceError> {
    let space = ShmSpace::new(location.root(), &location.file_prefix());
    // Files of a dead daemon are removed with it, and files of this process are already allocated.
    let needed_bytes = daemon_bytes().saturating_sub(space.taken_bytes());
    // Including the folders of nodes and services.
    space
        .ask(needed_bytes, NODE_FILES + 2)
        .map_err(|lack| ServiceError::Full {
            what: "the daemon".to_owned(),
            lack,
        })
}

/// An iceoryx2 node at `location`. Its creation removes the resources of dead processes.
pub fn node(location: &Location) -> Result<Node<ipc::Variant>, ServiceError> {
    let error = |cause: String| ServiceError::Node {
        prefix: location.prefix().to_owned(),
        root: location.root().display().to_string(),
        cause,
    };
    ask_for_space(location)?;
    let mut config = location
        .iceoryx2_config()
        .map_err(|cause| error(cause.to_string()))?;
    // The caretaker, and finally the instance, clean up after dead clients. Here the clean-up of a thousand
    // clients would take seconds, during which the other threads wait for the end.
    config.global.node.cleanup_dead_nodes_on_destruction = false;
    let builder = NodeBuilder::new()
        .config(&config)
        .signal_handling_mode(SignalHandlingMode::Disabled);
    builder
        .create::<ipc::Variant>()
        .map_err(|cause| error(ipc::words(&cause)))
}

/// Every port of the exchange thread.
#[derive(Debug)]
pub struct Ports {
    pub reference: Inlet<ReferenceChunk>,
    pub obstacles: Inlet<ObstacleUpdate>,
    pub measurement: Inlet<Measurement>,
    pub command: Publisher<ipc::Variant, Command, ()>,
    pub control: Server<ipc::Variant, Request, (), Response, ()>,
}

impl Ports {
    /// Creates the services through which clients and driver exchange messages with the controller of
    /// `robot`, and the daemon's ends.
    pub fn create(node: &Node<ipc::Variant>, robot: &str) -> Result<Self, ServiceError> {
        Ok(Self {
            reference: inlet(
                node,
                Service::Reference,
                robot,
                |message: &ReferenceChunk| &message.header,
            )?,
            obstacles: inlet(
                node,
                Service::Obstacles,
                robot,
                |message: &ObstacleUpdate| &message.header,
            )?,
            measurement: inlet(
                node,
                Service::Measurement,
                robot,
                |message: &Measurement| &message.header,
            )?,
            command: publisher(node, Service::Command, robot)?,
            control: control(node, robot)?,
        })
    }
}

fn failed(service: Service, robot: &str) -> impl Fn(&dyn Debug) -> ServiceError {
    let service = service.full_name(robot);
    move |cause| ServiceError::Service {
        service: service.clone(),
        cause: ipc::words(cause),
    }
}

/// Creates a port that needs `bytes` of free shared memory, and allocates them permanently.
fn with_space<P>(
    node: &Node<ipc::Variant>,
    service: Service,
    robot: &str,
    bytes: u64,
    create: impl FnOnce() -> Result<P, ServiceError>,
) -> Result<P, ServiceError> {
    let full = |lack: InsufficientSpace| {
        let what = format!("the service {}", service.full_name(robot));
        ServiceError::Full { what, lack }
    };
    let space = ShmSpace::from_node(node);
    // The service has two files, and the node has a tag of it.
    let ask = || space.ask(bytes + PORT_BYTES, PORT_FILES + 3).map_err(full);
    ask()?;
    let port = create().or_else(|refused| ask().and(Err(refused)))?;
    space.take().map_err(full)?;
    Ok(port)
}

fn topic<T: ZeroCopySend + Debug + 'static>(
    node: &Node<ipc::Variant>,
    service: Service,
    robot: &str,
) -> Result<PortFactory<ipc::Variant, T, ()>, ServiceError> {
    let failed = failed(service, robot);
    let queues = service.queues();
    let name = service.name(robot).map_err(|cause| failed(&cause))?;
    stale::create_or_replace(node, &name, MessagingPattern::PublishSubscribe, || {
        node.service_builder(&name)
            .publish_subscribe::<T>()
            .max_publishers(queues.publishers)
            .max_subscribers(queues.subscribers)
            .subscriber_max_buffer_size(queues.queue)
            .history_size(queues.history)
            .subscriber_max_borrowed_samples(QueueLengths::HELD)
            .max_nodes(service.nodes())
            .enable_safe_overflow(true)
            .open_or_create()
    })
    .map_err(|cause| failed(&cause))
}

/// A publisher that never waits for a reader, with its memory allocated.
pub fn publisher<T: ZeroCopySend + Debug + 'static>(
    node: &Node<ipc::Variant>,
    service: Service,
    robot: &str,
) -> Result<Publisher<ipc::Variant, T, ()>, ServiceError> {
    let bytes = shm_space::writer_bytes(service, size_of::<T>());
    let messages = service.queues().writer_messages();
    with_space(node, service, robot, bytes, || {
        let topic = topic::<T>(node, service, robot)?;
        let create = || {
            topic
                .publisher_builder()
                .backpressure_strategy(BackpressureStrategy::DiscardData)
                .override_sample_preallocation(move |_| messages)
                .create()
        };
        let is_full = |cause: &_| *cause == PublisherCreateError::ExceedsMaxSupportedPublishers;
        let ports = |ports: &mut Vec<_>| {
            topic.dynamic_config().list_publishers(|publisher| {
                ports.push((publisher.node_id, publisher.publisher_id.value()));
                CallbackProgression::Continue
            });
        };
        stale::create_in_free_slot(node, topic.service_hash(), ports, is_full, create).map_err(
            |cause| match cause {
                PublisherCreateError::ExceedsMaxSupportedPublishers => ServiceError::Taken {
                    service: service.full_name(robot),
                },
                cause => failed(service, robot)(&cause),
            },
        )
    })
}

pub fn telemetry(
    node: &Node<ipc::Variant>,
    robot: &str,
) -> Result<Publisher<ipc::Variant, Telemetry, ()>, ServiceError> {
    publisher(node, Service::Telemetry, robot)
}

/// Copies a message into shared memory and sends it. A reader with a full queue loses its oldest message. If
/// no memory can be loaned, the message is lost and readers see a gap in the sequence. True if the message
/// was sent.
pub(crate) fn send<T: ZeroCopySend + Debug + Copy + 'static>(
    publisher: &Publisher<ipc::Variant, T, ()>,
    message: &T,
) -> bool {
    publisher
        .loan_uninit()
        .is_ok_and(|sample| sample.write_payload(*message).send().is_ok())
}

/// The publisher of incidents; late joiners receive earlier ones, too.
pub fn incidents(
    node: &Node<ipc::Variant>,
    robot: &str,
) -> Result<Publisher<ipc::Variant, Incident, ()>, ServiceError> {
    publisher(node, Service::Incidents, robot)
}

fn inlet<T: ZeroCopySend + Debug + Copy + 'static>(
    node: &Node<ipc::Variant>,
    service: Service,
    robot: &str,
    header_of: fn(&T) -> &Header,
) -> Result<Inlet<T>, ServiceError> {
    let subscriber = with_space(node, service, robot, 0, || {
        let topic = topic::<T>(node, service, robot)?;
        let is_full = |cause: &_| *cause == SubscriberCreateError::ExceedsMaxSupportedSubscribers;
        let ports = |ports: &mut Vec<_>| {
            topic.dynamic_config().list_subscribers(|subscriber| {
                ports.push((subscriber.node_id, subscriber.subscriber_id.value()));
                CallbackProgression::Continue
            });
        };
        let create = || topic.subscriber_builder().create();
        stale::create_in_free_slot(node, topic.service_hash(), ports, is_full, create)
            .map_err(|cause| failed(service, robot)(&cause))
    })?;
    let queues = service.queues();
    let most = queues.publishers * QueueLengths::HELD;
    Ok(Inlet::new(subscriber, most, header_of))
}

fn control(
    node: &Node<ipc::Variant>,
    robot: &str,
) -> Result<Server<ipc::Variant, Request, (), Response, ()>, ServiceError> {
    let failed = failed(Service::Control, robot);
    let name = Service::Control
        .name(robot)
        .map_err(|cause| failed(&cause))?;
    let bytes = shm_space::control_bytes();
    with_space(node, Service::Control, robot, bytes, || {
        let service =
            stale::create_or_replace(node, &name, MessagingPattern::RequestResponse, || {
                node.service_builder(&name)
                    .request_response::<Request, Response>()
                    .max_servers(1)
                    .max_clients(Service::CONTROL_CLIENTS)
                    .max_active_requests_per_client(Service::CONTROL_REQUESTS)
                    .enable_safe_overflow_for_requests(true)
                    .enable_safe_overflow_for_responses(true)
                    .max_nodes(Service::Control.nodes())
                    .open_or_create()
            })
            .map_err(|cause| failed(&cause))?;
        let create = || {
            service
                .server_builder()
                .backpressure_strategy(BackpressureStrategy::DiscardData)
                .create()
        };
        let is_full = |cause: &_| *cause == ServerCreateError::ExceedsMaxSupportedServers;
        let ports = |ports: &mut Vec<_>| {
            service.dynamic_config().list_servers(|server| {
                ports.push((server.node_id, server.server_id.value()));
                CallbackProgression::Continue
            });
        };
        stale::create_in_free_slot(node, service.service_hash(), ports, is_full, create)
            .map_err(|cause| failed(&cause))
    })
}
