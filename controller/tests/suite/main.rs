//! Tests of the public interface in one program, because each test program has to be linked.

#![allow(
    clippy::unwrap_used,
    reason = "in a test a panic is the report, in its helpers, too"
)]

mod calibration;
mod clearance;
mod closed_loop;
mod examples;
mod exciting_path;
mod hard_scenes;
mod jacobian;
mod kinematics_golden;
mod lag;
mod long_horizons;
mod nmpc;
mod oracle;
mod posture;
mod robustness;
mod safety;
mod scenes;
mod subnormal;
mod tip_sensor;
mod tip_speed;

use cdcr_controller::nmpc::SolveInput;
use cdcr_controller::reference::{ReferenceSample, ReferenceState};
use cdcr_controller::robot::{BendRates, Configuration};
use nalgebra::Vector3;

/// Input one period after the last plan, without obstacles and without tip offset.
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

/// A reference position for the tip, with free orientation.
fn inside(position_m: Vector3<f64>) -> ReferenceSample {
    ReferenceSample {
        state: ReferenceState::Inside,
        position_m,
        ..ReferenceSample::default()
    }
}

/// A number from an environment variable.
fn number(name: &str, otherwise: u64) -> u64 {
    std::env::var(name).map_or(otherwise, |text| text.parse().unwrap())
}

/// Number of repetitions: `part` by default, to keep tests short, and `whole` with `CDCR_WHOLE`.
fn repetitions(part: u32, whole: u32) -> u32 {
    match std::env::var_os("CDCR_WHOLE") {
        Some(_) => whole,
        None => part,
    }
}

/// The first `part` of the cases, hardest first; all of them with `CDCR_WHOLE`.
fn cases<T>(part: usize, all: &[T]) -> &[T] {
    &all[..repetitions(part as u32, all.len() as u32) as usize]
}
