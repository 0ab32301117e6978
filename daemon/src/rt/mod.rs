//! System services for a real-time loop: clock, grid, attribution of lateness, privileges.
//!
//! Invariant: nothing here knows the robot, the configuration, or other modules of this crate. Of the
//! messages it knows late causes, and the bits of missing real-time privileges. `sys` contains
//! all `unsafe` code of the daemon.

pub mod attribution;
pub mod clock;
pub(crate) mod latency;
pub mod privileges;
pub mod record_ring;
pub mod schedule;
pub mod scheduler;
pub mod suspend;
pub mod sys;
