//! Geometry and kinematics of the robot: a chain of constant-curvature sections, bent by cables.
//!
//! Notation, used in every file here. A section of length `l` bends by θ towards the direction φ; its **bend vector** is
//! `b = (u, v) = θ (cos φ, sin φ)` (rad), and `w = u² + v² = θ²`. A robot of n sections is described by
//! `(u1, v1, u2, v2, …)`, 2n numbers, base first. Unlike (θ, φ) the bend vector is smooth through the straight section.
//! Lengths are in metres, angles in radians. The base frame has z along the straight robot. Formulas: §1 and §2 of
//! docs/model.md.
//!
//! | file | contents |
//! |---|---|
//! | `parameters` | parameters of a robot and their ranges |
//! | `configuration` | bend vectors and their rates |
//! | `section` | pose at the end of one arc, and its derivatives by the bend |
//! | `kinematics` | poses of the tip, of the section ends and of any point of the body |
//! | `jacobian` | derivative of the tip pose by the bends |
//! | `section_ends` | speed of the section ends from the rates |
//! | `orientation` | a rotation as three angles or as a quaternion |
//! | `cables` | cable lengths and speeds from bends, and bends from cable lengths |
//! | `obstacle` | obstacles and their motion |
//! | `tube` | exact distance of one section from a point and from a segment |
//! | `chord` | cheap lower bound on the distance of one section from a segment |
//! | `clearance` | clearance of the body from an obstacle, and the nearest point |
//! | `self_contact` | deepest overlap of two parts of the body |
//! | `body_motion` | derivative of a point of the body by the bends |
//! | `many` | tip positions of any number of configurations |
//! | `wide` | tip positions of W configurations side by side |
//! | `lanes` | vectors and frames of W configurations side by side |
//! | `body_wide` | clearance of W bodies side by side |
//!
//! A configuration or rates may have another section count than the robot. Missing sections are taken as straight and
//! at rest; surplus sections are ignored.
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
mod section_ends;
mod self_contact;
mod tube;
mod wide;

pub use body_motion::BodyMotion;
pub(crate) use cables::common_modes_m;
pub(crate) use clearance::Closest;
#[cfg(test)]
pub(crate) use clearance::EXACT;
pub use clearance::{Body, Nearest};
pub use configuration::{BendRates, Configuration};
pub use jacobian::Jacobian;
pub use kinematics::Pose;
pub use obstacle::{OBSTACLE_COMPONENT, OBSTACLE_RADIUS_M, Obstacle, ObstacleError, Shape};
pub use orientation::{ZyxAngles, quaternion_xyzw};
pub use parameters::{Robot, RobotError, RobotParameters, SectionParameters, ranges};
pub(crate) use section::rotate_wide;
pub use section::{Arc, Coefficients};
pub use self_contact::SelfContact;
pub(crate) use self_contact::{Pairs, norm};
pub(crate) use wide::{TipSeries, tip_position_of, tip_slopes_of};

/// Maximum number of sections: the longest published robot has five. The limit sizes every array of this crate.
pub const SECTIONS_MAX: usize = 6;

/// Two components (u, v) of the bend vector for each section.
pub const COORDINATES_MAX: usize = 2 * SECTIONS_MAX;

/// Three cables for each section.
pub const CABLES_MAX: usize = 3 * SECTIONS_MAX;
