//! Simulated robots, to run the controller without hardware: one that is its model, and one that is not.
//!
//! Invariant: no other module of this crate uses this one; the controller cannot tell a plant from a robot.

mod flaws;
mod kinematic;
mod misbehaving;

pub use flaws::{Flaws, Preset};
pub use kinematic::KinematicPlant;
pub use misbehaving::{MisbehavingRobot, MotorOrder};
