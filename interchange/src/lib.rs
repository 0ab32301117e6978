//! Interchange formats: every message of the wire, and the standard messages for viewers, as little-endian
//! CDR with a `ros2msg` schema and a ROS 2 type hash (RIHS01).
//!
//! Schemas and encoding of the wire's messages come from their one declaration
//! (`cdcr_shared_types::message`), so a new field is in every recording. Arrays with a used length become
//! sequences, texts become strings, and reserved fields are omitted. Doubles keep their bits, so that a
//! recording can be recomputed.
//!
//! [`mcap`] is the container of recordings.
//!
//! Invariant: nothing here knows a service, a clock or a file.

pub mod cdr;
pub mod mcap;
#[cfg(any(test, feature = "sample"))]
pub mod sample;
mod schema;
pub mod standard;
mod wire;

pub use schema::{Schema, of_layout};
pub use wire::{decode, encode};
