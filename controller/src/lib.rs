//! Real-time control of cable-driven continuum robots.
pub mod estimator;
pub mod nmpc;
pub mod optimizer;
pub mod plant;
pub mod reference;
pub mod robot;
pub mod safety;
