//! What the system offers to a measurement: cores, priorities, clocks, counts.

pub mod cores;
pub mod counts;
pub mod thread;
