//! Fault injection: every fault of `docs/faults.md` happens here to real processes, and what comes of it is
//! asserted together with how long it took.
//!
//! Times come from the monotonic stamps in the records, because the machine that runs the tests may stall for
//! longer than a fault takes to be detected. Each test prints what it measured.

mod drivers;
mod following;
mod held_up;
mod history;
mod measurement;
mod memory;
mod obstacles;
mod processes;
pub(crate) mod reference;
pub(crate) mod robot;
mod table;
pub(crate) mod threads;
mod timing;
pub(crate) mod trail;
