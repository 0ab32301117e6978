//! The benchmarks that need no daemon, as results beside the others.

pub mod budget;
pub mod paper;
pub mod solver;
