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
//! | [`table`], [`mod@csv`] | rows for people and for programs |
//! | [`mod@figures`], [`mod@page`], [`folder`] | the paper's figures, the page around them, the files |
//!
//! A time here says how long a solve takes on this machine, back to back, nothing else; what a daemon
//! adds is measured by `cdcrctl demo`.

pub mod budget;
mod chart;
pub mod closed_loop;
pub mod csv;
pub mod experiment;
pub mod figures;
pub mod folder;
pub mod growth;
pub mod interrupt;
pub mod metric;
pub mod page;
pub mod progress;
pub mod quantiles;
pub mod scene;
pub mod section;
pub mod simulation;
pub mod solver;
pub mod subject;
pub mod system;
pub mod table;
pub mod zone;
