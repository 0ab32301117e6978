//! Talks to `cdcrd`, the real-time controller of cable-driven continuum robots.
//!
//! The daemon owns the robot and the 5 ms loop; everything else is a client in another process that
//! meets it in shared memory. This library is the typed way in for Rust programs. `cdcrctl` is a thin
//! user of it.
//!
//! # What there is
//!
//! * [`Connection`] opens the services of one daemon. A client never creates a service: without a
//!   living daemon [`Connection::open`] says which one it looked for and how to start it.
//! * [`Connection::request`] asks for something (track, hold, stop, reset, home) and waits for the
//!   answer. A refusal is an error that says why and what to do.
//! * [`Requester`] is the short way to that: it opens nothing else, so [`Requester::stop`] gets in where a
//!   connection does not, and falls back to a signal.
//! * [`Connection::feed`] streams a [`Trajectory`] ahead of time, so that a late client never reaches
//!   the loop. [`Spiral`], [`Line`] and [`Circle`] are the paper's; `Straight` is a way from rest to rest (feature `model`);
//!   [`FileTrajectory`] reads CSV (feature `csv`); your own type may implement the trait.
//! * [`Connection::telemetry`] is a [`Stream`] of one record per cycle, which counts what was lost;
//!   [`Connection::status`] is the newest snapshot; [`Connection::incidents`] are the last bad cycles,
//!   kept whole.
//! * [`model`] (feature `model`) makes the robot of `cdcr_controller` of what messages say;
//!   `PlantDriver` is a simulated robot behind a driver; [`replay`] computes recorded cycles again.
//! * [`channels`] (feature `channels`) is what recordings and live views hold: messages, and what viewers draw of them.
//! * [`Lease`], [`ReferenceFeed`], [`ObstacleSender`] and [`Driver`] are the single ports, for
//!   programs that do more than feed a curve.
//!
//! # Example
//!
//! Let the robot draw the paper's spiral and watch the error:
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
//! # Rules that hold everywhere
//!
//! SI units; times are nanoseconds of `CLOCK_MONOTONIC` ([`monotonic_ns`]), the clock of all messages
//! on one machine. Every message carries this connection's identity and a running number. Writers
//! never wait for readers: who does not keep up loses messages, and can see how many. Freshness is
//! judged from stamps, because shared memory does not tell that a process was killed. A daemon that is
//! started again finds its old clients, and they find it: see [`Connection`].
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
};
pub use events::{event_about, events, obstacles};
pub use feeder::{FeedEnd, FeedError, FeedEvent, FeedOptions, FeedProgress, FeedReport, Feeder};
pub use lease::Lease;
pub use link_error::{LinkError, Liveness};
pub use message::Message;
pub use obstacle_sender::ObstacleSender;
#[cfg(feature = "model")]
pub use plant_driver::{PlantDriver, PlantError};
pub use reference_feed::ReferenceFeed;
pub use remedy::remedy;
pub use request::RequestError;
pub use requester::{Requester, StopError};
pub use robot::{realtime_missing, section_lengths_m, straight_cable_lengths_m, text};
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
