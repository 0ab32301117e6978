//! `cdcr-bench`: what the controller reaches, measured offline and without real time.
//!
//! | module | measures |
//! |---|---|
//! | [`closed_loop`] | one robot tracking one curve: error and solve time of every cycle |
//! | [`solver`] | solve times on every path, and how they grow |
//! | [`paper`] | the paper's simulation 1 for every solver, beside the paper's figures |
//!
//! A time here says how long a solve takes on this machine, back to back, nothing else; what a daemon
//! adds is measured by `cdcrctl demo`.

pub mod closed_loop;
pub mod paper;
pub mod solver;
