//! The last word before the cables: which mode we are in, and what a command may be.
//!
//! Invariant: nothing here optimises, and nothing looks further than one period ahead. It sees the
//! state, the obstacles, what the solver would like, and what happened; it answers with a mode and a
//! command inside every limit that brings the body no nearer to an obstacle than allowed. No clock, no
//! message.

mod bucket;
mod clearance;
mod command;
mod following;
mod limiter;
mod mode;
mod plausibility;

pub use bucket::LeakyBucket;
pub use clearance::{Guarded, NEAR_MAX, guard, guard_ramp};
pub use command::{SafeCommand, Situation, safe_command};
pub use following::{FollowingError, FollowingRules, FollowingWatch};
pub use limiter::{
    Limited, LimitsHit, accelerate, homing_rates, limit, ramp_to_zero, shorten,
    shorten_to_acceleration,
};
pub use mode::{LeaseState, Mode, ModeMachine, Observation, Reason, Refusal, Request};
pub use plausibility::{MeasurementWatch, Plausibility, PlausibilityRules};
