//! Clearance against an independent oracle and against known geometry, and its derivatives against finite
//! differences. The oracle samples the curve by forward kinematics, computes each sample's distance in closed
//! form, and refines the minima.

// `scene` is shared with unit tests, where the crate has another name.
use cdcr_controller::robot;

mod arc;
mod body;
mod curve;
mod derivative;
mod numbers;
mod oracle;
mod reach;
mod scene;
