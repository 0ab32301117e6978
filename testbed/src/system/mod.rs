//! What the system offers to a measurement: cores, priorities, clocks, counts, other programs.

pub mod cores;
pub mod counts;
pub mod process;
pub mod thread;
