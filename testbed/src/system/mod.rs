//! Operating-system facilities for measurements: cores, priorities, clocks, counts.

pub mod cores;
pub mod counts;
pub mod machine;
pub mod thread;
