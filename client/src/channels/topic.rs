use cdcr_interchange::mcap::Channel;
use cdcr_interchange::of_layout;
use cdcr_shared_types::message::{MessageLayout, Struct};
use cdcr_shared_types::{
    Incident, ObstacleUpdate, ReferenceChunk, Service, ServiceNameError, Status, Telemetry,
};

use crate::Message;

/// Metadata key of a channel with the type and version of its messages on the wire.
pub const WIRE_TYPE: &str = "wire_type";
/// Metadata key of the ROS 2 type hash, as in rosbag2.
pub(super) const TYPE_HASH: &str = "topic_type_hash";

/// A service whose messages are recorded and shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Topic {
    /// [`Telemetry`].
    Telemetry,
    /// [`ReferenceChunk`].
    Reference,
    /// [`ObstacleUpdate`].
    Obstacles,
    /// [`Status`].
    Status,
    /// [`Incident`].
    Incidents,
}

impl Topic {
    /// All topics; the index of each is its number.
    pub const ALL: [Self; 5] = [
        Self::Telemetry,
        Self::Reference,
        Self::Obstacles,
        Self::Status,
        Self::Incidents,
    ];

    /// The service of this topic.
    pub fn service(self) -> Service {
        match self {
            Self::Telemetry => Telemetry::SERVICE,
            Self::Reference => ReferenceChunk::SERVICE,
            Self::Obstacles => ObstacleUpdate::SERVICE,
            Self::Status => Status::SERVICE,
            Self::Incidents => Incident::SERVICE,
        }
    }

    /// Layout of its messages.
    pub fn layout(self) -> &'static MessageLayout {
        match self {
            Self::Telemetry => Telemetry::LAYOUT,
            Self::Reference => ReferenceChunk::LAYOUT,
            Self::Obstacles => ObstacleUpdate::LAYOUT,
            Self::Status => Status::LAYOUT,
            Self::Incidents => Incident::LAYOUT,
        }
    }

    /// Channel of this topic for a robot.
    ///
    /// # Errors
    /// When the robot's name is invalid.
    pub fn channel(self, robot: &str) -> Result<Channel, ServiceNameError> {
        let layout = self.layout();
        let schema = of_layout(layout);
        let name = self.service().name(robot)?;
        Ok(Channel {
            topic: format!("/{name}"),
            schema: schema.name,
            text: schema.text,
            metadata: [
                (WIRE_TYPE.to_owned(), layout.type_name.to_owned()),
                (TYPE_HASH.to_owned(), schema.hash),
            ]
            .into(),
        })
    }

    /// Topic of a channel in a file, from the name of its schema.
    pub fn of_schema(schema: &str) -> Option<Self> {
        let name = schema.strip_prefix("cdcr_msgs/msg/")?;
        Self::ALL
            .into_iter()
            .find(|topic| topic.layout().name == name)
    }

    /// Noun for one message.
    pub fn noun(self) -> &'static str {
        match self {
            Self::Telemetry => "cycle",
            Self::Reference => "reference chunk",
            Self::Obstacles => "obstacle update",
            Self::Status => "snapshot",
            Self::Incidents => "incident",
        }
    }
}

/// A message type with a topic.
pub trait Recorded: Message + Struct {
    /// Topic of this type.
    const TOPIC: Topic;
}

macro_rules! recorded {
    ($($message:ident => $topic:ident,)+) => { $(
        impl Recorded for $message { const TOPIC: Topic = Topic::$topic; }
    )+ };
}
recorded! {
    Telemetry => Telemetry,
    ReferenceChunk => Reference,
    ObstacleUpdate => Obstacles,
    Status => Status,
    Incident => Incidents,
}
