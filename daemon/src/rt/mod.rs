//! What the operating system owes a real-time loop: clock, grid, hand-over, accounting, privileges.
//!
//! Invariant: nothing here knows the robot or a message, but for `handoff`, which carries both and looks into neither. `sys` is the only file of the workspace with
//! `unsafe` in it.

pub mod accounting;
pub mod attribution;
pub mod clock;
pub mod handoff;
pub mod privileges;
pub mod record_ring;
pub mod schedule;
pub mod scheduler;
pub mod suspend;
pub mod sys;
