use cdcr_interchange::mcap::Channel;
use cdcr_interchange::of_layout;
use cdcr_shared_types::message::{Layout, Struct};
use cdcr_shared_types::{
    Incident, ObstacleUpdate, ReferenceChunk, Service, ServiceNameError, Status, Telemetry,
};

use crate::Message;

/// Under which name a channel keeps the type and version that its messages had on the wire.
pub const WIRE_TYPE: &str = "wire_type";
/// The same of the ROS 2 type hash, as rosbag2 names it.
pub(super) const TYPE_HASH: &str = "topic_type_hash";

/// A service whose messages leave the machine.
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
    /// All of them; the place of each is its number.
    pub const ALL: [Self; 5] = [
        Self::Telemetry,
        Self::Reference,
        Self::Obstacles,
        Self::Status,
        Self::Incidents,
    ];

    /// The service whose messages these are.
    pub fn service(self) -> Service {
        match self {
            Self::Telemetry => Telemetry::SERVICE,
            Self::Reference => ReferenceChunk::SERVICE,
            Self::Obstacles => ObstacleUpdate::SERVICE,
            Self::Status => Status::SERVICE,
            Self::Incidents => Incident::SERVICE,
        }
    }

    /// A message of it, to be filled.
    pub fn layout(self) -> &'static Layout {
        match self {
            Self::Telemetry => Telemetry::LAYOUT,
            Self::Reference => ReferenceChunk::LAYOUT,
            Self::Obstacles => ObstacleUpdate::LAYOUT,
            Self::Status => Status::LAYOUT,
            Self::Incidents => Incident::LAYOUT,
        }
    }

    /// Its channel, of the daemon of this robot.
    ///
    /// # Errors
    /// For a name that no robot has.
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

    /// What a channel of a file holds, by the name of its schema.
    pub fn of_schema(schema: &str) -> Option<Self> {
        let name = schema.strip_prefix("cdcr_msgs/msg/")?;
        Self::ALL
            .into_iter()
            .find(|topic| topic.layout().name == name)
    }

    /// What one of its messages is called.
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

/// A message that is recorded.
pub trait Recorded: Message + Struct {
    /// Where it leaves.
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
