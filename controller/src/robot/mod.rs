//! What the robot is: a chain of constant-curvature sections, bent by cables.
//!
//! Notation, used in every file here. A section of length `l` bends by θ towards the direction φ; its **bend vector** is
//! `b = (u, v) = θ (cos φ, sin φ)` (rad), and `w = u² + v² = θ²`. A robot of n sections is described by
//! `(u1, v1, u2, v2, …)`, 2n numbers, base first. Unlike (θ, φ) the bend vector is smooth through the straight section.
//! Lengths are in metres, angles in radians. The base frame has z along the straight robot. Formulas: §1 and §2 of
//! docs/model.md.
//!
//! | file | question it answers |
//! |---|---|
//! | `parameters` | which numbers describe a robot, and which are allowed |
//! | `configuration` | how is it bent, how fast does that change |
//! | `section` | where does one arc end, and how does that depend on its bend |
//! | `kinematics` | where is the tip, a joint of two sections, any point of the body |
//! | `jacobian` | how does the tip move when a bend changes |
//! | `orientation` | which angles or quaternion is this rotation |
//! | `cables` | how long is each cable, how fast does it run, and back |
//! | `obstacle` | what must the body keep away from, and where is it later |
//! | `tube` | how far is one section from a point, from a segment |
//! | `chord` | how far is one section from a segment at least, for less work |
//! | `clearance` | how far is the body from an obstacle, and where |
//! | `body_motion` | how does a point of the body move when a bend changes |
//! | `many` | where are the tips of any number of configurations |
//! | `wide` | where are the tips of many configurations, side by side |
//! | `lanes` | vectors and frames of many configurations, side by side |
//! | `body_wide` | how far are many bodies from an obstacle, side by side |
//!
//! A configuration or rates belong to a robot by their section count. Of another count, sections that they do not have are
//! straight, and rest; those that the robot does not have are ignored.
//!
//! Invariant: nothing here knows a reference, a cost, a time or another process. Once a [`Robot`] exists, nothing here
//! allocates, fails or panics on finite input, except where an index is documented to.

mod body_motion;
mod body_wide;
mod cables;
mod chord;
mod clearance;
mod configuration;
mod jacobian;
mod kinematics;
mod lanes;
mod many;
mod obstacle;
mod orientation;
mod parameters;
mod section;
mod tube;
mod wide;

pub use body_motion::BodyMotion;
pub(crate) use clearance::Closest;
pub use clearance::{Body, Nearest};
pub use configuration::{BendRates, Configuration};
pub use jacobian::Jacobian;
pub use kinematics::Pose;
pub use obstacle::{OBSTACLE_COMPONENT, OBSTACLE_RADIUS_M, Obstacle, ObstacleError, Shape};
pub use orientation::{ZyxAngles, quaternion_xyzw};
pub use parameters::{Robot, RobotError, RobotParameters, SectionParameters, ranges};
pub(crate) use section::rotate_wide;
pub use section::{Arc, Coefficients};
pub(crate) use wide::Near;

/// Six sections: the longest robot published has five. Every array of this crate is sized by it.
pub const SECTIONS_MAX: usize = 6;

/// Two components (u, v) of the bend vector for each section.
pub const COORDINATES_MAX: usize = 2 * SECTIONS_MAX;

/// Three cables for each section.
pub const CABLES_MAX: usize = 3 * SECTIONS_MAX;
