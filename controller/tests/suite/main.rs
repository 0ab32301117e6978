//! Tests of the public interface, in one program: each test program costs a link.

#![allow(
    clippy::unwrap_used,
    reason = "in a test a panic is the report, in its helpers, too"
)]

mod calibration;
mod clearance;
mod closed_loop;
mod examples;
mod exciting_path;
mod jacobian;
mod kinematics_golden;
mod long_horizons;
mod nmpc;
mod oracle;
mod robustness;
mod safety;
mod scenes;
mod subnormal;
mod tip_sensor;

use cdcr_controller::nmpc::SolveInput;
use cdcr_controller::reference::{ReferenceSample, ReferenceState};
use cdcr_controller::robot::{BendRates, Configuration};
use nalgebra::Vector3;

/// One period after the last plan, without obstacles, with the tip where the bends say.
fn input<'a>(
    configuration: &'a Configuration,
    previous_rates: &'a BendRates,
    reference: &'a [ReferenceSample],
) -> SolveInput<'a> {
    SolveInput {
        configuration,
        previous_rates,
        reference,
        obstacles: &[],
        tip_offset_m: 0.0,
        elapsed_periods: 1,
        seed: 1,
    }
}

/// Where a reference wants the tip, in any orientation.
fn inside(position_m: Vector3<f64>) -> ReferenceSample {
    ReferenceSample {
        state: ReferenceState::Inside,
        position_m,
        ..ReferenceSample::default()
    }
}

/// A number of the environment.
fn number(name: &str, otherwise: u64) -> u64 {
    std::env::var(name).map_or(otherwise, |text| text.parse().unwrap())
}

/// How often something is repeated: a part of it, so that whoever changes a line need not wait, and the whole with `CDCR_WHOLE`.
fn repetitions(part: u32, whole: u32) -> u32 {
    match std::env::var_os("CDCR_WHOLE") {
        Some(_) => whole,
        None => part,
    }
}

/// The first `part` of the cases, the hardest of which come first, and all of them with `CDCR_WHOLE`.
fn cases<T>(part: usize, all: &[T]) -> &[T] {
    &all[..repetitions(part as u32, all.len() as u32) as usize]
}
