//! Simulated robots, to run the controller without hardware.
//!
//! Invariant: no other module of this crate uses this one; the controller cannot tell a plant from a robot.

mod kinematic;

pub use kinematic::KinematicPlant;
