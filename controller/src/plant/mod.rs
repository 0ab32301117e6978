//! Simulated robots for tests without hardware: one that equals its model, and one that does not.
//!
//! Invariant: of the modules of this crate only `closed_loop` uses this one. A simulated robot has the same interface
//! to the controller as a real one.

mod flaws;
mod kinematic;
mod misbehaving;
mod slack_cables;

pub use flaws::{FLAWS, FlawError, Flaws, RobotPreset, Sampling};
pub use kinematic::KinematicPlant;
pub use misbehaving::{MisbehavingRobot, MotorOrder, true_robot};
