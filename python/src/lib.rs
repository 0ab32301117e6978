//! The Python module `cdcr._cdcr`: `cdcr_controller` and `cdcr_client` as numpy arrays and context managers.
//!
//! The public package is `python/cdcr`, described in `docs/python.md`; the documentation of each class is its
//! docstring. The type stubs `cdcr/_cdcr.pyi` are generated from the signatures here.
//!
//! Invariant: nothing here computes control. Messages become arrays, and back, by their declared fields (`wire`); code
//! here names fields only to send (driver, obstacles, points) and to see what a daemon made of it. Every wait releases
//! the interpreter's lock, and takes it every 50 ms to check for signals.

#![forbid(unsafe_code)]
#![allow(
    clippy::doc_markdown,
    reason = "these are docstrings, which Python shows as they are"
)]
#![allow(
    clippy::needless_pass_by_value,
    reason = "the interpreter hands arguments over by value"
)]

mod address;
mod arrays;
mod connection;
mod driver;
mod errors;
mod feed;
mod feed_stream;
mod mapping;
mod nmpc;
mod numbers;
mod obstacle;
mod recording;
mod robot;
mod running;
mod settings;
mod simulation;
mod trajectory;
mod wire;
mod words;
mod worker;

/// What the package `cdcr` exports.
#[pyo3::pymodule]
mod _cdcr {
    /// Version of the package, which needs a daemon of the same one.
    #[pymodule_export]
    #[allow(non_upper_case_globals, reason = "the name that Python has for it")]
    const __version__: &str = env!("CARGO_PKG_VERSION");
    /// After this many consecutive tips beyond the limit the sensor counts as wrong.
    #[pymodule_export]
    const FAR_LIMIT: u32 = cdcr_controller::estimator::FAR_LIMIT;
    /// A tip sensor that has measured nothing for this long is silent [ns].
    #[pymodule_export]
    const SILENT_NS: u64 = 1_000_000 * cdcr_shared_types::limits::TIP_SENSOR_SILENT_MS as u64;

    #[pymodule_export]
    use super::connection::Live;
    #[pymodule_export]
    use super::connection::{Connection, connect};
    #[pymodule_export]
    use super::driver::DriverPort;
    #[pymodule_export]
    use super::feed::{Feed, FeedReport};
    #[pymodule_export]
    use super::feed_stream::FeedStream;
    #[pymodule_export]
    use super::nmpc::{Nmpc, SolveReport};
    #[pymodule_export]
    use super::obstacle::Obstacle;
    #[pymodule_export]
    use super::recording::read;
    #[pymodule_export]
    use super::robot::Robot;
    #[pymodule_export]
    use super::settings::{default_settings, setting_texts, settings_from_toml};
    #[pymodule_export]
    use super::simulation::{Simulation, simulate};
    #[pymodule_export]
    use super::trajectory::Trajectory;
    #[pymodule_export]
    use super::wire::{dtype, enumerations, fields, messages};
    #[pymodule_export]
    use super::words::words;
}
