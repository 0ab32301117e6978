//! The wire contract of `cdcrd`: every message, service name and limit that processes share.
//!
//! All communication uses [iceoryx2](https://docs.rs/iceoryx2) shared memory. The daemon creates the services of
//! [`Service::ALL`] under `cdcr/<robot>/` and so fixes their types and queue lengths; clients and drivers open them.
//!
//! | service | pattern | direction | payload |
//! |---|---|---|---|
//! | `reference` | publish-subscribe | client → daemon | [`ReferenceChunk`] |
//! | `obstacles` | publish-subscribe | client → daemon | [`ObstacleUpdate`] |
//! | `measurement` | publish-subscribe | driver → daemon | [`Measurement`] |
//! | `command` | publish-subscribe | daemon → driver | [`Command`] |
//! | `telemetry` | publish-subscribe | daemon → any | [`Telemetry`] |
//! | `status` | publish-subscribe, history 1 | daemon → any | [`Status`] |
//! | `incidents` | publish-subscribe, history 64 | daemon → any | [`Incident`] |
//! | `control` | request-response | client ↔ daemon | [`Request`] → [`Response`] |
//!
//! # Rules for every type here
//!
//! * Each is declared once, by the macro of [`message`]: struct, zero value, and the list of its fields with kind,
//!   unit, codes and used length ([`LAYOUTS`]). JSON, tables and tests walk that list.
//! * `#[repr(C)]`, fixed size, without padding. Gaps are explicit `reserved` fields of zeros: the daemon rejects a
//!   message with another value, except a stop. `tests/layout.rs` pins sizes and offsets.
//! * An explicit iceoryx2 type name `cdcr.<Type>.v<n>`. iceoryx2 compares only name, size and alignment. **A change of
//!   meaning or layout therefore changes the version in the name**: an old peer is rejected when it opens the service,
//!   never misread.
//! * SI units; the unit ends the field's name. Times are nanoseconds of `CLOCK_MONOTONIC`.
//! * Enumerations travel as `u32`, because another process may write any bits. [`codes`] holds their values and the
//!   checked conversion.
//! * Every message starts with a [`Header`]: sender, sequence number and time. iceoryx2 does not report a killed peer,
//!   so freshness is evaluated from these stamps.
//!
//! Messages have no logic: nothing here validates, computes or decides; `daemon/src/convert/` validates at the edge.
//! With the feature `model`, the module `model` converts them to their counterparts in `cdcr_controller`.
//! The other modules hold what daemon and client share: folders, files, locks, permissions, shared-memory space, the
//! reader of `/proc/stat`, the output of `cdcrd bare`, and the plural of counted nouns; with the feature `duration` times on
//! command lines, with `histogram` the percentiles of a histogram.

mod access;
mod bare;
#[macro_use]
pub mod codes;
mod command;
mod control;
mod counted;
pub mod declared;
#[cfg(feature = "duration")]
mod duration;
mod header;
mod incident;
pub mod ipc;
pub mod limits;
mod measurement;
pub mod message;
#[cfg(feature = "model")]
pub mod model;
mod obstacles;
mod presence;
pub mod proc_stat;
mod reference;
mod services;
mod settings;
pub mod shm_space;
mod status;
mod telemetry;

pub use bare::{BARE_COLUMNS, BareSummary};
pub use command::Command;
pub use control::{Request, Response};
pub use counted::counted;
#[cfg(feature = "duration")]
pub use duration::{duration_in, parse_duration};
pub use header::Header;
pub use incident::Incident;
pub use measurement::Measurement;
pub use obstacles::{Obstacle, ObstacleUpdate};
pub use presence::{NameHolder, Presence};
pub use reference::{ReferenceChunk, ReferencePoint};
pub use services::{
    DEFAULT_PREFIX, Location, LocationError, QueueLengths, Service, ServiceNameError, memory_files,
};
pub use settings::SolverSettings;
pub use status::{LatencySummary, RobotDescription, SectionDescription, Statistics, Status};
pub use telemetry::{
    Approach, InputEvent, ReferenceSample, SchedulingReport, SolverReport, Telemetry,
};

use message::MessageLayout;

/// Every message and every part of one; parts precede the messages that hold them.
pub const LAYOUTS: [&MessageLayout; 22] = [
    Header::LAYOUT,
    ReferencePoint::LAYOUT,
    ReferenceChunk::LAYOUT,
    Obstacle::LAYOUT,
    ObstacleUpdate::LAYOUT,
    Measurement::LAYOUT,
    Command::LAYOUT,
    SolverSettings::LAYOUT,
    Request::LAYOUT,
    Response::LAYOUT,
    SectionDescription::LAYOUT,
    RobotDescription::LAYOUT,
    LatencySummary::LAYOUT,
    Statistics::LAYOUT,
    Status::LAYOUT,
    InputEvent::LAYOUT,
    ReferenceSample::LAYOUT,
    Approach::LAYOUT,
    SolverReport::LAYOUT,
    SchedulingReport::LAYOUT,
    Telemetry::LAYOUT,
    Incident::LAYOUT,
];
