//! `cdcrd`: the real-time control daemon for cable-driven continuum robots.
//!
//! Four threads matter (see `ARCHITECTURE.md`): the **cycle** on a pinned core sleeps to each release of an
//! absolute time grid, estimates, decides, solves, limits, and hands a record on; the **exchange** on
//! the same core below it moves messages between shared memory and the cycle; the **reporter** publishes telemetry outside the
//! control path; the **supervisor** elsewhere does what is slow or textual.
//!
//! | module | knows | must not know |
//! |---|---|---|
//! | [`config`] | TOML, ranges | threads, messages |
//! | [`cycle`] | the order of the steps | iceoryx2, files, the system |
//! | [`core_budget`] | how long the solver may take | who measures the other parts |
//! | [`obstacles`] | what is known around the robot | who says so |
//! | [`handover`] | what threads hand to each other | what they do with it |
//! | [`latch`] | what outlives the process: a stop, a fault | who stops, and how |
//! | [`convert`] | messages and what they mean | who sends them, and when |
//! | [`services`] | iceoryx2: services, ports, room for them | what the messages mean |
//! | [`link`] | what the cycle needs of a robot | messages |
//! | [`exchange`] | messages, clients | how a cycle is computed |
//! | [`reporter`] | telemetry, why a cycle was late | references, obstacles, requests |
//! | [`rt`] | clock, grid, privileges, why a thread was late | the robot, the configuration |
//! | [`service_manager`] | what systemd is told | how a cycle is computed |
//! | [`log`] | where the log goes, how much of it | what is logged |
//! | [`supervisor`] | statistics, log, status | anything in the path of a cycle |
//! | `doctor` | the machine: files of the kernel, what it grants | how it is printed |
//! | [`exit`] | why the process ends | what happens before |
//! | [`bare`] | the loop without work: what the machine alone does to it | robot, messages, shared memory |
//! | [`app`] | every concrete type | nothing is hidden from it |
//! | [`cli`] | the command line | anything about a cycle |

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
pub mod latch;
pub mod link;
pub mod log;
pub mod obstacles;
pub mod reload;
pub mod reporter;
pub mod rt;
pub mod service_manager;
pub mod services;
mod start;
mod status_desk;
pub mod supervisor;
mod warnings;
