//! Clearance against an independent oracle (the curve sampled by forward kinematics, each sample's distance to the obstacle
//! in closed form, then refined), against geometry that is known, and its derivatives against differences.

// `scene` is that of unit tests, too, where the crate has another name.
use cdcr_controller::robot;

mod arc;
mod body;
mod curve;
mod derivative;
mod numbers;
mod oracle;
mod reach;
mod scene;
