//! The safety checks of every command: the mode machine, limits, clearance guard and supervision of
//! measurements.
//!
//! Invariant: nothing here optimises, predicts beyond the motion of one command and its ramp to rest, or
//! knows a clock or a message. Inputs are the state, the obstacles, the desired rates and the events of a
//! cycle; outputs are a mode and a command inside every limit that moves the body no closer to an obstacle,
//! and no deeper into itself, than allowed.

mod bend_limit;
mod bucket;
mod clearance;
mod command;
mod common_mode;
mod following;
mod lag;
mod limits;
mod margin_share;
mod mode;
mod plausibility;
mod play;
mod projection;
mod ramp;
mod self_contact;
mod situation;
mod stopping;

pub use bend_limit::{BEND_TOLERANCE_RAD, BendLimitWatch, FarthestBend};
pub use bucket::LeakyBucket;
pub use command::safe_command;
pub use common_mode::CommonModeWatch;
pub use following::{FollowingCause, FollowingError, FollowingRules, FollowingWatch};
pub use limits::{Limited, Limits, LimitsHit, limit, shorten};
pub use margin_share::MarginShare;
pub use mode::{LeaseState, Mode, ModeMachine, Observation, Reason, Refusal, Request};
pub use plausibility::{MeasurementWatch, Plausibility, PlausibilityRules};
pub use ramp::{homing_rates, ramp_to_zero};
pub use situation::{Lag, SafeCommand, Situation};
