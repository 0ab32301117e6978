//! `cdcr-bench`: what controller and daemon reach, measured.
//!
//! | module | is |
//! |---|---|
//! | [`deadline`] | does the daemon keep its deadlines, under which load, beside a bare loop |
//! | [`latency`] | how long from something that is sent to its effect |
//! | [`rate`] | the shortest period that holds |
//! | [`footprint`] | what a daemon takes: cores, memory, files, time to start |
//! | [`quality`] | what the time of a solve, the swarm and the horizon buy |
//! | [`paper`], [`experiment`], [`simulation`], [`mod@plots`] | the paper's simulations |
//! | [`solver`] | solve times on every path, and how they grow |
//! | [`robustness`] | how far robots that are not their model are from the reference |
//! | [`budget`] | what a solve does with its budget, and how late it ends |
//! | [`scene`], [`closed_loop`] | a robot tracking a curve, every cycle of it, without a daemon |
//! | `watcher` | a client that sees every command of a daemon come |
//! | [`progress`] | how far a run is |
//! | [`benchmark`] | what every benchmark is: options, about how long it takes, a run |
//! | [`dataset`], [`metric`], [`quantiles`], [`causes`] | what every benchmark hands over, and every format of it |
//! | [`report`], `chart`, [`hlog`] | results as documents and one page, plots, raw latencies |
//! | [`environment`], [`run_options`] | the machine that a result comes from, and what was asked for |
//! | `study` | cases that are measured in turns, round by round |
//! | [`compare`] | what changed between two runs beyond noise |
//!
//! `deadline`, `latency`, `rate` and `footprint` measure the program `cdcrd` as a process, with real time where it is
//! granted. All others run the controller in this process, without a daemon and without real time: a time there
//! says how long a solve takes on this machine, back to back, nothing else.

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
