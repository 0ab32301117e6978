//! A daemon as a real process in a place of its own, and what it has to bear meanwhile.
//!
//! | module | is |
//! |---|---|
//! | [`subject`] | a daemon, its bare loop, cyclictest as processes; a reference that never ends |
//! | [`load`] | what else the machine does meanwhile |
//! | [`system`] | cores, threads, counts of the kernel |
//! | [`interrupt`] | signals end a measurement in order |
//!
//! Invariant: nothing here knows a benchmark or a format of results.

#![allow(
    missing_docs,
    clippy::missing_errors_doc,
    reason = "a library of this workspace: a comment that repeats a name helps nobody"
)]

pub mod interrupt;
pub mod load;
pub mod subject;
pub mod system;
