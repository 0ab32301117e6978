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

/// A message type with a topic.
pub trait Recorded: Message + Struct {
    /// Topic of this type.
    const TOPIC: Topic;
}

/// Declares the topics: each with the type of its messages and the noun for one.
macro_rules! topics {
    ($($topic:ident: $message:ident $noun:literal,)+) => {
        /// A service whose messages are recorded and shown.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum Topic {
            $(#[doc = concat!("[`", stringify!($message), "`].")] $topic,)+
        }

        impl Topic {
            /// All topics; the index of each is its number.
            pub const ALL: [Self; [$($noun,)+].len()] = [$(Self::$topic,)+];

            /// The service of this topic.
            pub fn service(self) -> Service {
                match self { $(Self::$topic => $message::SERVICE,)+ }
            }

            /// Layout of its messages.
            pub fn layout(self) -> &'static MessageLayout {
                match self { $(Self::$topic => $message::LAYOUT,)+ }
            }

            /// A message of zeros.
            pub fn zero(self) -> Box<dyn Struct> {
                match self { $(Self::$topic => Box::<$message>::default(),)+ }
            }

            /// Noun for one message.
            pub fn noun(self) -> &'static str {
                match self { $(Self::$topic => $noun,)+ }
            }
        }

        $(impl Recorded for $message { const TOPIC: Topic = Topic::$topic; })+
    };
}

topics! {
    Telemetry: Telemetry "cycle",
    Reference: ReferenceChunk "reference chunk",
    Obstacles: ObstacleUpdate "obstacle update",
    Status: Status "snapshot",
    Incidents: Incident "incident",
}

impl Topic {
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
}
