//! Tests of the public interface, in one program: each test program costs a link.

#![allow(
    clippy::unwrap_used,
    reason = "in a test a panic is the report, in its helpers, too"
)]

mod calibration;
mod clearance;
mod examples;
mod exciting_path;
mod jacobian;
mod kinematics_golden;
mod last_word;
mod nmpc;
mod oracle;
mod robustness;
mod scenes;
mod subnormal;
mod tip_sensor;
