//! A variant of solver, budget, swarm and horizon, and the result of a course driven with it.

use std::time::Duration;

use anyhow::Result;
use cdcr_controller::nmpc::{Nmpc, NmpcSettings};
use cdcr_controller::optimizer::Budget;
use serde_json::{Value, json};

use super::course::Course;
use crate::closed_loop::{ClosedLoop, End, PlanEvaluator, Sample, timed_solve};
use crate::experiment::Solver;
use crate::metric::median;
use crate::named::named;
use crate::quantiles::{histogram, quantile_us};
use crate::scene::Scene;

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

named! {
    pub(super) enum Axis {
        /// The time of a solve by the clock.
        Budget = "budget",
        /// Particles and iterations, without a time limit.
        Swarm = "swarm",
        /// Prediction steps, without a time limit.
        Horizon = "horizon",
    }
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Variant {
    axis: Axis,
    course: Course,
    solver: Solver,
    /// Budget of a solve \[µs\]; `None`: unlimited.
    budget_us: Option<u64>,
    pub(super) settings: NmpcSettings,
}

impl Variant {
    fn new(
        axis: Axis,
        course: Course,
        solver: Solver,
        change: impl FnOnce(&mut NmpcSettings),
    ) -> Self {
        let mut settings = solver.of(course.settings());
        change(&mut settings);
        if solver == Solver::GaussNewton {
            (settings.swarm_size, settings.swarm_iterations) = (1, 0);
        }
        if solver == Solver::Kpso {
            settings.refinement_steps = 0;
        }
        Self {
            axis,
            course,
            solver,
            budget_us: None,
            settings,
        }
    }

    /// The maximum of work, ended by the clock. With Gauss-Newton steps after it, the swarm is limited to
    /// half of the budget, by the duration `iteration_us` of an iteration.
    pub(super) fn timed(course: Course, solver: Solver, budget_us: u64, iteration_us: f64) -> Self {
        let half = 0.5 * budget_us as f64 / iteration_us;
        let variant = Self::new(Axis::Budget, course, solver, |settings| {
            settings.swarm_size = BUDGET_SWARM;
            settings.swarm_iterations = match solver {
                Solver::KpsoRefined => half.clamp(1.0, BUDGET_ITERATIONS.into()) as u32,
                _ => BUDGET_ITERATIONS,
            };
            settings.refinement_steps = BUDGET_REFINEMENTS;
        });
        Self {
            budget_us: Some(budget_us),
            ..variant
        }
    }

    pub(super) fn swarm(course: Course, solver: Solver, swarm: (u32, u32)) -> Self {
        Self::new(Axis::Swarm, course, solver, |settings| {
            (settings.swarm_size, settings.swarm_iterations) = swarm;
        })
    }

    /// With `steps` prediction steps and separate controls for each.
    pub(super) fn horizon(course: Course, solver: Solver, steps: u32) -> Self {
        Self::new(Axis::Horizon, course, solver, |settings| {
            (settings.horizon_steps, settings.control_blocks) = (steps, 0);
        })
    }

    pub(super) fn axis(&self) -> Axis {
        self.axis
    }

    fn value(&self) -> String {
        let settings = &self.settings;
        match (self.axis, self.budget_us) {
            (Axis::Budget, Some(us)) => format!("{us} µs"),
            (Axis::Swarm, _) => format!("{} x {}", settings.swarm_size, settings.swarm_iterations),
            _ => format!("{} steps", settings.horizon_steps),
        }
    }

    pub(super) fn words(&self) -> String {
        [self.course.name(), self.solver.name(), &self.value()].join(", ")
    }

    /// Expected duration of a run of `cycles` cycles, with all work around it \[s\].
    pub(super) fn expected_s(&self, cycles: u64) -> f64 {
        let us = self
            .budget_us
            .map_or(UNLIMITED_US, |us| AROUND_US + us as f64);
        1e-6 * us * cycles as f64
    }

    /// Drives a scene once and returns its row.
    pub(super) fn drive(&self, scene: &Scene, seed: u64) -> Result<Value> {
        let (mut samples, mut cost) = (Vec::new(), 0.0);
        let (mut cut_short, mut guarded) = (0_u64, 0_u64);
        let settings = NmpcSettings {
            seed,
            ..self.settings
        };
        let mut nmpc = Nmpc::new(scene.robot.clone(), scene.period_s, settings)?;
        let mut evaluator = PlanEvaluator::new(scene, settings)?;
        let mut closed = ClosedLoop::new(scene, settings)?;
        // Touches all memory that a solve may need. The seed does not matter, because the plan is forgotten.
        nmpc.solve(&closed.input(), &mut Budget::of_quanta(20));
        nmpc.forget_plan();
        let budget = self.budget_us.map(Duration::from_micros);
        let mut times_ns = histogram()?;
        while !closed.is_over() {
            let end = budget.map_or(End::Never, End::After);
            let (desired_rates, report, time) = timed_solve(&mut nmpc, &closed.input(), end);
            times_ns.saturating_record(time.as_nanos() as u64);
            cut_short += u64::from(report.budget_spent);
            cost += evaluator.cost(&closed.input(), nmpc.plan());
            closed.advance(&desired_rates);
            guarded += u64::from(closed.command().clearance_hit);
            samples.push(closed.sample(time));
        }
        let count = samples.len() as f64;
        let errors_mm = || samples.iter().map(Sample::error_mm);
        let clearances_m = || samples.iter().map(|sample| sample.clearance_m);
        let below_safe = clearances_m().filter(|m| *m < settings.safe_distance_m - ROUNDING_M);
        let has_obstacles = !scene.obstacles.is_empty();
        let least_m = clearances_m().fold(f64::INFINITY, f64::min);
        let below_safe_ms = 1e3 * scene.period_s * below_safe.count() as f64;
        let swarm = match self.solver {
            Solver::GaussNewton => 0,
            _ => settings.swarm_size,
        };
        Ok(json!({
            "axis": self.axis,
            "course": self.course,
            "solver": self.solver,
            "value": self.value(),
            "rounds": 1,
            "budget_us": self.budget_us,
            "swarm": swarm,
            "iterations": settings.swarm_iterations,
            "refinements": settings.refinement_steps,
            "horizon": settings.horizon_steps,
            // 0: one for each step, up to the limit.
            "blocks": settings.control_blocks,
            "mean_error_mm": errors_mm().sum::<f64>() / count,
            "max_error_mm": errors_mm().fold(0.0, f64::max),
            // Least clearance of the body, and time below the safe distance; null without obstacles.
            "min_clearance_mm": has_obstacles.then_some(1e3 * least_m),
            "below_safe_ms": has_obstacles.then_some(below_safe_ms),
            // Mean cost of the chosen plans, evaluated afterwards.
            "mean_cost": cost / count,
            // Share of the solves that the budget ended.
            "cut_short_share": cut_short as f64 / count,
            // Share of the cycles in which the clearance guard changed the command.
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
    let timed = NmpcSettings {
        swarm_size: BUDGET_SWARM,
        swarm_iterations: TIMED_ITERATIONS,
        ..Solver::Kpso.of(course.settings())
    };
    let mut driver = Nmpc::new(scene.robot.clone(), scene.period_s, driving)?;
    let mut swarm = Nmpc::new(scene.robot.clone(), scene.period_s, timed)?;
    let mut closed = ClosedLoop::new(&scene, driving)?;
    let mut times_us = Vec::new();
    while !closed.is_over() {
        if closed.cycle().is_multiple_of(TIMED_EVERY) {
            // From rest there is always an error left, so that no iteration is skipped.
            swarm.forget_plan();
            let (_, report, time) = timed_solve(&mut swarm, &closed.input(), End::Never);
            times_us.push(1e6 * time.as_secs_f64() / f64::from(report.iterations.max(1)));
        }
        let (desired_rates, _) = driver.solve(&closed.input(), &mut Budget::unlimited());
        closed.advance(&desired_rates);
    }
    Ok(median(times_us).unwrap_or(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Far more work than fits into a cycle of 5 ms; the same bits on every machine.
    fn with_enough_time(course: Course) -> Variant {
        let mut variant = Variant::swarm(course, Solver::KpsoRefined, (32, 50));
        variant.settings.refinement_steps = 20;
        variant
    }

    fn with_no_time(course: Course) -> Variant {
        Variant {
            budget_us: Some(0),
            ..Variant::swarm(course, Solver::KpsoRefined, (6, 30))
        }
    }

    /// The numbers of a run by their keys; NaN if missing.
    fn drive(variant: Variant, cycles: u64, seed: u64) -> impl Fn(&str) -> f64 {
        let scene = variant.course.scene().unwrap().at_most(cycles);
        let row = variant.drive(&scene, seed).unwrap();
        println!("{row}");
        move |key| row[key].as_f64().unwrap_or(f64::NAN)
    }

    #[test]
    fn with_enough_time_the_tip_arrives_and_the_body_keeps_clear() {
        let mut max_mm = 0.0;
        for seed in 1..=5 {
            let of = drive(with_enough_time(Course::Gap), u64::MAX, seed);
            assert!(of("mean_error_mm") < 1.0 && of("below_safe_ms") == 0.0);
            // The gap was as narrow as intended.
            assert!(of("min_clearance_mm") < 14.0);
            max_mm += of("max_error_mm") / 5.0;
        }
        assert!(max_mm < 5.0, "{max_mm}");
        let of = drive(with_enough_time(Course::Crossing), u64::MAX, 1);
        assert!(of("mean_error_mm") < 6.0 && of("max_error_mm") < 25.0);
        // The ball came as near as allowed.
        assert!(of("below_safe_ms") == 0.0 && of("min_clearance_mm") < 11.0);
        let of = drive(with_enough_time(Course::Jump), u64::MAX, 1);
        // No robot can follow the jump at once.
        assert!(of("max_error_mm") > 50.0 && of("mean_error_mm") < 15.0);
        assert!(of("min_clearance_mm").is_nan());
    }

    #[test]
    fn without_any_time_the_robot_stays_where_it_is() {
        let of = drive(with_no_time(Course::Jump), 60, 1);
        assert_eq!(of("cut_short_share"), 1.0);
        let scene = Course::Jump.scene().unwrap();
        let jump_mm = 1e3 * (scene.point_m(60) - scene.point_m(0)).norm();
        assert!((of("max_error_mm") - jump_mm).abs() < 1e-9);
        // The plan is evaluated even without any iteration of the solver.
        assert!(of("mean_cost").is_finite() && of("mean_cost") > 0.0);
        // A ball moves into the robot.
        let of = drive(with_no_time(Course::Crossing), u64::MAX, 1);
        assert!(of("min_clearance_mm") < 0.0 && of("below_safe_ms") > 100.0);
    }
}
