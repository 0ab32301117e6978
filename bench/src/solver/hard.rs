//! Long horizons on a spiral so fast that rates saturate, with and without obstacles around the body.

use std::time::Duration;

use anyhow::Result;
use cdcr_controller::nmpc::SolverKind;
use cdcr_controller::optimizer::QUANTUM_NS;
use serde_json::{Value, json};

use super::Size;
use crate::closed_loop::{End, Sample, SceneRun, run_with};
use crate::dataset::{each, joined};
use crate::experiment::Task;
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
        runs.sort_by_key(|run| run.0.iter().filter(|sample| sample.cut_short).count());
        let rates =
            |run: &SceneRun| -> Vec<_> { run.0.iter().map(|sample| sample.rates).collect() };
        let first = rates(&runs[0]);
        runs.retain(|run| rates(run) == first);
        let mut times = histogram();
        for cycle in 0..runs[0].0.len() {
            let of_cycle = runs.iter().map(|run| run.0[cycle].solve_ns);
            times.saturating_record(of_cycle.min().unwrap_or_default());
        }
        let [p50_us, p99_us] = [0.5, 0.99].map(|part| quantile_us(&times, part));
        let quantiles = json!({ "p50_us": p50_us, "p99_us": p99_us });
        Ok(joined([outcome(problem, &runs[0]), quantiles]))
    })
}

/// Mean errors of the same problems with shorter deadlines.
pub fn measure_by_deadlines(divisor: u64) -> Result<Vec<Value>> {
    every(divisor, |problem| {
        let (mut by_deadlines, mut row) = (Vec::new(), json!({}));
        for deadline_us in DEADLINES_US {
            let end = End::AfterQuanta(1000 * deadline_us / QUANTUM_NS);
            let outcome = outcome(problem, &follow(problem, DEADLINE_CYCLES_MAX, end)?);
            row[format!("error_mm_{deadline_us}_us")] = outcome["mean_error_mm"].clone();
            by_deadlines.push(outcome);
        }
        let spares_mm = each(&by_deadlines, "spare_clearance_mm");
        row["spare_clearance_mm"] = spares_mm.reduce(f64::min).into();
        Ok(row)
    })
}

type HardProblem = (SolverKind, u32, usize);

fn every(divisor: u64, solve: impl Fn(HardProblem) -> Result<Value>) -> Result<Vec<Value>> {
    let mut rows = Vec::new();
    if divisor > 1 {
        return Ok(rows);
    }
    for solver in [SolverKind::GaussNewton, SolverKind::KpsoRefined] {
        for obstacles in OBSTACLES {
            for speed in SPEEDS {
                let own = json!({ "solver": solver, "speed": speed, "obstacles": obstacles });
                rows.push(joined([own, solve((solver, speed, obstacles))?]));
            }
        }
    }
    Ok(rows)
}

fn size((solver, _, obstacles): HardProblem) -> Size {
    let mut size = Size::paper(Task::Spiral { sections: 3 }, solver);
    (size.settings.horizon_steps, size.obstacles) = (HORIZON, obstacles);
    size
}

/// No guard corrects the plan.
fn follow(problem: HardProblem, cycles_max: u64, end: End) -> Result<SceneRun> {
    let (size, speed) = (size(problem), problem.1);
    let mut scene = size.scene()?.faster(speed.into());
    scene.cycles = (size.task.scene()?.cycles / u64::from(speed)).min(cycles_max);
    run_with(&scene, size.settings, end, false, |_, _| ())
}

fn outcome(problem: HardProblem, run: &SceneRun) -> Value {
    let least_m = Some(run.least_clearance_m()).filter(|least_m| least_m.is_finite());
    let safe_m = size(problem).settings.safe_distance_m;
    json!({
        "mean_error_mm": run.mean_error_mm(),
        "max_error_mm": run.most(Sample::error_mm),
        "spare_clearance_mm": least_m.map(|least_m| 1e3 * (least_m - safe_m)),
        "cut_short_percent": 100.0 * run.share(|sample| sample.cut_short),
    })
}
