//! One experiment, run with several seeds, and the row that sums it up.

use anyhow::{Context, Result};
use cdcr_controller::nmpc::NmpcSettings;
use cdcr_controller::robot::{Shape, ZyxAngles};
use nalgebra::Vector3;
use serde_json::{Value, json};

use crate::closed_loop::{self, Sample};
use crate::dataset::{each, joined};
use crate::experiment::{Experiment, Solver, Task};
use crate::metric::median;
use crate::quantiles::{Quantiles, histogram};
use crate::scene::Scene;
use crate::zone::Zone;

/// An experiment, its row, its first run for the figures, and what came of each seed.
pub struct Outcome {
    pub experiment: Experiment,
    pub scene: Scene,
    pub row: Value,
    pub first: Vec<Sample>,
    pub runs: Vec<Value>,
}

/// How often and how far the paper's simulations are run.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct Effort {
    /// Runs of each solver, each with another seed, 1 to 1000. kpso-refined draws the circle at least 20
    /// times.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub seeds: u32,
    /// Cycles of a run at most: for a quick look.
    #[arg(long = "cycles", value_name = "CYCLES", hide = true, default_value_t = u64::MAX, value_parser = clap::value_parser!(u64).range(1..))]
    pub cycles_max: u64,
}

/// Seeds with which `kpso-refined` draws the circle at least, so that its clearance says something.
const CLEARANCE_SEEDS: u32 = 20;

impl Effort {
    pub fn runs(&self, experiment: &Experiment) -> u64 {
        match (experiment.task, experiment.solver) {
            (Task::Circle { .. }, Solver::KpsoRefined) => self.seeds.max(CLEARANCE_SEEDS).into(),
            _ => self.seeds.into(),
        }
    }

    /// The work of all experiments, in a unit of no meaning: for a bar that shows the time left.
    pub fn all_work(&self) -> u64 {
        Experiment::all()
            .iter()
            .map(|one| self.runs(one) * work(one))
            .sum()
    }
}

/// What one run takes beside another: particles moved over steps.
pub(crate) fn work(experiment: &Experiment) -> u64 {
    let settings = experiment.settings();
    let swarm = match experiment.solver {
        Solver::GaussNewton => 1,
        _ => settings.swarm_size * settings.swarm_iterations,
    };
    u64::from(settings.horizon_steps * swarm)
}

pub fn run(experiment: Experiment, effort: Effort, mut progress: impl FnMut()) -> Result<Outcome> {
    let scene = experiment.task.scene()?.at_most(effort.cycles_max);
    let mut all = Vec::new();
    for seed in 1..=effort.runs(&experiment) {
        let settings = NmpcSettings {
            seed,
            ..experiment.settings()
        };
        all.push(closed_loop::run(&scene, settings)?);
        progress();
    }
    let runs: Vec<Value> = all.iter().map(|samples| run_row(samples)).collect();
    Ok(Outcome {
        row: row(&experiment, &scene, &all, &runs)?,
        experiment,
        scene,
        first: all.swap_remove(0),
        runs,
    })
}

/// One seed.
fn run_row(samples: &[Sample]) -> Value {
    let sum_mm: f64 = samples.iter().map(Sample::error_mm).sum();
    let times_us = samples.iter().map(|sample| sample.solve_ns as f64 * 1e-3);
    json!({ "mean_error_mm": sum_mm / samples.len() as f64, "solve_p50_us": median(times_us) })
}

/// All seeds.
fn row(
    experiment: &Experiment,
    scene: &Scene,
    all: &[Vec<Sample>],
    runs: &[Value],
) -> Result<Value> {
    let (settings, task) = (experiment.settings(), experiment.task);
    let most = |value: &dyn Fn(&Sample) -> f64| all.iter().flatten().map(value).fold(0.0, f64::max);
    let mut solve_ns = histogram()?;
    for sample in all.iter().flatten() {
        solve_ns.saturating_record(sample.solve_ns);
    }
    let mean = json!({ "mean": solve_ns.mean() * 1e-3 });
    let common = json!({
        "name": task.name(),
        "sections": scene.robot.section_count(),
        "solver": experiment.solver,
        "coordinates": experiment.coordinates,
        "horizon": settings.horizon_steps,
        "swarm": settings.swarm_size,
        "iterations": settings.swarm_iterations,
        "samples": scene.cycles,
        "seeds": runs.len(),
        // Median over the seeds of the mean error.
        "mean_error_mm": median(each(runs, "mean_error_mm")),
        "max_error_mm": most(&Sample::error_mm),
        "solve_us": joined([mean, json!(Quantiles::of(&solve_ns).context("no cycle")?)])?,
        "paper": task.paper(),
    });
    let angles = |sample: &Sample| ZyxAngles::from_rotation(&sample.tip.rotation);
    let own = match task {
        Task::Spiral { .. } => json!({}),
        // The largest of all samples and runs.
        Task::Line { rate_limit_rad_s } => json!({
            "max_theta_rad": most(&|sample| angles(sample).theta_rad.abs()),
            "max_psi_rad": most(&|sample| angles(sample).psi_rad.abs()),
            "rate_limit_rad_s": rate_limit_rad_s,
        }),
        Task::Circle { safe_distance_m } => circle(scene, safe_distance_m, all),
    };
    joined([common, own])
}

fn circle(scene: &Scene, safe_distance_m: f64, all: &[Vec<Sample>]) -> Value {
    let zones = all.iter().map(|samples| {
        (
            Zone::of(samples, &obstacle_m(scene), safe_distance_m),
            samples,
        )
    });
    let outside_mm = zones
        .clone()
        .map(|(zone, samples)| zone.mean_error_outside_mm(samples));
    let peaks_mm = zones.map(|(zone, samples)| zone.peak_error_mm(samples));
    let clearances_m = all.iter().flatten().map(|sample| sample.clearance_m);
    json!({
        "safe_distance_mm": 1e3 * safe_distance_m,
        // Smallest clearance of the whole body in all samples and runs.
        "min_clearance_mm": 1e3 * clearances_m.fold(f64::INFINITY, f64::min),
        // Median over the seeds of the mean error after the approach and outside the detour; null when a run has no such
        // sample.
        "mean_error_outside_mm": outside_mm.collect::<Option<Vec<_>>>().and_then(median),
        // Largest error after the approach of all runs; null when a run never arrives.
        "peak_error_mm": peaks_mm.collect::<Option<Vec<_>>>().map(|all| all.into_iter().fold(0.0, f64::max)),
    })
}

pub fn obstacle_m(scene: &Scene) -> Vector3<f64> {
    match scene.obstacles.first().map(|obstacle| *obstacle.shape()) {
        Some(Shape::Sphere { centre_m }) => centre_m,
        _ => Vector3::repeat(f64::INFINITY),
    }
}
