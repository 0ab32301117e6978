//! Several ways for a new plan among obstacles: multi-start with successive elimination. A *way* is a plan
//! that passes each obstacle on a chosen side. A *batch* starts several ways with rough steps, and continues
//! with the best of them.

use core::f64::consts::PI;

use super::obstacles::Obstacles;
use super::problem::TrackingProblem;
use super::solver::{SolveTask, Solver};
use crate::optimizer::{Budget, GaussNewtonOutcome, GaussNewtonSettings, Problem, cycle_seed};
use crate::robot::COORDINATES_MAX;

/// Ways started in a batch.
pub(super) const WAYS: usize = 4;
/// Largest number of batches.
const BATCHES_MAX: u64 = 3;
/// Rough steps of each way in a round of a batch.
const ROUND_STEPS: u32 = 2;
/// Initial deviation of a way from the free plan in each batch, as a share of the largest rates. None: the way
/// starts from a random plan instead.
const DEVIATION_SHARES: [Option<f64>; BATCHES_MAX as usize] = [Some(0.5), None, Some(1.0)];
/// Separates the random numbers of plans from those of sides.
const RANDOM_PLAN: u64 = 77;

impl Solver {
    /// Refines the incumbent with rough steps, and competes with other ways. These are the free plan, which
    /// ignores the obstacles, and plans that first deviate from it to a random side and then return. The best
    /// becomes the incumbent and is refined to the end.
    pub(super) fn multi_start(
        &mut self,
        task: &SolveTask,
        warm_plan: &[f64],
        budget: &mut Budget<'_>,
    ) -> GaussNewtonOutcome {
        let refined = self.refine_with(
            task.problem,
            task.bounds,
            &rough_settings(task, ROUND_STEPS),
            budget,
        );
        if refined.converged || !self.has_tracking_error(task) {
            return refined;
        }
        let is_free_plan_clear = self.plan_without_obstacles(task, warm_plan, budget);
        for batch in 0..if is_free_plan_clear { 1 } else { BATCHES_MAX } {
            if budget.begin_quantum() && self.has_tracking_error(task) {
                self.run_batch(task, batch, is_free_plan_clear, budget);
            }
        }
        if budget.begin_quantum() {
            self.refine(task, budget)
        } else {
            refined
        }
    }

    /// Plans without obstacles. Returns whether that plan keeps clear of all obstacles.
    fn plan_without_obstacles(
        &mut self,
        task: &SolveTask,
        warm_plan: &[f64],
        budget: &mut Budget<'_>,
    ) -> bool {
        let nothing = Obstacles::none();
        let free = task.problem.with_obstacles(&nothing);
        let way = &mut self.ways[0];
        let evaluation = free.evaluate_at(warm_plan, budget);
        way.restart(warm_plan, evaluation.as_ref());
        let settings = rough_settings(task, task.settings.refinement_steps);
        self.refine_way(0, &free, task, &settings, budget);
        let way = &mut self.ways[0];
        self.free_plan.clear();
        self.free_plan.extend_from_slice(way.z());
        let evaluation = task.problem.evaluate_at(&self.free_plan, budget);
        self.incumbent.count_evaluations(way.evaluations() as usize);
        way.restart(&self.free_plan, evaluation.as_ref());
        evaluation.is_some() && !way.is_violated()
    }

    /// Starts all ways, continues with the better half, and refines the best one. In the first batch the
    /// incumbent and the free plan take part; if the free plan keeps clear of all obstacles, only these two.
    /// The incumbent's memory then holds a plan of an earlier solve, which is not read.
    fn run_batch(
        &mut self,
        task: &SolveTask,
        batch: u64,
        is_free_plan_clear: bool,
        budget: &mut Budget<'_>,
    ) {
        let round = rough_settings(task, ROUND_STEPS);
        let is_first = batch == 0;
        if is_first {
            // The free plan becomes the second way.
            self.ways.swap(0, 1);
            core::mem::swap(&mut self.incumbent, &mut self.ways[0]);
        }
        for way in 0..WAYS {
            if is_free_plan_clear && way > 1 {
                // A way without a cost is sorted last.
                self.ways[way].restart(&self.free_plan, None);
                continue;
            }
            if !is_first || way > 1 {
                self.start_way(task, batch, way, budget);
            }
            if !is_first || way > 0 {
                self.refine_way(way, task.problem, task, &round, budget);
            }
        }
        self.ways
            .sort_unstable_by(|a, b| a.cost().total_cmp(&b.cost()));
        for way in 0..WAYS / 2 {
            self.refine_way(way, task.problem, task, &round, budget);
        }
        if self.ways[1].cost() < self.ways[0].cost() {
            self.ways.swap(0, 1);
        }
        let settings = rough_settings(task, task.settings.refinement_steps);
        self.refine_way(0, task.problem, task, &settings, budget);
        if is_first {
            core::mem::swap(&mut self.incumbent, &mut self.ways[0]);
        }
        for way in &self.ways[usize::from(is_first)..] {
            self.incumbent.take_better(way);
        }
    }

    /// Starts a way beside the free plan: to a random side, and each second one to the opposite side. Or from a
    /// random plan, and each second one from the opposite plan.
    fn start_way(&mut self, task: &SolveTask, batch: u64, way: usize, budget: &mut Budget<'_>) {
        let width = task.problem.motion.width();
        let mut direction = [0.0; COORDINATES_MAX];
        let direction = &mut direction[..width];
        let seed = cycle_seed(task.seed, 2 * batch + way as u64 / 2);
        for (i, component) in (0..).zip(&mut *direction) {
            *component = random_share(seed, i);
        }
        let norm = direction.iter().map(|c| c * c).sum::<f64>().sqrt();
        let sign = if way.is_multiple_of(2) { 1.0 } else { -1.0 };
        let share = DEVIATION_SHARES[batch as usize];
        let size = sign * share.unwrap_or_default() / f64::max(norm, f64::MIN_POSITIVE);
        let plan_seed = cycle_seed(seed, RANDOM_PLAN);
        let blocks = (self.free_plan.len() / width) as f64;
        self.scratch.clear();
        for (i, rate) in self.free_plan.iter().enumerate() {
            let largest = task.bounds.upper()[i];
            self.scratch.push(if share.is_some() {
                // Deviates in the first half and returns in the second.
                let phase = PI * ((i / width) as f64 + 0.5) / blocks;
                let deviation = size * direction[i % width] * largest;
                rate + deviation * phase.cos()
            } else {
                sign * random_share(plan_seed, i as u64) * largest
            });
        }
        task.bounds.project(&mut self.scratch);
        let evaluation = task.problem.evaluate_at(&self.scratch, budget);
        self.ways[way].restart(&self.scratch, evaluation.as_ref());
    }

    fn refine_way(
        &mut self,
        way: usize,
        problem: &TrackingProblem,
        task: &SolveTask,
        settings: &GaussNewtonSettings,
        budget: &mut Budget<'_>,
    ) {
        let incumbent = &mut self.ways[way];
        self.gauss_newton
            .refine(problem, task.bounds, settings, budget, incumbent);
    }
}

/// A random number from -1 to 1.
fn random_share(seed: u64, number: u64) -> f64 {
    cycle_seed(seed, number) as f64 / (u64::MAX / 2) as f64 - 1.0
}

/// Settings for a number of rough steps.
fn rough_settings(task: &SolveTask, steps: u32) -> GaussNewtonSettings {
    GaussNewtonSettings {
        steps,
        is_rough: true,
        ..task.settings.gauss_newton()
    }
}
