//! MCAP, the container of recordings: <https://mcap.dev/spec>. A layer over the crate `mcap` that says where a file is whole, and reads
//! with one chunk in memory.
//!
//! Works on anything that reads or writes bytes.

mod reader;
mod writer;

use std::collections::BTreeMap;

pub use reader::{Item, Message, ReadError, Reader};
pub use writer::{Stamp, Writer, end};

/// What our messages are encoded as.
pub const MESSAGE_ENCODING: &str = "cdr";
/// What their schemas are encoded as.
pub const SCHEMA_ENCODING: &str = "ros2msg";

/// What a topic carries.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Channel {
    /// Its name.
    pub topic: String,
    /// Name of the schema, such as `cdcr_msgs/msg/Telemetry`.
    pub schema: String,
    /// Its definition.
    pub text: String,
    /// Values with names.
    pub metadata: BTreeMap<String, String>,
}

#[cfg(test)]
mod tests;
