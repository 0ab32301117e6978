//! What the operating system owes a real-time loop: clock, grid, accounting, privileges.
//!
//! It must not know: the robot, the configuration, anything else of this crate. Of the messages it knows two: percentiles, and
//! the bits of what real time lacks. `sys` is the only file of the
//! workspace with `unsafe` in it.

pub mod attribution;
pub mod clock;
pub(crate) mod latency;
pub mod privileges;
pub mod record_ring;
pub mod schedule;
pub mod scheduler;
pub mod suspend;
pub mod sys;
