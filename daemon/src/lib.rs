//! `cdcrd`: the real-time control daemon for cable-driven continuum robots.
//!
//! The threads that matter (see `ARCHITECTURE.md`):
//! - The **cycle** on a pinned core sleeps until each release of an absolute time grid, estimates, decides,
//!   solves, limits, and hands over a record.
//! - The **exchange**, on the same core at a lower priority, transfers messages between shared memory and the
//!   cycle.
//! - The **reporter** publishes telemetry outside the control path.
//! - The **supervisor**, on another core, does slow work and text output.
//!
//! | module | knows | must not know |
//! |---|---|---|
//! | [`config`] | TOML, ranges, place of the services | threads, messages |
//! | [`cycle`] | the order of the steps | iceoryx2, files, the system |
//! | [`core_budget`] | time of the solver in a period | source of the measured costs |
//! | [`obstacles`] | obstacles around the robot | their messages |
//! | [`handover`] | data exchanged between threads | its use by the threads |
//! | [`latch`] | state that outlives the process: a stop, a fault | - |
//! | [`kept_obstacles`] | obstacles that outlive the process | their messages |
//! | [`convert`] | messages and their meaning | senders, times of sending |
//! | [`services`] | iceoryx2: services, ports, their memory | meaning of the messages |
//! | [`link`] | interface of a cycle to its robot | messages |
//! | [`exchange`] | messages, clients | computation of a cycle |
//! | [`reporter`] | records, telemetry, causes of late cycles | a way to act on the cycle or the exchange |
//! | [`rt`] | clock, grid, privileges, causes of late threads | the robot, the configuration |
//! | [`service_manager`] | notifications to systemd | computation of a cycle |
//! | [`log`] | destination and rate of the log | content of the log |
//! | [`supervisor`] | statistics, log, status | the control path |
//! | `system` | files of the kernel, cores | what is good about them |
//! | `doctor` | the machine: what is good about its settings, privileges | output format |
//! | [`exit`] | causes of the process's end | events before it |
//! | [`bare`] | the loop without work: latencies of the machine | robot, shared memory |
//! | [`app`] | every concrete type | - |
//! | [`cli`] | the command line | a cycle |

#![allow(
    missing_docs,
    clippy::missing_errors_doc,
    reason = "the library of a program: a comment that repeats a name helps nobody"
)]

pub mod accounting;
pub mod app;
pub mod bare;
mod caretaker;
pub mod cli;
pub mod config;
pub mod convert;
pub mod core_budget;
pub mod cycle;
mod doctor;
pub mod exchange;
pub mod exit;
pub mod handover;
pub mod instance;
pub mod kept_obstacles;
pub mod latch;
pub mod link;
pub mod log;
mod mapped;
pub mod obstacles;
pub mod reload;
pub mod reporter;
pub mod rt;
pub mod service_manager;
pub mod services;
mod start;
mod status_thread;
pub mod supervisor;
mod system;
mod warnings;
