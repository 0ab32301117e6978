//! The last word before the cables: which mode we are in, and what a command may be.
//!
//! Invariant: nothing here optimises or predicts. It sees the state, what the solver would like, and
//! what happened; it answers with a mode and a command inside every limit. No clock, no message.

mod bucket;
mod limiter;
mod mode;

pub use bucket::LeakyBucket;
pub use limiter::{Limited, LimitsHit, homing_rates, limit, ramp_to_zero};
pub use mode::{LeaseState, Mode, ModeMachine, Observation, Reason, Refusal, Request};
