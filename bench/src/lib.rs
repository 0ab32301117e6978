//! `cdcr-bench`: benchmarks of the controller and the daemon. ARCHITECTURE.md names every module.
//!
//! `deadline`, `latency`, `rate` and `footprint` measure the program `cdcrd` as a process, with real time
//! where it is granted. All others run the controller in this process, without a daemon and without real
//! time. Their times only show the duration of back-to-back solves on this machine.

#![allow(
    missing_docs,
    clippy::missing_errors_doc,
    clippy::missing_panics_doc,
    reason = "the library of a program: nobody reads its rustdoc, and a comment that repeats a name helps nobody"
)]

pub mod benchmark;
pub mod budget;
pub mod causes;
mod chart;
pub mod closed_loop;
pub mod compare;
pub mod dataset;
pub mod deadline;
pub mod environment;
pub mod experiment;
pub mod footprint;
pub mod hlog;
pub mod latency;
pub mod metric;
mod named;
mod numbers;
pub mod paper;
pub mod plots;
pub mod progress;
pub mod quality;
pub mod rate;
pub mod report;
pub mod robustness;
pub mod run_options;
pub mod solver;
mod study;

use cdcr_testbed::{interrupt, load, quantiles, subject, system};
