//! Long horizons on a spiral so fast that rates saturate, with and without obstacles around the body.

use std::time::Duration;

use anyhow::Result;
use cdcr_controller::nmpc::SolveInput;
use cdcr_controller::optimizer::{Budget, QUANTUM_NS};
use cdcr_controller::reference::ReferenceSample;
use cdcr_controller::robot::BendRates;
use serde_json::{Value, json};

use super::Size;
use crate::closed_loop::{End, PERIOD_S, timed_solve};
use crate::dataset::{each, joined};
use crate::experiment::{Solver, Task};
use crate::quantiles::{histogram, quantile_us};

/// Steps of the horizon, each with separate rates.
const HORIZON: u32 = 20;
const BUDGET: Duration = Duration::from_micros(4500);
const SPEEDS: [u32; 4] = [1, 3, 5, 10];
const OBSTACLES: [usize; 2] = [0, 16];
const CYCLES_MAX: u64 = 400;
/// Runs of each timed problem; in each cycle the fastest counts, because only the machine differs between them.
const REPETITIONS: usize = 3;

/// Deadlines, counted in quanta \[µs\].
const DEADLINES_US: [u32; 8] = [20, 50, 100, 200, 300, 500, 1000, 4500];
const DEADLINE_CYCLES_MAX: u64 = 199;

/// Every problem with the refining solvers; none in a short run.
pub fn measure(divisor: u64) -> Result<Vec<Value>> {
    let end = End::After(BUDGET);
    every(divisor, |problem| {
        let run = |_| follow(problem, CYCLES_MAX, end);
        let mut runs = (0..REPETITIONS).map(run).collect::<Result<Vec<_>>>()?;
        // A stall that cuts a solve short leads to another course.
        runs.sort_by_key(|run| run.cut_short);
        let is_same = |run: &&Run| run.rates == runs[0].rates;
        let mut times = histogram();
        for cycle in 0..runs[0].times.len() {
            let of_cycle = runs.iter().filter(is_same).map(|run| run.times[cycle]);
            let fastest = of_cycle.min().unwrap_or_default();
            times.saturating_record(fastest.as_nanos() as u64);
        }
        let quantiles = json!({
            "p50_us": quantile_us(&times, 0.5),
            "p99_us": quantile_us(&times, 0.99),
        });
        Ok(joined([runs[0].outcome.clone(), quantiles]))
    })
}

/// Mean errors of the same problems with shorter deadlines.
pub fn measure_by_deadlines(divisor: u64) -> Result<Vec<Value>> {
    every(divisor, |problem| {
        let mut by_deadlines = Vec::new();
        let mut row = json!({});
        for deadline_us in DEADLINES_US {
            let end = End::AfterQuanta(1000 * deadline_us / QUANTUM_NS);
            let outcome = follow(problem, DEADLINE_CYCLES_MAX, end)?.outcome;
            row[format!("error_mm_{deadline_us}_us")] = outcome["mean_error_mm"].clone();
            by_deadlines.push(outcome);
        }
        let spare_mm = each(&by_deadlines, "spare_clearance_mm").reduce(f64::min);
        row["spare_clearance_mm"] = spare_mm.into();
        Ok(row)
    })
}

type Problem = (Solver, u32, usize);

fn every(divisor: u64, solve: impl Fn(Problem) -> Result<Value>) -> Result<Vec<Value>> {
    let mut rows = Vec::new();
    if divisor > 1 {
        return Ok(rows);
    }
    for solver in [Solver::GaussNewton, Solver::KpsoRefined] {
        for obstacles in OBSTACLES {
            for speed in SPEEDS {
                let own = json!({ "solver": solver, "speed": speed, "obstacles": obstacles });
                rows.push(joined([own, solve((solver, speed, obstacles))?]));
            }
        }
    }
    Ok(rows)
}

struct Run {
    outcome: Value,
    cut_short: u64,
    rates: Vec<BendRates>,
    times: Vec<Duration>,
}

/// The robot executes the plan; no guard corrects it. As in a daemon, the first solve was rehearsed.
fn follow((solver, speed, obstacles): Problem, cycles_max: u64, end: End) -> Result<Run> {
    let mut size = Size::paper(Task::Spiral { sections: 3 }, solver);
    (size.settings.horizon_steps, size.obstacles) = (HORIZON, obstacles);
    let (scene, settings) = (size.scene()?, size.settings);
    let mut nmpc = scene.solver(settings)?;
    let at_s = |cycle: u64| scene.time_s(cycle) * f64::from(speed);
    let (mut at, mut previous_rates) = (scene.start, BendRates::zero(3));
    let (mut errors_mm, mut all_rates, mut times) = (Vec::new(), Vec::new(), Vec::new());
    let (mut cut_short, mut spare_m) = (0, f64::INFINITY);
    let cycles = (size.task.scene()?.cycles / u64::from(speed)).min(cycles_max);
    for cycle in 0..cycles {
        let steps = 1..=u64::from(HORIZON);
        let positions_m = steps.map(|step| scene.curve.position_m(at_s(cycle + step)));
        let window: Vec<_> = positions_m.map(|m| ReferenceSample::at(m.into())).collect();
        let input = SolveInput {
            configuration: &at,
            previous_rates: &previous_rates,
            reference: &window,
            obstacles: &scene.obstacles,
            tip_offset_m: 0.0,
            elapsed_periods: 1,
            seed: cycle,
        };
        if cycle == 0 {
            nmpc.rehearse(&input, &mut Budget::unlimited());
        }
        let (rates, report, time) = timed_solve(&mut nmpc, &input, end);
        times.push(time);
        all_rates.push(rates);
        cut_short += u64::from(report.budget_spent);
        at = at.advanced(&rates, PERIOD_S);
        previous_rates = rates;
        let error_m = (scene.robot.tip_position(&at) - window[0].position_m).norm();
        errors_mm.push(1e3 * error_m);
        let body = scene.robot.body(&at);
        let clearance_m = body.least_clearance_m(scene.obstacles.iter().copied());
        spare_m = spare_m.min(clearance_m - settings.safe_distance_m);
    }
    let count = errors_mm.len() as f64;
    let outcome = json!({
        "mean_error_mm": errors_mm.iter().sum::<f64>() / count,
        "max_error_mm": errors_mm.iter().copied().fold(0.0, f64::max),
        "spare_clearance_mm": spare_m.is_finite().then_some(1e3 * spare_m),
        "cut_short_percent": 100.0 * cut_short as f64 / count,
    });
    Ok(Run {
        outcome,
        cut_short,
        rates: all_rates,
        times,
    })
}
