//! Tests of the whole system in one program, each with its own prefix. Tests that watch the allocator of
//! their process are in `guards`.

#![allow(
    clippy::unwrap_used,
    reason = "in a test a panic is the report, in its helpers, too"
)]

mod chaos;
mod faults;
mod fuzz;
mod own_mounts;
mod paragraphs;
mod rest;
mod soak;
mod stop;
mod system;
mod tidy;
