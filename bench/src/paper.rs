//! The paper's simulations as a benchmark: each experiment with several seeds, and its row.

use anyhow::{Context, Result};
use cdcr_controller::nmpc::SolverKind;
use cdcr_controller::robot::ZyxAngles;
use hdrhistogram::Histogram;
use serde_json::{Value, json};

use crate::benchmark::Benchmark;
use crate::closed_loop::{self, Sample, Scene, SceneRun};
use crate::dataset::{Dataset, each, joined, together};
use crate::experiment::{Experiment, Outcome, Task};
use crate::interrupt;
use crate::metric::median;
use crate::plots;
use crate::progress::Progress;
use crate::quantiles::{histogram, quantiles};

/// The approach ends when the error first falls below this value \[mm\]. The printed constants of the circle
/// are rounded and leave 7.2e-3 mm.
const ARRIVED_MM: f64 = 0.02;
/// The detour is where the reference is nearer to the obstacle than this many safe distances.
const DETOUR_DISTANCES: f64 = 2.0;
/// Least number of seeds of `kpso-refined` on the circle, for a meaningful clearance.
const CLEARANCE_SEEDS: u32 = 20;

/// Approximate time per particle and step over a whole simulation \[s\], and its cycles.
const WORK_S: f64 = 2.5e-4;
const CYCLES: u64 = 1000;

/// How often and how far the paper's simulations are run.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct Effort {
    /// Runs per solver, each with its own seed, 1 to 1000. kpso-refined runs the circle at least 20
    /// times.
    #[arg(long, alias = "rounds", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub seeds: u32,
    #[arg(skip = u64::MAX)]
    pub cycles_max: u64,
}

impl Effort {
    fn runs(&self, experiment: &Experiment) -> u64 {
        u64::from(match (experiment.task, experiment.solver) {
            (Task::Circle { .. }, SolverKind::KpsoRefined) => self.seeds.max(CLEARANCE_SEEDS),
            _ => self.seeds,
        })
    }

    /// Expected duration of a run, from its particles and steps \[s\].
    fn run_s(&self, experiment: &Experiment) -> f64 {
        let settings = experiment.settings();
        let swarm = match experiment.solver {
            SolverKind::GaussNewton => 1,
            _ => settings.swarm_size * settings.swarm_iterations,
        };
        let share = self.cycles_max.min(CYCLES) as f64 / CYCLES as f64;
        f64::from(settings.horizon_steps * swarm) * WORK_S * share
    }
}

impl Benchmark for Effort {
    /// The errors of such a short run are meaningless.
    fn quicken(&mut self) {
        (self.seeds, self.cycles_max) = (1, 50);
    }

    fn expected_s(&self) -> f64 {
        let of = |one: Experiment| self.runs(&one) as f64 * self.run_s(&one);
        Experiment::all().into_iter().map(of).sum()
    }

    fn run(&self, progress: &mut Progress) -> Result<Dataset> {
        let mut outcomes = Vec::new();
        for experiment in Experiment::all() {
            interrupt::check()?;
            let (curve, solver) = (experiment.task.name(), experiment.solver_name());
            progress.begin(&format!("{curve}, {solver}"));
            let run_s = self.run_s(&experiment);
            outcomes.push(run(experiment, *self, || progress.advance(run_s))?);
        }
        dataset(&outcomes)
    }
}

fn dataset(outcomes: &[Outcome]) -> Result<Dataset> {
    let mut dataset = Dataset::new("paper", include_str!("paper.toml"));
    plots::draw(&mut dataset, outcomes)?;
    let rows = |of: &[&Outcome]| of.iter().map(|outcome| outcome.row.clone()).collect();
    let all: Vec<&Outcome> = outcomes.iter().collect();
    for of_table in all.chunk_by(|one, other| one.row["name"] == other.row["name"]) {
        let name = of_table[0].experiment.task.name();
        // The seeds serve as rounds: results that depend on the random swarm get their spread from them.
        for Outcome { row, runs, .. } in of_table {
            dataset.compare(name, row, runs);
        }
        dataset.add(name, rows(of_table));
    }
    dataset.add("simulations", rows(&all));
    Ok(dataset)
}

/// Keeps only the first run whole, so that memory does not grow with the number of seeds.
pub fn run(experiment: Experiment, effort: Effort, mut progress: impl FnMut()) -> Result<Outcome> {
    let scene = experiment.task.scene()?.at_most(effort.cycles_max);
    let (mut first, mut runs, mut solve_ns) = (None, Vec::new(), histogram());
    for seed in 1..=effort.runs(&experiment) {
        let mut settings = experiment.settings();
        settings.seed = seed;
        let run = closed_loop::run(&scene, settings)?;
        (run.0.iter()).for_each(|sample| solve_ns.saturating_record(sample.solve_ns));
        runs.push(run_row(&experiment, &scene, &run));
        first.get_or_insert(run);
        progress();
    }
    Ok(Outcome {
        row: row(&runs, &solve_ns),
        experiment,
        scene,
        first: first.context("no run")?,
        runs,
    })
}

