//! Tests of the public interface, in one program: each test program costs a link.

#![allow(
    clippy::unwrap_used,
    reason = "in a test a panic is the report, in its helpers, too"
)]

mod all;
mod budget;
mod compare;
mod deadline;
mod footprint;
mod latency;
mod paper;
mod quality;
mod rate;
mod refused;
mod results;
mod robustness;
