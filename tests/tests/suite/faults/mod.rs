//! Fault injection: every fault of `docs/faults.md` occurs here in real processes. The tests check the
//! reaction and the time until it.
//!
//! Times come from the monotonic stamps in the records, because the machine may stall for longer than the
//! detection of a fault takes. Each test prints its measured times.

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
