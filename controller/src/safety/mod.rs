//! The safety checks before the cables: which mode we are in, and what a command may be.
//!
//! Invariant: nothing here optimises, and nothing looks further than the robot moves by one command and the ramp to rest
//! after it. It sees the state, the obstacles, what the solver would like, and what happened; it answers with a mode
//! and a command inside every limit that brings the body no nearer to an obstacle than allowed. No clock, no message.

mod bucket;
mod clearance;
mod command;
mod common_mode;
mod following;
mod limits;
mod mode;
mod plausibility;
mod play;
mod projection;
mod ramp;

pub use bucket::LeakyBucket;
pub use command::{SafeCommand, Situation, safe_command};
pub use common_mode::CommonModeWatch;
pub use following::{FollowingError, FollowingRules, FollowingWatch};
pub use limits::{Limited, Limits, LimitsHit, limit, shorten};
pub use mode::{LeaseState, Mode, ModeMachine, Observation, Reason, Refusal, Request};
pub use plausibility::{MeasurementWatch, Plausibility, PlausibilityRules};
pub use ramp::{homing_rates, ramp_to_zero};
