//! MCAP, the container of recordings: <https://mcap.dev/spec>. A layer over the crate `mcap` that reports how
//! many bytes of a file are complete, reads with one chunk in memory, and reads around damaged parts.
//!
//! It works with any reader or writer of bytes.

mod reader;
mod salvage;
mod writer;

use std::collections::BTreeMap;

pub use reader::{Item, Message, ReadError, Reader};
pub use salvage::{Loss, Whole};
pub use writer::{Stamp, Writer, end};

/// Encoding of messages.
pub const MESSAGE_ENCODING: &str = "cdr";
/// Encoding of schemas.
pub const SCHEMA_ENCODING: &str = "ros2msg";

/// Description of a topic.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Channel {
    /// Name of the topic.
    pub topic: String,
    /// Name of the schema, such as `cdcr_msgs/msg/Telemetry`.
    pub schema: String,
    /// Text of the schema.
    pub text: String,
    /// Named values.
    pub metadata: BTreeMap<String, String>,
}

#[cfg(test)]
mod tests;
