//! A daemon as a real process in a private place, and the load on the machine during a measurement.
//!
//! | module | contents |
//! |---|---|
//! | [`subject`] | daemon, bare loop and cyclictest as processes, iceoryx2 alone; clients and a service manager beside them |
//! | [`load`] | load on the machine and on the daemon |
//! | [`system`] | cores, threads, counts of the kernel, the description of the machine |
//! | [`quantiles`] | percentiles of a latency |
//! | [`interrupt`] | signals end a measurement in order |
//!
//! Invariant: nothing here knows a benchmark.

#![allow(
    missing_docs,
    clippy::missing_errors_doc,
    clippy::missing_panics_doc,
    reason = "a library of this workspace: a comment that repeats a name helps nobody"
)]

pub mod interrupt;
pub mod load;
pub mod quantiles;
pub mod subject;
pub mod system;
