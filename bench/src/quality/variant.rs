//! A variant of solver, budget, swarm and horizon, and the result of a course driven with it.

use std::time::Duration;

use anyhow::Result;
use cdcr_controller::nmpc::{NmpcSettings, SolverKind};
use serde_json::{Value, json};

use super::course::Course;
use crate::closed_loop::{End, PERIOD_S, PlanEvaluator, Sample, Scene, run_with, timed_solve};
use crate::metric::median;
use crate::quantiles::{histogram, quantile_us};

/// Particles when the budget ends a solve; iterations and Gauss-Newton steps are then at their maximum.
const BUDGET_SWARM: u32 = 64;
const BUDGET_ITERATIONS: u32 = 1000;
const BUDGET_REFINEMENTS: u32 = 50;

/// Time around a solve: evaluation of its plan, clearance guard \[µs\].
const AROUND_US: f64 = 15.0;
/// Mean time of a solve without a budget, over all courses and solvers \[µs\].
const UNLIMITED_US: f64 = 150.0;
/// Rounding error by which the guard may pass the safe distance \[m\].
const ROUNDING_M: f64 = 1e-9;

/// Iterations of the solves that time a swarm, and the cycles between two of them.
const TIMED_ITERATIONS: u32 = 8;
const TIMED_EVERY: u64 = 8;

#[derive(Debug, Clone, Copy)]
pub(super) enum Varied {
    /// The time of a solve by the clock, and the duration of an iteration of the swarm \[µs\].
    Budget(u64, f64),
    /// Particles and iterations, without a time limit.
    Swarm(u32, u32),
    /// Prediction steps with separate controls for each, without a time limit.
    Horizon(u32),
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Variant {
    course: Course,
    solver: SolverKind,
    varied: Varied,
    pub(super) settings: NmpcSettings,
}

impl Variant {
    pub(super) fn new(course: Course, solver: SolverKind, varied: Varied) -> Self {
        let mut settings = course.settings();
        settings.solver = solver;
        match varied {
            // The maximum of work, ended by the clock. With Gauss-Newton steps after it, the swarm is limited to
            // half of the budget.
            Varied::Budget(us, iteration_us) => {
                let half = 0.5 * us as f64 / iteration_us;
                settings.swarm_size = BUDGET_SWARM;
                settings.swarm_iterations = match solver {
                    SolverKind::KpsoRefined => half.clamp(1.0, BUDGET_ITERATIONS.into()) as u32,
                    _ => BUDGET_ITERATIONS,
                };
                settings.refinement_steps = BUDGET_REFINEMENTS;
            }
            Varied::Swarm(particles, iterations) => {
                (settings.swarm_size, settings.swarm_iterations) = (particles, iterations);
            }
            Varied::Horizon(steps) => {
                (settings.horizon_steps, settings.control_blocks) = (steps, 0);
            }
        }
        if solver == SolverKind::GaussNewton {
            (settings.swarm_size, settings.swarm_iterations) = (1, 0);
        }
        if solver == SolverKind::Kpso {
            settings.refinement_steps = 0;
        }
        Self {
            course,
            solver,
            varied,
            settings,
        }
    }

    pub(super) fn axis(&self) -> (&'static str, String) {
        match self.varied {
            Varied::Budget(us, _) => ("budget", format!("{us} µs")),
            Varied::Swarm(count, iterations) => ("swarm", format!("{count} x {iterations}")),
            Varied::Horizon(steps) => ("horizon", format!("{steps} steps")),
        }
    }

    fn budget_us(&self) -> Option<u64> {
        match self.varied {
            Varied::Budget(us, _) => Some(us),
            _ => None,
        }
    }

    pub(super) fn words(&self) -> String {
        [self.course.name(), self.solver.name(), &self.axis().1].join(", ")
    }

    pub(super) fn expected_s(&self, cycles: u64) -> f64 {
        let limited_us = self.budget_us().map(|us| AROUND_US + us as f64);
        1e-6 * limited_us.unwrap_or(UNLIMITED_US) * cycles as f64
    }

    pub(super) fn drive(&self, scene: &Scene, seed: u64) -> Result<Value> {
        let mut settings = self.settings;
        settings.seed = seed;
        let mut evaluator = PlanEvaluator::new(scene, settings)?;
        let budget = self.budget_us().map(Duration::from_micros);
        let end = budget.map_or(End::Never, End::After);
        let mut cost = 0.0;
        let run = run_with(scene, settings, end, true, |input, plan| {
            cost += evaluator.cost(input, plan);
        })?;
        let mut times_ns = histogram();
        (run.0.iter()).for_each(|sample| times_ns.saturating_record(sample.solve_ns));
        let count = run.0.len() as f64;
        let near_m = settings.safe_distance_m - ROUNDING_M;
        let below_safe_ms = 1e3 * PERIOD_S * count * run.share(|it| it.clearance_m < near_m);
        let has_obstacles = !scene.obstacles.is_empty();
        let has_swarm = self.solver != SolverKind::GaussNewton;
        let (axis, value) = self.axis();
        Ok(json!({
            "axis": axis,
            "course": self.course,
            "solver": self.solver,
            "value": value,
            "rounds": 1,
            "budget_us": self.budget_us(),
            "swarm": if has_swarm { settings.swarm_size } else { 0 },
            "iterations": settings.swarm_iterations,
            "refinements": settings.refinement_steps,
            "horizon": settings.horizon_steps,
            // 0: one for each step, up to the limit.
            "blocks": settings.control_blocks,
            "mean_error_mm": run.mean_error_mm(),
            "max_error_mm": run.most(Sample::error_mm),
            "min_clearance_mm": has_obstacles.then(|| 1e3 * run.least_clearance_m()),
            "below_safe_ms": has_obstacles.then_some(below_safe_ms),
            "mean_cost": cost / count,
            "cut_short_share": run.share(|sample| sample.cut_short),
            "guarded_share": run.share(|sample| sample.guarded),
            "solve_p50_us": quantile_us(&times_ns, 0.5),
            "solve_p99_us": quantile_us(&times_ns, 0.99),
        }))
    }
}

/// Duration of an iteration of [`BUDGET_SWARM`] particles along a course, on this machine \[µs\].
pub(super) fn iteration_us(course: Course) -> Result<f64> {
    let (scene, mut driving) = (course.scene()?, course.settings());
    let mut timed = driving;
    (driving.solver, timed.solver) = (SolverKind::GaussNewton, SolverKind::Kpso);
    (timed.swarm_size, timed.swarm_iterations) = (BUDGET_SWARM, TIMED_ITERATIONS);
    let (mut driver, mut swarm) = (scene.solver(driving)?, scene.solver(timed)?);
    let mut closed = scene.begin(driving)?;
    let mut times_us = Vec::new();
    while closed.cycle() < scene.cycles {
        if closed.cycle().is_multiple_of(TIMED_EVERY) {
            // From rest there is always an error left, so that no iteration is skipped.
            swarm.forget_plan();
            let (_, report, time) = timed_solve(&mut swarm, &closed.input(), End::Never);
            times_us.push(1e6 * time.as_secs_f64() / f64::from(report.iterations.max(1)));
        }
        closed.step(&mut driver);
    }
    Ok(median(times_us).unwrap_or(1.0))
}
