//! One robot tracking one curve, cycle by cycle, as fast as it computes.

use std::time::Instant;

use anyhow::{Context, Result};
use cdcr_client::Trajectory;
use cdcr_controller::nmpc::{Nmpc, NmpcSettings, SolveInput};
use cdcr_controller::optimizer::{Budget, cycle_seed};
use cdcr_controller::reference::{ReferenceSample, ReferenceState};
use cdcr_controller::robot::{BendRates, Configuration, Robot};
use cdcr_controller::safety::limit;
use hdrhistogram::Histogram;
use nalgebra::Vector3;

/// What is simulated.
pub struct Scene<'a> {
    /// The robot.
    pub robot: &'a Robot,
    /// Its configuration at the start.
    pub start: Configuration,
    /// The curve; its time 0 is the first release.
    pub curve: &'a dyn Trajectory,
    /// Cycles.
    pub cycles: u64,
    /// Period \[s\].
    pub period_s: f64,
}

/// What came out.
#[derive(Debug, Clone)]
pub struct Run {
    /// Mean distance of the tip from the curve, at the end of each cycle \[mm\].
    pub mean_error_mm: f64,
    /// The largest \[mm\].
    pub max_error_mm: f64,
    /// Solve times \[ns\].
    pub solve_ns: Histogram<u64>,
}

/// Runs the scene with one controller on the ideal kinematic robot. The controller sees the exact
/// curve at each step of its horizon.
///
/// # Errors
/// When the settings are out of range.
pub fn run(scene: &Scene, settings: NmpcSettings) -> Result<Run> {
    let mut nmpc = Nmpc::new(scene.robot.clone(), scene.period_s, settings)?;
    let mut solve_ns = histogram()?;
    let mut configuration = scene.start;
    let mut rates = BendRates::zero(scene.robot.section_count());
    let (mut sum_m, mut max_m) = (0.0, 0.0_f64);
    for cycle in 0..scene.cycles {
        let reference = window(scene, cycle, settings.horizon_steps);
        let input = SolveInput {
            configuration: &configuration,
            previous_rates: &rates,
            reference: &reference,
            elapsed_periods: 1,
            seed: cycle_seed(settings.seed, cycle),
        };
        let begin = Instant::now();
        let (wish, _) = nmpc.solve(&input, &mut Budget::unlimited());
        solve_ns.saturating_record(begin.elapsed().as_nanos() as u64);
        rates = limit(scene.robot, &configuration, &wish, scene.period_s).rates;
        configuration = configuration.advanced(&rates, scene.period_s);
        let tip = scene.robot.tip_position(configuration.as_slice());
        let error_m = (tip - point(scene, cycle + 1)).norm();
        sum_m += error_m;
        max_m = max_m.max(error_m);
    }
    Ok(Run {
        mean_error_mm: sum_m / scene.cycles as f64 * 1e3,
        max_error_mm: max_m * 1e3,
        solve_ns,
    })
}

/// Solve times from 1 ns to a minute, three digits.
///
/// # Errors
/// Never with these bounds.
pub fn histogram() -> Result<Histogram<u64>> {
    Histogram::new_with_bounds(1, 60_000_000_000, 3).context("a histogram of three digits")
}

fn point(scene: &Scene, cycle: u64) -> Vector3<f64> {
    Vector3::from(scene.curve.position_m(cycle as f64 * scene.period_s))
}

/// The exact curve at the steps of the horizon.
pub fn window(scene: &Scene, cycle: u64, steps: u32) -> Vec<ReferenceSample> {
    let sample = |step| ReferenceSample {
        state: ReferenceState::Inside,
        position_m: point(scene, cycle + step),
        ..ReferenceSample::default()
    };
    (1..=u64::from(steps)).map(sample).collect()
}
