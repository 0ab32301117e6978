//! What leaves the machine, as channels with names and schemas: the messages of the services, and standard messages that viewers
//! draw, made of telemetry records.
//!
//! Knows no file and no socket: recordings and live views write the same.

mod drawn;
mod happening;
mod scene;
mod topic;

pub use drawn::{Drawing, Drawings, Drawn};
pub use happening::{Happening, Level, happenings};
pub use topic::{Recorded, Topic, WIRE_TYPE};
