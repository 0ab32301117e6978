//! One course driven once: what came of it.

use std::time::{Duration, Instant};

use anyhow::Result;
use cdcr_controller::nmpc::Nmpc;
use cdcr_controller::optimizer::Budget;
use serde::Serialize;

use super::variant::Variant;
use crate::closed_loop::{ClosedLoop, PlanEvaluator, Sample};
use crate::quantiles::{histogram, quantile_us};
use crate::scene::Scene;

/// What the guard lets through may be nearer than the safe distance by rounding \[m\].
const ROUNDING_M: f64 = 1e-9;

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RunMetrics {
    pub mean_error_mm: f64,
    pub max_error_mm: f64,
    /// Smallest clearance of the body \[mm\]; none without obstacles.
    pub min_clearance_mm: Option<f64>,
    /// Time below the safe distance \[ms\]; none without obstacles.
    pub below_safe_ms: Option<f64>,
    /// Mean cost of the plans that were chosen, evaluated afterwards.
    pub mean_cost: f64,
    /// Share of the solves that the budget ended.
    pub cut_short_share: f64,
    /// Share of the cycles in which the clearance guard changed the command.
    pub guarded_share: f64,
    pub solve_p50_us: f64,
    pub solve_p99_us: f64,
}

pub fn drive(variant: &Variant, scene: &Scene, seed: u64) -> Result<RunMetrics> {
    let (mut samples, mut cost, mut cut_short, mut guarded) = (Vec::new(), 0.0, 0_u64, 0_u64);
    let settings = variant.settings(seed);
    let mut nmpc = Nmpc::new(scene.robot.clone(), scene.period_s, settings)?;
    let mut evaluator = PlanEvaluator::new(scene, settings)?;
    let mut closed = ClosedLoop::new(scene, settings)?;
    // Touches all memory that a solve may need; a seed decides nothing of a plan that is forgotten.
    nmpc.solve(&closed.input(), &mut Budget::of_quanta(20));
    nmpc.forget_plan();
    let budget = variant.budget_us.map(Duration::from_micros);
    while !closed.is_over() {
        let begin = Instant::now();
        let mut is_spent = || budget.is_some_and(|budget| begin.elapsed() >= budget);
        let (desired_rates, report) = nmpc.solve(&closed.input(), &mut Budget::new(&mut is_spent));
        let solve_ns = begin.elapsed().as_nanos() as u64;
        cut_short += u64::from(report.budget_spent);
        cost += evaluator.cost(&closed.input(), nmpc.plan());
        closed.advance(&desired_rates);
        guarded += u64::from(closed.command().clearance_hit);
        samples.push(closed.sample(solve_ns));
    }
    let count = samples.len() as f64;
    let errors_mm = || samples.iter().map(Sample::error_mm);
    let clearances_m = || samples.iter().map(|sample| sample.clearance_m);
    let below_safe = clearances_m().filter(|m| *m < settings.safe_distance_m - ROUNDING_M);
    let has_obstacles = !scene.obstacles.is_empty();
    let mut solve_ns = histogram()?;
    for sample in &samples {
        solve_ns.saturating_record(sample.solve_ns);
    }
    Ok(RunMetrics {
        mean_error_mm: errors_mm().sum::<f64>() / count,
        max_error_mm: errors_mm().fold(0.0, f64::max),
        min_clearance_mm: has_obstacles.then(|| 1e3 * clearances_m().fold(f64::INFINITY, f64::min)),
        below_safe_ms: has_obstacles.then(|| 1e3 * scene.period_s * below_safe.count() as f64),
        mean_cost: cost / count,
        cut_short_share: cut_short as f64 / count,
        guarded_share: guarded as f64 / count,
        solve_p50_us: quantile_us(&solve_ns, 0.5),
        solve_p99_us: quantile_us(&solve_ns, 0.99),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::Solver;
    use crate::quality::course::Course;

    /// Far more work than a cycle of 5 ms leaves time for; the same bits on every machine.
    fn long(course: Course) -> RunMetrics {
        long_of(course, 1)
    }

    fn long_of(course: Course, seed: u64) -> RunMetrics {
        let variant = Variant {
            refinements: 20,
            ..Variant::swarm(course, Solver::KpsoRefined, (32, 50))
        };
        drive(&variant, &course.scene().unwrap(), seed).unwrap()
    }

    #[test]
    fn enough_time_gets_the_tip_through_the_gap() {
        let mut max_mm = 0.0;
        for seed in 1..=5 {
            let metrics = long_of(Course::Gap, seed);
            assert!(metrics.mean_error_mm < 1.0, "{metrics:?}");
            assert_eq!(metrics.below_safe_ms, Some(0.0), "{metrics:?}");
            // It was as narrow as it was meant to be.
            assert!(metrics.min_clearance_mm.unwrap() < 14.0, "{metrics:?}");
            max_mm += metrics.max_error_mm / 5.0;
        }
        assert!(max_mm < 5.0, "{max_mm}");
    }

    #[test]
    fn enough_time_makes_room_for_the_ball_and_keeps_the_tip_near_its_line() {
        let metrics = long(Course::Crossing);
        assert!(metrics.mean_error_mm < 6.0, "{metrics:?}");
        assert!(metrics.max_error_mm < 25.0, "{metrics:?}");
        assert_eq!(metrics.below_safe_ms, Some(0.0), "{metrics:?}");
        // The ball came as near as it is let.
        assert!(metrics.min_clearance_mm.unwrap() < 11.0, "{metrics:?}");
    }

    #[test]
    fn after_a_jump_the_tip_arrives() {
        let metrics = long(Course::Jump);
        // Nobody can be there at once.
        assert!(metrics.max_error_mm > 50.0, "{metrics:?}");
        assert!(metrics.mean_error_mm < 15.0, "{metrics:?}");
        assert_eq!(metrics.min_clearance_mm, None);
    }

    #[test]
    fn without_any_time_the_robot_stays_and_every_solve_is_cut_short() {
        let variant = Variant {
            budget_us: Some(0),
            ..Variant::swarm(Course::Jump, Solver::KpsoRefined, (6, 30))
        };
        let scene = Course::Jump.scene().unwrap().at_most(60);
        let metrics = drive(&variant, &scene, 1).unwrap();
        assert_eq!(metrics.cut_short_share, 1.0);
        let jump_mm = 1e3 * (scene.point_m(60) - scene.point_m(0)).norm();
        assert!((metrics.max_error_mm - jump_mm).abs() < 1e-9, "{metrics:?}");
        // The plan is evaluated even if the solver did not come to it.
        assert!(metrics.mean_cost.is_finite() && metrics.mean_cost > 0.0);
    }

    #[test]
    fn a_ball_runs_into_a_robot_that_has_no_time_to_make_room() {
        let variant = Variant {
            budget_us: Some(0),
            ..Variant::swarm(Course::Crossing, Solver::KpsoRefined, (6, 30))
        };
        let metrics = drive(&variant, &Course::Crossing.scene().unwrap(), 1).unwrap();
        assert!(metrics.min_clearance_mm.unwrap() < 0.0, "{metrics:?}");
        assert!(metrics.below_safe_ms.unwrap() > 100.0, "{metrics:?}");
    }
}
