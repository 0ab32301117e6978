//! Simulated robots, to run the controller without hardware: one that is its model, and one that is not.
//!
//! Invariant: of the modules of this crate only `closed_loop` uses this one; the controller cannot tell a plant from a robot.

mod flaws;
mod kinematic;
mod loose;
mod misbehaving;

pub use flaws::{FLAWS, FlawError, Flaws, Preset, Sampling};
pub use kinematic::KinematicPlant;
pub use misbehaving::{MisbehavingRobot, MotorOrder, true_robot};
