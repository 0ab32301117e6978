//! `cdcr-bench`: benchmarks of the controller and the daemon.
//!
//! | module | contents |
//! |---|---|
//! | [`deadline`] | deadline misses of the daemon under named loads, next to a bare loop |
//! | [`latency`] | time from a message to its effect |
//! | [`rate`] | the shortest period that holds |
//! | [`footprint`] | resources of a daemon: cores, memory, files, start-up time |
//! | [`quality`] | effect of solve time, swarm and horizon |
//! | [`paper`], [`experiment`], [`simulation`], [`mod@plots`] | the paper's simulations |
//! | [`solver`] | solve times on every SIMD path, and their growth |
//! | [`robustness`] | tracking errors of robots that differ from their model |
//! | [`budget`] | use of the budget of a solve, and delay of its end |
//! | [`scene`], [`closed_loop`] | a robot tracking a curve, every cycle of it, without a daemon |
//! | `watcher` | a client that receives every command of a daemon |
//! | [`progress`] | progress of a run |
//! | [`benchmark`] | interface of a benchmark: options, expected duration, run |
//! | [`dataset`], [`metric`], [`quantiles`], [`causes`] | result of a benchmark, in every format |
//! | [`report`], `chart`, [`hlog`] | results as documents and one page, plots, raw latencies |
//! | [`environment`], [`run_options`] | machine and options of a result |
//! | `study` | cases that are measured in turn, round by round |
//! | [`compare`] | changes between two runs beyond noise |
//!
//! `deadline`, `latency`, `rate` and `footprint` measure the program `cdcrd` as a process, with real time
//! where it is granted. All others run the controller in this process, without a daemon and without real
//! time. Their times only show the duration of back-to-back solves on this machine.

#![allow(
    missing_docs,
    clippy::missing_errors_doc,
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
pub mod quantiles;
pub mod rate;
pub mod report;
pub mod robustness;
pub mod run_options;
pub mod scene;
pub mod simulation;
pub mod solver;
mod study;
mod watcher;

use cdcr_testbed::{interrupt, load, subject, system};
