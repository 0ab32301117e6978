//! Client library of `cdcrd`, the real-time controller of cable-driven continuum robots.
//!
//! The daemon owns the robot and the 5 ms loop. All other programs are clients in their own processes,
//! connected through shared memory. This library is the typed interface for Rust programs; `cdcrctl` is built
//! on it.
//!
//! # Contents
//!
//! * [`Connection`] opens the services of one daemon. A client never creates a service: without a running
//!   daemon, [`Connection::open`] names the daemon it looked for and the command that starts it.
//! * [`Connection::request`] sends a request (track, hold, stop, reset, home) and waits for the answer. A
//!   refusal is an error with a reason and a remedy. [`Connection::reset`] can accept the measured pose.
//! * [`Requester`] opens only the service for requests. So [`Requester::stop`] succeeds where a connection
//!   may not, and falls back to a signal.
//! * [`Connection::feed`] streams a [`Trajectory`] ahead of time, so that a late client does not affect the
//!   loop. [`Spiral`], [`Line`] and [`Circle`] are the paper's; `Straight` moves from rest to rest (feature
//!   `model`). [`FileTrajectory`] reads CSV (feature `csv`). Your own type may implement the trait.
//! * [`Connection::telemetry`] is a [`Stream`] with one record per cycle and a count of lost records.
//!   [`Connection::status`] is the newest status; [`Connection::incidents`] are the last incidents in full.
//! * [`model`] (feature `model`) converts messages to the types of `cdcr_controller`. `PlantDriver` is a
//!   simulated robot behind a driver; [`replay`] recomputes recorded cycles.
//! * [`channels`] (feature `channels`) defines the content of recordings and live views: messages, and
//!   drawings for viewers.
//! * [`Lease`], [`ReferenceFeed`], [`ObstacleSender`] and [`Driver`] are the single ports, for programs that
//!   need more than a feed.
//! # Example
//!
//! Draw the paper's spiral and record the largest tip error:
//!
//! ```no_run
//! use std::ops::ControlFlow;
//! use std::time::Duration;
//!
//! use cdcr_client::{Connection, FeedEvent, FeedOptions, Spiral};
//! use cdcr_shared_types::{DEFAULT_PREFIX, Location};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let location = Location::new(DEFAULT_PREFIX, &Location::default_root())?;
//! let connection = Connection::open(&location, "cdcr")?;
//!
//! let status = connection.status(Duration::from_secs(1))?;
//! let spiral = Spiral::for_sections(&cdcr_client::section_lengths_m(&status.robot));
//!
//! let options = FeedOptions { track: true, ..FeedOptions::default() };
//! let mut error_max_m = 0.0_f64;
//! connection.feed(&spiral, options)?.run(|event| {
//!     if let FeedEvent::Record(record) = event {
//!         error_max_m = error_max_m.max(record.position_error_m);
//!     }
//!     ControlFlow::Continue(())
//! })?;
//! println!("largest error: {:.2e} mm", 1e3 * error_max_m);
//! # Ok(())
//! # }
//! ```
//!
//! # General rules
//!
//! Units are SI. Times are nanoseconds of `CLOCK_MONOTONIC` ([`monotonic_ns`]), the clock of all messages on
//! one machine. Every message carries this connection's identity and a sequence number. Writers never wait
//! for readers: a slow reader loses messages and can count them. Freshness is determined from time stamps,
//! because shared memory does not report that a process was killed. A restarted daemon and its old clients
//! find each other again: see [`Connection`].
//!
//! Invariant: nothing here computes control or creates a service.

#![forbid(unsafe_code)]

#[cfg(feature = "channels")]
pub mod channels;
mod clock;
mod connect_error;
mod connection;
mod driver;
mod events;
mod feeder;
mod lease;
mod link_error;
mod message;
#[cfg(feature = "model")]
pub mod model;
mod obstacle_sender;
mod outlet;
#[cfg(feature = "model")]
mod plant_driver;
mod reference_feed;
mod remedy;
#[cfg(feature = "model")]
pub mod replay;
mod request;
mod requester;
mod robot;
mod sender;
mod services;
mod status_reader;
mod stream;
mod tip_sensor;
mod trajectory;

pub use cdcr_shared_types::counted;
pub use clock::monotonic_ns;
pub use connect_error::{ConnectError, Place};
pub use connection::Connection;
pub use driver::{
    CommandFollower, CommandRefusal, CommandedPosition, CommandedRates, Driver, DriverUpdate,
    cable_tolerances_m,
};
pub use events::{event_about, events, obstacles};
pub use feeder::{
    DURATION_MAX_S, FeedEnd, FeedError, FeedEvent, FeedOptions, FeedProgress, FeedReport, Feeder,
};
pub use lease::Lease;
pub use link_error::{LinkError, Liveness};
pub use message::Message;
pub use obstacle_sender::{ObstacleSender, check_place};
#[cfg(feature = "model")]
pub use plant_driver::{PlantDriver, PlantError};
pub use reference_feed::ReferenceFeed;
pub use remedy::{reason_remedy, remedy, request_remedy};
pub use request::{PoseDifference, RequestError, RequestName};
pub use requester::{Requester, StopError};
pub use robot::{realtime_missing, section_lengths_m, straight_cable_lengths_m, text};
pub use status_reader::STATUS_TIMEOUT;
pub use stream::{CommandStream, Stream, TelemetryStream};
pub use tip_sensor::TipSensor;
#[cfg(feature = "model")]
pub use trajectory::Straight;
pub use trajectory::{
    Changed, Circle, Figure, FigurePlane, FigureShape, Line, Orientation, PAPER_SECTION_M, Spiral,
    Trajectory,
};
#[cfg(feature = "csv")]
pub use trajectory::{FileTrajectory, TrajectoryFileError, TrajectoryFileProblem};
