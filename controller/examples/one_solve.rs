//! Repeats one solve, as in each period of a daemon, and measures its time.
//!
//! ```sh
//! cargo run --release -p cdcr-controller --example one_solve
//! ```

use std::error::Error;
use std::time::Instant;

use cdcr_controller::nmpc::{Nmpc, NmpcSettings, SolveInput, SolveStatus};
use cdcr_controller::optimizer::Budget;
use cdcr_controller::reference::{ReferenceSample, ReferenceState};
use cdcr_controller::robot::{BendRates, Configuration, Robot, RobotParameters};
use nalgebra::Vector3;

const SOLVES: usize = 2000;

/// Prints the rates of the first solve and the median time.
pub fn main() -> Result<(), Box<dyn Error>> {
    let robot = Robot::new(&RobotParameters::paper(3))?;
    let mut nmpc = Nmpc::new(robot.clone(), 0.005, NmpcSettings::default())?;
    let here = Configuration::from_slice(&[0.3; 6]).ok_or("six numbers are a shape")?;
    let tip_m = robot.tip_position(&here);
    // 20 mm/s sideways.
    let window = [1e-4, 2e-4].map(|aside_m| ReferenceSample {
        state: ReferenceState::Inside,
        position_m: tip_m + Vector3::new(0.0, aside_m, 0.0),
        ..ReferenceSample::default()
    });
    let input = SolveInput {
        configuration: &here,
        previous_rates: &BendRates::zero(3),
        reference: &window,
        obstacles: &[],
        tip_offset_m: 0.0,
        elapsed_periods: 1,
        seed: 1,
    };
    let (rates, report) = nmpc.solve(&input, &mut Budget::unlimited());
    let mut times_us = Vec::with_capacity(SOLVES);
    for _ in 0..SOLVES {
        let begin = Instant::now();
        nmpc.solve(&input, &mut Budget::unlimited());
        times_us.push(1e6 * begin.elapsed().as_secs_f64());
    }
    times_us.sort_by(f64::total_cmp);
    println!("rates: {:?} rad/s", rates.as_slice());
    println!("median of {SOLVES} solves: {:.2} µs", times_us[SOLVES / 2]);
    match report.status {
        SolveStatus::Converged => Ok(()),
        status => Err(format!("the solve ended as {status:?}").into()),
    }
}
