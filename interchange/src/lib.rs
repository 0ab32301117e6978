//! What leaves the machine: every message of the wire, and the standard messages that viewers draw, as little-endian CDR with a
//! `ros2msg` schema and a ROS 2 type hash (RIHS01).
//!
//! Schemas and bytes of the wire's messages come from their one declaration (`cdcr_shared_types::message`): a field that is added
//! there is in every recording. Used lengths become sequences, texts become strings, reserved fields are left out; doubles keep
//! their bits, so that a recording can be computed again.
//!
//! [`mcap`] is the container of recordings.
//!
//! Knows no service, no clock and no file.

pub mod cdr;
pub mod mcap;
#[cfg(any(test, feature = "sample"))]
pub mod sample;
mod schema;
pub mod standard;
mod wire;

pub use schema::{Schema, of_layout};
pub use wire::{decode, encode};