fn run_row(experiment: &Experiment, scene: &Scene, run: &SceneRun) -> Value {
    let (settings, task) = (experiment.settings(), experiment.task);
    let times_us = run.0.iter().map(|sample| sample.solve_ns as f64 * 1e-3);
    let (paper_error_mm, paper_solve_ms) = task.paper();
    let common = json!({
        "name": task.name(),
        "sections": scene.robot.section_count(),
        "solver": experiment.solver_name(),
        "coordinates": experiment.coordinates,
        "horizon": settings.horizon_steps,
        "swarm": settings.swarm_size,
        "iterations": settings.swarm_iterations,
        "samples": scene.cycles,
        "paper": { "mean_error_mm": paper_error_mm, "mean_solve_ms": paper_solve_ms },
        "mean_error_mm": run.mean_error_mm(),
        "max_error_mm": run.most(Sample::error_mm),
        "swarm_ran_share": run.share(|sample| sample.swarm_ran),
        "swarm_won_share": run.share(|sample| sample.swarm_won),
        "solve_p50_us": median(times_us),
    });
    let angles = |sample: &Sample| ZyxAngles::from_rotation(&sample.tip.rotation);
    let own = match task {
        Task::Spiral { .. } => json!({}),
        Task::Line { rate_limit_rad_s } => json!({
            "rate_limit_rad_s": rate_limit_rad_s,
            "max_theta_rad": run.most(|sample| angles(sample).theta_rad.abs()),
            "max_psi_rad": run.most(|sample| angles(sample).psi_rad.abs()),
        }),
        Task::Circle { safe_distance_m } => {
            let obstacle_m = closed_loop::obstacle_m(scene);
            let distance_m = |sample: &Sample| (sample.reference_m - obstacle_m).norm();
            let error = |it: &Sample| (distance_m(it), it.error_mm());
            let errors: Vec<_> = run.0.iter().map(error).collect();
            let [outside_mm, peak_mm] = errors_mm(&errors, safe_distance_m);
            json!({
                "safe_distance_mm": 1e3 * safe_distance_m,
                "min_clearance_mm": 1e3 * run.least_clearance_m(),
                "mean_error_outside_mm": outside_mm,
                "peak_error_mm": peak_mm,
            })
        }
    };
    joined([common, own])
}

/// All seeds: medians of mean values, the worst of extreme values, the share of all solves.
fn row(runs: &[Value], solve_ns: &Histogram<u64>) -> Value {
    let mut row = together(runs, &[]);
    if row["name"] == "circle" {
        // Null if a run has no such sample.
        let of_all = |key| {
            let known: Vec<f64> = each(runs, key).collect();
            Some(known).filter(|known| known.len() == runs.len())
        };
        let peak = |all: Vec<f64>| all.into_iter().reduce(f64::max);
        row["peak_error_mm"] = of_all("peak_error_mm").and_then(peak).into();
        row["mean_error_outside_mm"] = of_all("mean_error_outside_mm").and_then(median).into();
    }
    for key in ["swarm_ran_share", "swarm_won_share"] {
        row[key] = (each(runs, key).sum::<f64>() / runs.len() as f64).into();
    }
    let mean = json!({ "mean": solve_ns.mean() * 1e-3 });
    row["solve_us"] = joined([mean, quantiles(solve_ns)]);
    row["seeds"] = runs.len().into();
    row.as_object_mut()
        .and_then(|row| row.remove("solve_p50_us"));
    row
}

/// After the approach: mean error outside the detour, and largest error \[mm\]. A sample is the distance of its
/// reference from the obstacle \[m\] and its error \[mm\].
fn errors_mm(samples: &[(f64, f64)], safe_distance_m: f64) -> [Option<f64>; 2] {
    let arrived = samples.iter().skip_while(|sample| sample.1 >= ARRIVED_MM);
    let peak_mm = arrived.clone().map(|sample| sample.1).reduce(f64::max);
    let reach_m = DETOUR_DISTANCES * safe_distance_m;
    let outside = arrived.filter(|(distance_m, _)| *distance_m >= reach_m);
    let outside_mm: Vec<f64> = outside.map(|sample| sample.1).collect();
    let sum_mm: f64 = outside_mm.iter().sum();
    let mean_mm = (!outside_mm.is_empty()).then(|| sum_mm / outside_mm.len() as f64);
    [mean_mm, peak_mm]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn approach_and_detour_are_left_out_of_the_mean_and_only_the_approach_of_the_peak() {
        // The third error is above the threshold again, but the approach is over.
        let approach = [(0.1, 100.0), (0.09, 0.01), (0.08, 0.03)];
        let detour = [(0.019, 12.0), (0.0, 10.0), (0.021, 0.02)];
        let [mean_mm, peak_mm] = errors_mm(&[approach, detour].concat(), 0.01);
        assert!((mean_mm.unwrap() - 0.02).abs() < 1e-12, "{mean_mm:?}");
        assert_eq!(peak_mm, Some(12.0));
        assert_eq!(errors_mm(&[(0.5, 3.0)], 0.01), [None; 2], "never arrives");
    }
}
