//! One experiment, run with several seeds, and the row that sums it up.

use anyhow::{Context, Result};
use cdcr_controller::nmpc::{Coordinates, NmpcSettings};
use cdcr_controller::robot::{Shape, ZyxAngles};
use hdrhistogram::Histogram;
use nalgebra::Vector3;
use serde::Serialize;

use crate::closed_loop::{self, Sample};
use crate::experiment::{Experiment, PaperMetrics, Solver, Task};
use crate::metric::median;
use crate::quantiles::{Quantiles, histogram};
use crate::scene::Scene;
use crate::zone::Zone;

#[derive(Debug, Clone, Copy, Serialize)]
pub struct SolveTimes {
    pub mean: f64,
    #[serde(flatten)]
    pub quantiles: Quantiles,
}

#[derive(Debug, Clone, Copy, Serialize)]
pub struct LineMetrics {
    /// Largest |Θ| of all samples and runs \[rad\].
    pub max_theta_rad: f64,
    pub max_psi_rad: f64,
    pub rate_limit_rad_s: f64,
}

#[derive(Debug, Clone, Copy, Serialize)]
pub struct CircleMetrics {
    pub safe_distance_mm: f64,
    /// Smallest clearance of the whole body in all samples and runs \[mm\].
    pub min_clearance_mm: f64,
    /// Median over the seeds of the mean error after the approach and outside the detour \[mm\]; none when
    /// a run has no such sample.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mean_error_outside_mm: Option<f64>,
    /// Largest error after the approach of all runs \[mm\]; none when a run never arrives.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub peak_error_mm: Option<f64>,
}

#[derive(Debug, Clone, Serialize)]
pub struct Simulation {
    pub name: &'static str,
    pub sections: usize,
    pub solver: Solver,
    pub coordinates: Coordinates,
    pub horizon: u32,
    pub swarm: u32,
    pub iterations: u32,
    pub samples: u64,
    pub seeds: u64,
    /// Median over the seeds of the mean error \[mm\].
    pub mean_error_mm: f64,
    pub max_error_mm: f64,
    pub solve_us: SolveTimes,
    pub paper: PaperMetrics,
    #[serde(flatten)]
    pub line: Option<LineMetrics>,
    #[serde(flatten)]
    pub circle: Option<CircleMetrics>,
}

/// An experiment, its row, and its first run for the figures.
pub struct Outcome {
    pub experiment: Experiment,
    pub scene: Scene,
    pub row: Simulation,
    pub first: Vec<Sample>,
    pub runs: Vec<Run>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Run {
    pub mean_error_mm: f64,
    pub solve_p50_us: f64,
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
    let mut summary = Summary::new(&experiment)?;
    let mut first = None;
    for seed in 1..=effort.runs(&experiment) {
        let settings = NmpcSettings {
            seed,
            ..experiment.settings()
        };
        let samples = closed_loop::run(&scene, settings)?;
        summary.add(&scene, &samples);
        first.get_or_insert(samples);
        progress();
    }
    Ok(Outcome {
        row: summary.row(&experiment, &scene)?,
        experiment,
        scene,
        first: first.unwrap_or_default(),
        runs: summary.runs,
    })
}

/// What is kept of the runs so far.
struct Summary {
    task: Task,
    solve_ns: Histogram<u64>,
    runs: Vec<Run>,
    max_mm: f64,
    max_theta_rad: f64,
    max_psi_rad: f64,
    min_clearance_m: f64,
    mean_outside_mm: Vec<Option<f64>>,
    peak_mm: Vec<Option<f64>>,
}

impl Summary {
    fn new(experiment: &Experiment) -> Result<Self> {
        Ok(Self {
            task: experiment.task,
            solve_ns: histogram()?,
            runs: Vec::new(),
            max_mm: 0.0,
            max_theta_rad: 0.0,
            max_psi_rad: 0.0,
            min_clearance_m: f64::INFINITY,
            mean_outside_mm: Vec::new(),
            peak_mm: Vec::new(),
        })
    }

    fn add(&mut self, scene: &Scene, samples: &[Sample]) {
        let sum_mm: f64 = samples.iter().map(Sample::error_mm).sum();
        self.runs.push(Run {
            mean_error_mm: sum_mm / samples.len() as f64,
            solve_p50_us: solve_p50_us(samples),
        });
        for sample in samples {
            let angles = ZyxAngles::from_rotation(&sample.tip.rotation);
            self.solve_ns.saturating_record(sample.solve_ns);
            self.max_mm = self.max_mm.max(sample.error_mm());
            self.max_theta_rad = self.max_theta_rad.max(angles.theta_rad.abs());
            self.max_psi_rad = self.max_psi_rad.max(angles.psi_rad.abs());
            self.min_clearance_m = self.min_clearance_m.min(sample.clearance_m);
        }
        if let Task::Circle { safe_distance_m } = self.task {
            let zone = Zone::of(samples, &obstacle_m(scene), safe_distance_m);
            self.mean_outside_mm
                .push(zone.mean_error_outside_mm(samples));
            self.peak_mm.push(zone.peak_error_mm(samples));
        }
    }

    fn row(&self, experiment: &Experiment, scene: &Scene) -> Result<Simulation> {
        let settings = experiment.settings();
        let means_mm = self.runs.iter().map(|run| run.mean_error_mm);
        Ok(Simulation {
            name: experiment.task.name(),
            sections: scene.robot.section_count(),
            solver: experiment.solver,
            coordinates: experiment.coordinates,
            horizon: settings.horizon_steps,
            swarm: settings.swarm_size,
            iterations: settings.swarm_iterations,
            samples: scene.cycles,
            seeds: self.runs.len() as u64,
            mean_error_mm: median(means_mm).unwrap_or(f64::NAN),
            max_error_mm: self.max_mm,
            solve_us: SolveTimes {
                mean: self.solve_ns.mean() * 1e-3,
                quantiles: Quantiles::of(&self.solve_ns).context("no cycle")?,
            },
            paper: experiment.task.paper(),
            line: self.line(),
            circle: self.circle(),
        })
    }

    fn line(&self) -> Option<LineMetrics> {
        let Task::Line { rate_limit_rad_s } = self.task else {
            return None;
        };
        Some(LineMetrics {
            max_theta_rad: self.max_theta_rad,
            max_psi_rad: self.max_psi_rad,
            rate_limit_rad_s,
        })
    }

    fn circle(&self) -> Option<CircleMetrics> {
        let Task::Circle { safe_distance_m } = self.task else {
            return None;
        };
        let all = |values: &[Option<f64>]| values.iter().copied().collect::<Option<Vec<f64>>>();
        Some(CircleMetrics {
            safe_distance_mm: 1e3 * safe_distance_m,
            min_clearance_mm: 1e3 * self.min_clearance_m,
            mean_error_outside_mm: all(&self.mean_outside_mm).and_then(median),
            peak_error_mm: all(&self.peak_mm).map(|values| values.into_iter().fold(0.0, f64::max)),
        })
    }
}

pub fn obstacle_m(scene: &Scene) -> Vector3<f64> {
    match scene.obstacles.first().map(|obstacle| *obstacle.shape()) {
        Some(Shape::Sphere { centre_m }) => centre_m,
        _ => Vector3::repeat(f64::INFINITY),
    }
}

/// The median time of a solve in one run.
fn solve_p50_us(samples: &[Sample]) -> f64 {
    let times_us = samples.iter().map(|s| s.solve_ns as f64 * 1e-3);
    median(times_us).unwrap_or(f64::NAN)
}
