//! Long horizons where they are hard: a spiral so fast that rates saturate, with and without obstacles around the body, by one deadline.

use std::time::{Duration, Instant};

use anyhow::Result;
use cdcr_controller::nmpc::{Nmpc, SolveInput};
use cdcr_controller::optimizer::{Budget, QUANTUM_NS};
use cdcr_controller::reference::{ReferenceSample, ReferenceState};
use cdcr_controller::robot::BendRates;
use hdrhistogram::Histogram;
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

/// Deadlines, counted in quanta \[µs\].
const DEADLINES_US: [u32; 8] = [20, 50, 100, 200, 300, 500, 1000, 4500];
/// Cycles by each of them at most.
const DEADLINE_CYCLES_MAX: u64 = 199;

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

const DEADLINE_COLUMNS: [Column; 12] = [
    word("solver", "solver"),
    plain("speed", "speed"),
    plain("obstacles", "obstacles"),
    power("20 µs", "error_mm_20_us"),
    power("50 µs", "error_mm_50_us"),
    power("100 µs", "error_mm_100_us"),
    power("200 µs", "error_mm_200_us"),
    power("300 µs", "error_mm_300_us"),
    power("500 µs", "error_mm_500_us"),
    power("1 ms", "error_mm_1000_us"),
    power("4.5 ms", "error_mm_4500_us"),
    fixed("clearance - D mm", "spare_clearance_mm", 3),
];

pub const DEADLINE_TABLE: RoundTable = RoundTable {
    key: "hard_deadlines",
    file: "solver-hard-deadlines",
    title: "Mean error mm of the same by shorter deadlines, counted in work",
    columns: &DEADLINE_COLUMNS,
    numbers: &[],
    path: |_| String::new(),
};

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
    every(solve)
}

/// The same by shorter deadlines.
pub fn measure_by_deadlines() -> Result<Vec<Value>> {
    every(solve_by_deadlines)
}

fn every(solve: fn(Solver, u32, usize) -> Result<Value>) -> Result<Vec<Value>> {
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

/// What became of a spiral, cycle by cycle.
struct Outcome {
    errors_mm: Vec<f64>,
    /// Smallest clearance on the way, less the safe distance; infinite without obstacles.
    spare_m: f64,
    times: Histogram<u64>,
    cut_short: u64,
}

impl Outcome {
    fn mean_error_mm(&self) -> f64 {
        self.errors_mm.iter().sum::<f64>() / self.errors_mm.len() as f64
    }

    fn spare_clearance_mm(&self) -> Option<f64> {
        self.spare_m.is_finite().then_some(1e3 * self.spare_m)
    }
}

/// Follows a spiral at so many times the speed of the paper's, with so many quanta for a solve, or by the deadline. The robot does what is planned:
/// no guard corrects it.
fn follow(
    (solver, speed, obstacles): (Solver, u32, usize),
    cycles_max: u64,
    quanta: Option<u32>,
) -> Result<Outcome> {
    let size = Size {
        horizon: HORIZON,
        obstacles,
        ..Size::paper(Task::Spiral { sections: 3 }, solver)
    };
    let (scene, settings) = (size.scene()?, size.settings());
    let mut nmpc = Nmpc::new(scene.robot.clone(), scene.period_s, settings)?;
    let at_s = |cycle: u64| scene.time_s(cycle) * f64::from(speed);
    let (mut at, mut previous_rates) = (scene.start, BendRates::zero(3));
    let mut outcome = Outcome {
        errors_mm: Vec::new(),
        spare_m: f64::INFINITY,
        times: histogram()?,
        cut_short: 0,
    };
    let cycles = (size.task.scene()?.cycles / u64::from(speed)).min(cycles_max);
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
        let mut budget = quanta.map_or_else(|| Budget::new(&mut is_spent), Budget::of_quanta);
        let (rates, report) = nmpc.solve(&input, &mut budget);
        outcome
            .times
            .saturating_record(begin.elapsed().as_nanos() as u64);
        outcome.cut_short += u64::from(report.budget_spent);
        at = at.advanced(&rates, scene.period_s);
        previous_rates = rates;
        let goal_m = window[0].position_m;
        let error_m = (scene.robot.tip_position(&at) - goal_m).norm();
        outcome.errors_mm.push(1e3 * error_m);
        let body = scene.robot.body(&at);
        let clearance_m = body.least_clearance_m(scene.obstacles.iter().copied());
        let spare_m = clearance_m - settings.safe_distance_m;
        outcome.spare_m = outcome.spare_m.min(spare_m);
    }
    Ok(outcome)
}

fn solve(solver: Solver, speed: u32, obstacles: usize) -> Result<Value> {
    let outcome = follow((solver, speed, obstacles), CYCLES_MAX, None)?;
    let (errors_mm, times) = (&outcome.errors_mm, &outcome.times);
    Ok(json!({
        "solver": solver,
        "speed": speed,
        "obstacles": obstacles,
        "mean_error_mm": outcome.mean_error_mm(),
        "max_error_mm": errors_mm.iter().copied().fold(0.0, f64::max),
        "spare_clearance_mm": outcome.spare_clearance_mm(),
        "p50_us": quantile_us(times, 0.5),
        "p99_us": quantile_us(times, 0.99),
        "cut_short_percent": 100.0 * outcome.cut_short as f64 / errors_mm.len() as f64,
    }))
}

/// Mean errors by each deadline.
fn solve_by_deadlines(solver: Solver, speed: u32, obstacles: usize) -> Result<Value> {
    let mut row = json!({ "solver": solver, "speed": speed, "obstacles": obstacles });
    let mut spare_mm: Option<f64> = None;
    for deadline_us in DEADLINES_US {
        let quanta = 1000 * deadline_us / QUANTUM_NS;
        let outcome = follow(
            (solver, speed, obstacles),
            DEADLINE_CYCLES_MAX,
            Some(quanta),
        )?;
        row[format!("error_mm_{deadline_us}_us")] = outcome.mean_error_mm().into();
        let own_mm = outcome.spare_clearance_mm();
        spare_mm = spare_mm.or(own_mm).zip(own_mm).map(|(a, b)| a.min(b));
    }
    row["spare_clearance_mm"] = spare_mm.into();
    Ok(row)
}

fn sample(position_m: [f64; 3]) -> ReferenceSample {
    ReferenceSample {
        state: ReferenceState::Inside,
        position_m: Vector3::from(position_m),
        ..ReferenceSample::default()
    }
}
