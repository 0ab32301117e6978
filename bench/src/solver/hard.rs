//! Long horizons where they are hard: a spiral so fast that rates saturate, with and without obstacles around the body, by one deadline.

use std::time::{Duration, Instant};

use anyhow::Result;
use cdcr_controller::nmpc::{Nmpc, SolveInput};
use cdcr_controller::optimizer::Budget;
use cdcr_controller::reference::{ReferenceSample, ReferenceState};
use cdcr_controller::robot::BendRates;
use nalgebra::Vector3;
use serde_json::{Value, json};

use super::Size;
use crate::dataset::{Column, RoundTable, fixed, plain, power, word};
use crate::experiment::{Solver, Task};
use crate::quantiles::{histogram, quantile_us};

/// Steps of the horizon, each with rates of its own.
const HORIZON: u32 = 20;
/// Time of a solve \[ms\].
const BUDGET_MS: f64 = 4.5;
/// How many times as fast as the paper's.
const SPEEDS: [u32; 4] = [1, 3, 5, 10];
const OBSTACLES: [usize; 2] = [0, 16];
/// Cycles at most, at half the spiral's time.
const CYCLES_MAX: u64 = 400;

const COLUMNS: [Column; 9] = [
    word("solver", "solver"),
    plain("speed", "speed"),
    plain("obstacles", "obstacles"),
    power("mean error mm", "mean_error_mm"),
    power("max error mm", "max_error_mm"),
    fixed("clearance - D mm", "spare_clearance_mm", 3),
    fixed("p50 µs", "p50_us", 1),
    fixed("p99 µs", "p99_us", 1),
    fixed("cut short %", "cut_short_percent", 1),
];

pub const TABLE: RoundTable = RoundTable {
    key: "hard",
    file: "solver-hard",
    title: "Long horizons by a deadline: 3 sections, 20 steps, 4.5 ms a solve, no guard",
    columns: &COLUMNS,
    numbers: &[("p50", "µs", "p50_us"), ("p99", "µs", "p99_us")],
    path: |row| {
        let solver = row["solver"].as_str().unwrap_or_default();
        format!(
            "hard/{solver}/{}-times/{}-obstacles",
            row["speed"], row["obstacles"]
        )
    },
};

/// Measures every problem with the solvers that refine.
pub fn measure() -> Result<Vec<Value>> {
    let mut rows = Vec::new();
    for solver in [Solver::GaussNewton, Solver::KpsoRefined] {
        for obstacles in OBSTACLES {
            for speed in SPEEDS {
                rows.push(solve(solver, speed, obstacles)?);
            }
        }
    }
    Ok(rows)
}

/// At so many times the speed of the paper's spiral. The robot does what is planned: no guard corrects it.
fn solve(solver: Solver, speed: u32, obstacles: usize) -> Result<Value> {
    let size = Size {
        horizon: HORIZON,
        obstacles,
        ..Size::paper(Task::Spiral { sections: 3 }, solver)
    };
    let (scene, settings) = (size.scene()?, size.settings());
    let mut nmpc = Nmpc::new(scene.robot.clone(), scene.period_s, settings)?;
    let at_s = |cycle: u64| scene.time_s(cycle) * f64::from(speed);
    let (mut at, mut previous_rates) = (scene.start, BendRates::zero(3));
    let (mut times, mut errors_mm) = (histogram()?, Vec::new());
    let (mut spare_m, mut cut_short) = (f64::INFINITY, 0_u64);
    let cycles = (size.task.scene()?.cycles / u64::from(speed)).min(CYCLES_MAX);
    for cycle in 0..cycles {
        let window: Vec<_> = (1..=u64::from(HORIZON))
            .map(|step| sample(scene.curve.position_m(at_s(cycle + step))))
            .collect();
        let input = SolveInput {
            configuration: &at,
            previous_rates: &previous_rates,
            reference: &window,
            obstacles: &scene.obstacles,
            tip_offset_m: 0.0,
            elapsed_periods: 1,
            seed: cycle,
        };
        let begin = Instant::now();
        let budget = Duration::from_secs_f64(1e-3 * BUDGET_MS);
        let mut is_spent = || begin.elapsed() >= budget;
        let (rates, report) = nmpc.solve(&input, &mut Budget::new(&mut is_spent));
        times.saturating_record(begin.elapsed().as_nanos() as u64);
        cut_short += u64::from(report.budget_spent);
        at = at.advanced(&rates, scene.period_s);
        previous_rates = rates;
        let goal_m = window[0].position_m;
        errors_mm.push(1e3 * (scene.robot.tip_position(&at) - goal_m).norm());
        let body = scene.robot.body(&at);
        let clearance_m = body.least_clearance_m(scene.obstacles.iter().copied());
        spare_m = spare_m.min(clearance_m - settings.safe_distance_m);
    }
    let count = errors_mm.len() as f64;
    Ok(json!({
        "solver": solver,
        "speed": speed,
        "obstacles": obstacles,
        "mean_error_mm": errors_mm.iter().sum::<f64>() / count,
        "max_error_mm": errors_mm.iter().copied().fold(0.0, f64::max),
        // Smallest clearance on the way, less the safe distance.
        "spare_clearance_mm": spare_m.is_finite().then_some(1e3 * spare_m),
        "p50_us": quantile_us(&times, 0.5),
        "p99_us": quantile_us(&times, 0.99),
        "cut_short_percent": 100.0 * cut_short as f64 / count,
    }))
}

fn sample(position_m: [f64; 3]) -> ReferenceSample {
    ReferenceSample {
        state: ReferenceState::Inside,
        position_m: Vector3::from(position_m),
        ..ReferenceSample::default()
    }
}
