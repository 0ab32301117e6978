//! Content of recordings and live views, as channels with names and schemas: the messages of the services,
//! and standard messages for viewers, made from telemetry records.
//!
//! Invariant: nothing here knows a file or a socket; recordings and live views write the same content.

mod drawn;
mod happening;
mod scene;
mod topic;

pub use drawn::{Drawing, Drawings, Drawn};
pub use happening::{Happening, Level, happenings};
pub use topic::{Recorded, Topic, WIRE_TYPE};
