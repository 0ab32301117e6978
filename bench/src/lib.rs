//! `cdcr-bench`: what the controller reaches, measured offline and without real time.
//!
//! | module | is |
//! |---|---|
//! | [`scene`] | robot, start, curve and obstacles of a simulation |
//! | [`closed_loop`] | one robot tracking one curve: every cycle of it |
//! | [`experiment`] | which of the paper's simulations, with which solver and settings |
//! | [`zone`] | which samples of the circle count as tracking |
//! | [`simulation`] | an experiment run with several seeds, and the row that sums it up |
//! | [`solver`], [`growth`] | solve times on every path, and how they grow |
//! | [`budget`] | what a solve does with its budget, and how late it ends |
//! | [`quality`] | what the time of a solve, the swarm and the horizon buy |
//! | [`table`], [`mod@csv`] | rows for people and for programs |
//! | [`mod@figures`], [`mod@page`], [`folder`] | the paper's figures, pages, the files of `paper` |
//! | [`environment`], [`report`], [`hlog`] | the machine, results as documents, raw latencies |
//! | [`compare`] | what changed between two runs beyond noise |
//!
//! A time here says how long a solve takes on this machine, back to back, nothing else; what a daemon
//! adds is measured by `cdcrctl demo`.

pub mod budget;
mod chart;
pub mod closed_loop;
pub mod compare;
pub mod csv;
pub mod deadline;
pub mod environment;
pub mod experiment;
pub mod figures;
pub mod folder;
pub mod footprint;
pub mod growth;
pub mod hlog;
pub mod interrupt;
pub mod latency;
pub mod load;
pub mod metric;
pub mod page;
pub mod progress;
pub mod quality;
pub mod quantiles;
pub mod rate;
pub mod report;
pub mod scene;
pub mod section;
pub mod simulation;
pub mod solver;
pub mod subject;
pub mod system;
pub mod table;
pub mod zone;
