//! A variant of solver, budget, swarm and horizon, and the result of a course driven with it.

use std::time::Duration;

use anyhow::Result;
use cdcr_controller::nmpc::NmpcSettings;
use cdcr_controller::optimizer::Budget;
use serde_json::{Value, json};

use super::course::Course;
use crate::closed_loop::{End, PERIOD_S, PlanEvaluator, Sample, Scene, timed_solve};
use crate::experiment::Solver;
use crate::metric::median;
use crate::quantiles::{histogram, quantile_us};

pub(super) const SOLVERS: [Solver; 3] = [Solver::Kpso, Solver::GaussNewton, Solver::KpsoRefined];
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
    solver: Solver,
    varied: Varied,
    pub(super) settings: NmpcSettings,
}

impl Variant {
    pub(super) fn new(course: Course, solver: Solver, varied: Varied) -> Self {
        let mut settings = solver.of(course.settings());
        match varied {
            // The maximum of work, ended by the clock. With Gauss-Newton steps after it, the swarm is limited to
            // half of the budget.
            Varied::Budget(us, iteration_us) => {
                let half = 0.5 * us as f64 / iteration_us;
                settings.swarm_size = BUDGET_SWARM;
                settings.swarm_iterations = match solver {
                    Solver::KpsoRefined => half.clamp(1.0, BUDGET_ITERATIONS.into()) as u32,
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
        if solver == Solver::GaussNewton {
            (settings.swarm_size, settings.swarm_iterations) = (1, 0);
        }
        if solver == Solver::Kpso {
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
        let mut nmpc = scene.solver(settings)?;
        let mut evaluator = PlanEvaluator::new(scene, settings)?;
        let mut closed = scene.begin(settings)?;
        // Touches all memory that a solve may need. The seed does not matter, because the plan is forgotten.
        nmpc.solve(&closed.input(), &mut Budget::from_quanta(20));
        nmpc.forget_plan();
        let budget = self.budget_us().map(Duration::from_micros);
        let end = budget.map_or(End::Never, End::After);
        let (mut samples, mut times_ns) = (Vec::new(), histogram());
        let (mut cost, mut cut_short, mut guarded) = (0.0, 0_u64, 0_u64);
        while closed.cycle() < scene.cycles {
            let (desired_rates, report, time) = timed_solve(&mut nmpc, &closed.input(), end);
            times_ns.saturating_record(time.as_nanos() as u64);
            cut_short += u64::from(report.budget_spent);
            cost += evaluator.cost(&closed.input(), nmpc.plan());
            closed.advance(&desired_rates);
            guarded += u64::from(closed.command().clearance_hit);
            samples.push(scene.sample(&closed, time));
        }
        let count = samples.len() as f64;
        let errors_mm = || samples.iter().map(Sample::error_mm);
        let clearances_m = || samples.iter().map(|sample| sample.clearance_m);
        let below_safe = clearances_m().filter(|m| *m < settings.safe_distance_m - ROUNDING_M);
        let below_safe_ms = 1e3 * PERIOD_S * below_safe.count() as f64;
        let least_m = clearances_m().fold(f64::INFINITY, f64::min);
        let has_obstacles = !scene.obstacles.is_empty();
        let has_swarm = self.solver != Solver::GaussNewton;
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
            "mean_error_mm": errors_mm().sum::<f64>() / count,
            "max_error_mm": errors_mm().fold(0.0, f64::max),
            "min_clearance_mm": has_obstacles.then_some(1e3 * least_m),
            "below_safe_ms": has_obstacles.then_some(below_safe_ms),
            "mean_cost": cost / count,
            "cut_short_share": cut_short as f64 / count,
            "guarded_share": guarded as f64 / count,
            "solve_p50_us": quantile_us(&times_ns, 0.5),
            "solve_p99_us": quantile_us(&times_ns, 0.99),
        }))
    }
}

/// Duration of an iteration of [`BUDGET_SWARM`] particles along a course, on this machine \[µs\].
pub(super) fn iteration_us(course: Course) -> Result<f64> {
    let scene = course.scene()?;
    let driving = Solver::GaussNewton.of(course.settings());
    let mut timed = Solver::Kpso.of(course.settings());
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

#[cfg(test)]
mod tests {
    use super::*;

    fn drive(variant: Variant, cycles: u64, seed: u64) -> impl Fn(&str) -> f64 {
        let scene = variant.course.scene().unwrap().at_most(cycles);
        let row = variant.drive(&scene, seed).unwrap();
        println!("{row}");
        move |key| row[key].as_f64().unwrap_or(f64::NAN)
    }

    #[test]
    fn with_enough_time_the_tip_arrives_and_the_body_keeps_clear() {
        // Far more work than fits into a cycle of 5 ms; the same bits on every machine.
        let run = |course, seed| {
            let mut variant = Variant::new(course, Solver::KpsoRefined, Varied::Swarm(32, 50));
            variant.settings.refinement_steps = 20;
            drive(variant, u64::MAX, seed)
        };
        let mut max_mm = 0.0;
        for seed in 1..=5 {
            let of = run(Course::Gap, seed);
            assert!(of("mean_error_mm") < 1.0 && of("below_safe_ms") == 0.0);
            // The gap was as narrow as intended.
            assert!(of("min_clearance_mm") < 14.0);
            max_mm += of("max_error_mm") / 5.0;
        }
        assert!(max_mm < 5.0, "{max_mm}");
        let of = run(Course::Crossing, 1);
        assert!(of("mean_error_mm") < 6.0 && of("max_error_mm") < 25.0);
        // The ball came as near as allowed.
        assert!(of("below_safe_ms") == 0.0 && of("min_clearance_mm") < 11.0);
        let of = run(Course::Jump, 1);
        // No robot can follow the jump at once.
        assert!(of("max_error_mm") > 50.0 && of("mean_error_mm") < 15.0);
        assert!(of("min_clearance_mm").is_nan());
    }

    #[test]
    fn without_any_time_the_robot_stays_where_it_is() {
        let run = |course, cycles| {
            let variant = Variant::new(course, Solver::KpsoRefined, Varied::Budget(0, 1.0));
            drive(variant, cycles, 1)
        };
        let of = run(Course::Jump, 60);
        assert_eq!(of("cut_short_share"), 1.0);
        let scene = Course::Jump.scene().unwrap();
        let jump_mm = 1e3 * (scene.point_m(60) - scene.point_m(0)).norm();
        assert!((of("max_error_mm") - jump_mm).abs() < 1e-9);
        // The plan is evaluated even without any iteration of the solver.
        assert!(of("mean_cost").is_finite() && of("mean_cost") > 0.0);
        // A ball moves into the robot.
        let of = run(Course::Crossing, u64::MAX);
        assert!(of("min_clearance_mm") < 0.0 && of("below_safe_ms") > 100.0);
    }
}
