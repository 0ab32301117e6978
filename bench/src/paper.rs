//! The paper's simulation 1 (the spiral of Eq. 8), for every solver, beside the paper's figures.

use anyhow::Result;
use cdcr_client::Spiral;
use cdcr_controller::nmpc::{NmpcSettings, SolverKind};
use cdcr_controller::robot::{Configuration, Robot, RobotParameters};
use serde::Serialize;

use crate::closed_loop::{self, Run, Scene};

/// Mean error \[mm\] and mean computation time \[ms\] that the paper states for 1, 2 and 3 sections.
pub const PAPER: [(f64, f64); 3] = [(5e-9, 4.0), (7e-4, 5.0), (5e-3, 23.0)];
/// Samples of the paper's spiral.
const SAMPLES: u64 = 994;
/// The paper's time step \[s\].
pub const PERIOD_S: f64 = 0.005;
/// The solvers that are compared.
const SOLVERS: [(SolverKind, &str); 3] = [
    (SolverKind::Kpso, "kpso"),
    (SolverKind::GaussNewton, "gauss-newton"),
    (SolverKind::KpsoRefined, "kpso-refined"),
];

/// Times of one solver \[µs\].
#[derive(Debug, Clone, Copy, Serialize)]
pub struct SolveTimes {
    /// Mean.
    pub mean: f64,
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Largest.
    pub max: f64,
}

/// What the paper states.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct PaperFigures {
    /// Mean error \[mm\].
    pub mean_error_mm: f64,
    /// Mean computation time \[ms\].
    pub mean_solve_ms: f64,
}

/// One row: one solver on one robot.
#[derive(Debug, Clone, Serialize)]
pub struct Simulation {
    /// Name of the curve.
    pub name: &'static str,
    /// Sections of the robot.
    pub sections: usize,
    /// Solver.
    pub solver: &'static str,
    /// Prediction steps.
    pub horizon: u32,
    /// Particles.
    pub swarm: u32,
    /// Swarm iterations.
    pub iterations: u32,
    /// Cycles of a run.
    pub samples: u64,
    /// Runs, each with another seed.
    pub seeds: u64,
    /// Median over the seeds of the mean error \[mm\].
    pub mean_error_mm: f64,
    /// Largest error of all runs \[mm\].
    pub max_error_mm: f64,
    /// Solve times of all runs.
    pub solve_us: SolveTimes,
    /// What the paper states.
    pub paper: PaperFigures,
}

/// A row without nesting, for CSV.
#[derive(Debug, Clone, Serialize)]
#[expect(missing_docs, reason = "as in Simulation, SolveTimes and PaperFigures")]
pub struct Flat {
    pub name: &'static str,
    pub sections: usize,
    pub solver: &'static str,
    pub horizon: u32,
    pub swarm: u32,
    pub iterations: u32,
    pub samples: u64,
    pub seeds: u64,
    pub mean_error_mm: f64,
    pub max_error_mm: f64,
    pub solve_mean_us: f64,
    pub solve_p50_us: f64,
    pub solve_p99_us: f64,
    pub solve_max_us: f64,
    pub paper_mean_error_mm: f64,
    pub paper_mean_solve_ms: f64,
}

impl From<&Simulation> for Flat {
    fn from(row: &Simulation) -> Self {
        Self {
            name: row.name,
            sections: row.sections,
            solver: row.solver,
            horizon: row.horizon,
            swarm: row.swarm,
            iterations: row.iterations,
            samples: row.samples,
            seeds: row.seeds,
            mean_error_mm: row.mean_error_mm,
            max_error_mm: row.max_error_mm,
            solve_mean_us: row.solve_us.mean,
            solve_p50_us: row.solve_us.p50,
            solve_p99_us: row.solve_us.p99,
            solve_max_us: row.solve_us.max,
            paper_mean_error_mm: row.paper.mean_error_mm,
            paper_mean_solve_ms: row.paper.mean_solve_ms,
        }
    }
}

/// Runs the spiral for 1, 2 and 3 sections with every solver, `seeds` times each; `progress` is called
/// after each run.
///
/// # Errors
/// When a controller cannot be built.
pub fn spiral(seeds: u64, mut progress: impl FnMut()) -> Result<Vec<Simulation>> {
    let mut rows = Vec::new();
    for sections in 1..=PAPER.len() {
        let (robot, curve) = spiral_of(sections)?;
        let scene = Scene {
            robot: &robot,
            start: start(sections, curve.start_bend_rad()),
            curve: &curve,
            cycles: SAMPLES,
            period_s: PERIOD_S,
        };
        for (solver, name) in SOLVERS {
            let mut runs = Vec::new();
            for seed in 1..=seeds {
                let settings = NmpcSettings {
                    solver,
                    seed,
                    ..NmpcSettings::default()
                };
                runs.push(closed_loop::run(&scene, settings)?);
                progress();
            }
            rows.push(row(sections, name, &runs)?);
        }
    }
    Ok(rows)
}

/// The paper's robot with this many sections, and its spiral, long enough for the horizon of the last
/// cycle.
///
/// # Errors
/// When there is no such robot.
pub fn spiral_of(sections: usize) -> Result<(Robot, Spiral)> {
    let parameters = RobotParameters::paper(sections);
    let lengths: Vec<f64> = parameters
        .sections
        .iter()
        .map(|section| section.length_m)
        .collect();
    let curve = Spiral {
        duration_s: 2.0 * Spiral::DURATION_S,
        ..Spiral::for_sections(&lengths)
    };
    Ok((Robot::new(&parameters)?, curve))
}

/// Runs that [`spiral`] makes.
pub fn spiral_runs(seeds: u64) -> u64 {
    seeds * (PAPER.len() * SOLVERS.len()) as u64
}

/// The spiral's first point: all sections straight but the last.
pub fn start(sections: usize, last: [f64; 2]) -> Configuration {
    let mut start = Configuration::straight(sections);
    start.as_mut_slice()[2 * sections - 2..].copy_from_slice(&last);
    start
}

fn row(sections: usize, solver: &'static str, runs: &[Run]) -> Result<Simulation> {
    let settings = NmpcSettings::default();
    let mut means: Vec<f64> = runs.iter().map(|run| run.mean_error_mm).collect();
    means.sort_by(f64::total_cmp);
    let mut solve_ns = closed_loop::histogram()?;
    for run in runs {
        solve_ns.add(&run.solve_ns)?;
    }
    let us = |quantile| solve_ns.value_at_quantile(quantile) as f64 * 1e-3;
    let (mean_error_mm, mean_solve_ms) = PAPER[sections - 1];
    Ok(Simulation {
        name: "spiral",
        sections,
        solver,
        horizon: settings.horizon_steps,
        swarm: settings.swarm_size,
        iterations: settings.swarm_iterations,
        samples: SAMPLES,
        seeds: runs.len() as u64,
        mean_error_mm: means[means.len() / 2],
        max_error_mm: runs.iter().map(|run| run.max_error_mm).fold(0.0, f64::max),
        solve_us: SolveTimes {
            mean: solve_ns.mean() * 1e-3,
            p50: us(0.5),
            p99: us(0.99),
            max: us(1.0),
        },
        paper: PaperFigures {
            mean_error_mm,
            mean_solve_ms,
        },
    })
}
