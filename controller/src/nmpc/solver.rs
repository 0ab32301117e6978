//! The sequence of knowledge, swarm and Gauss-Newton for one problem.

use super::knowledge::Knowledge;
use super::motion::{ANGLES, VECTORS};
use super::problem::{PositionOnly, SwarmCost, TrackingProblem};
use super::ways::WAYS;
use super::{Coordinates, HORIZON_STEPS_MAX, NmpcSettings, SWARM_MAX, SolveReport};
use crate::optimizer::{
    self, Bounds, Budget, Candidate, Cost, Evaluation, GaussNewton, GaussNewtonOutcome,
    GaussNewtonSettings, Incumbent, Kpso, Problem, Simd,
};

/// Largest number of residuals of one step: position, and three axes of the tip.
const POSE_ROWS: usize = 12;
/// Largest number of constraints in a Gauss-Newton step. It contains the limits and clearances with the least
/// slack, half of the places for each kind if both need them. The others count only in the cost.
pub(super) const CONSTRAINTS_MAX: usize = 256;

/// A swarm search ended by the budget leaves noise in the rates, which the next cycle has to remove. Its plan
/// is used only if it costs less than this share of the refined plan.
const INTERRUPTED_COST_SHARE: f64 = 0.5;

/// Additional steps for a new staged plan. They cost less than the search that an error would start.
const NEW_PLAN_STEPS: u32 = 3;

/// An error is late if this part of the horizon, a quarter of the steps,
const EARLY_PART: usize = 4;
/// costs at most this share of the plan.
const EARLY_SHARE: f64 = 0.1;
/// Shortest horizon with late errors and a limit on work, as with foresight.
const LONG_STEPS_MIN: usize = 16;

/// Largest work on a long plan in quanta per unknown, and one more for every eight obstacles within reach, at least
/// one: the 99th percentile of a robot with three sections among 16 obstacles is then 0.8 ms of counted work.
const QUANTA_PER_UNKNOWN: f64 = 2.4;
/// Multiple of this work that a solver which searches may do: 1.8 ms of counted work.
const SEARCH_SHARE: f64 = 2.3;

/// One optimal control problem with its box and settings.
#[derive(Clone, Copy)]
pub(super) struct SolveTask<'a> {
    pub problem: &'a TrackingProblem<'a>,
    pub bounds: &'a Bounds,
    pub settings: &'a NmpcSettings,
    pub seed: u64,
}

impl SolveTask<'_> {
    /// Whether the plan is long, with separate rates at every step.
    fn is_long(&self) -> bool {
        self.problem.steps() >= LONG_STEPS_MIN
            && self.problem.is_staged()
            && self.problem.has_step_rates()
    }

    /// Whether the plan is long and continues that of the last cycle.
    pub(super) fn continues(&self, warm_plan: &[f64]) -> bool {
        self.is_long() && warm_plan.iter().any(|rate| *rate != 0.0)
    }

    /// Largest number of quanta of a refining solve that continues a long plan, and of one that has found a plan of zero
    /// cost. More steps gain little: the next cycle continues from this plan and knows one step more of the
    /// reference.
    pub(super) fn quanta_max(&self) -> u32 {
        let solver = self.settings.solver;
        if !solver.refines() || !self.is_long() {
            return u32::MAX;
        }
        let obstacles = f64::from(self.problem.reachable_obstacles());
        let per_unknown = QUANTA_PER_UNKNOWN + f64::max(obstacles / 8.0, 1.0);
        let share = if solver.searches() { SEARCH_SHARE } else { 1.0 };
        (share * per_unknown * self.problem.dimension() as f64) as u32
    }
}

/// Solvers that share one incumbent. The constructor allocates memory for the largest problem.
#[derive(Debug)]
pub(super) struct Solver {
    knowledge: Knowledge,
    swarm: Kpso,
    pub(super) gauss_newton: GaussNewton,
    pub(super) incumbent: Incumbent,
    /// Result of a second search from the same warm start.
    pub(super) alternative: Incumbent,
    /// The warm start with zero rates from the block on that would violate a constraint.
    rest_plan: Incumbent,
    pub(super) ways: [Incumbent; WAYS],
    /// The refined plan without obstacles.
    pub(super) free_plan: Vec<f64>,
    pub(super) scratch: Vec<f64>,
}

impl Solver {
    /// Allocates memory for plans of `unknowns`, and of `tied` where the change of rates has a weight.
    pub(super) fn with_capacity(simd: Simd, unknowns: usize, tied: usize) -> Self {
        let rows = POSE_ROWS * HORIZON_STEPS_MAX + tied;
        Self {
            knowledge: Knowledge::with_capacity(unknowns),
            swarm: Kpso::with_capacity(simd, SWARM_MAX, unknowns),
            gauss_newton: GaussNewton::with_capacity(simd, unknowns, tied, rows, CONSTRAINTS_MAX),
            incumbent: Incumbent::with_capacity(unknowns),
            alternative: Incumbent::with_capacity(unknowns),
            rest_plan: Incumbent::with_capacity(unknowns),
            ways: core::array::from_fn(|_| Incumbent::with_capacity(unknowns)),
            free_plan: Vec::with_capacity(unknowns),
            scratch: Vec::with_capacity(unknowns),
        }
    }

    pub(super) fn simd(&self) -> Simd {
        self.swarm.simd()
    }

    /// The best plan of the last solve.
    pub(super) fn best(&self) -> &[f64] {
        self.incumbent.z()
    }

    /// Whether the cost of the best plan is known; false if the budget ended before.
    pub(super) fn is_evaluated(&self) -> bool {
        self.incumbent.is_evaluated()
    }

    /// Starts from `warm_plan` and improves it while the budget lasts.
    pub(super) fn solve(
        &mut self,
        task: &SolveTask,
        warm_plan: &[f64],
        budget: &mut Budget<'_>,
    ) -> SolveReport {
        let refines = task.settings.solver.refines();
        let stages = refines && task.problem.is_staged();
        let (evaluation, has_rest_plan) = if stages {
            self.evaluate_with_rest_plan(task, warm_plan, budget)
        } else if task.problem.is_position_only() {
            let evaluation = task.problem.evaluate_residuals(warm_plan, &mut [], budget);
            (evaluation, false)
        } else {
            (task.problem.evaluate_at(warm_plan, budget), false)
        };
        self.incumbent.restart(warm_plan, evaluation.as_ref());
        let warm_cost = self.incumbent.cost();

        let mut refinement = None;
        let mut iterations = 0;
        if task.problem.has_reference() && budget.begin_quantum() {
            let searches = task.settings.solver.searches();
            let mut is_knowledge_evaluated = false;
            // A refinement is cheap, so it precedes everything else.
            if refines {
                is_knowledge_evaluated = self.incumbent.is_violated();
                if is_knowledge_evaluated {
                    self.knowledge.collect(task.problem, task.bounds, warm_plan);
                }
                // A shifted plan stays on its way past the obstacles.
                let is_new = stages && warm_plan.iter().all(|rate| *rate == 0.0);
                let is_rough = searches && is_new && task.problem.has_reachable_obstacles();
                refinement = if is_rough && !is_knowledge_evaluated {
                    Some(self.multi_start(task, warm_plan, budget))
                } else {
                    self.refine_warm_start(task, is_new, evaluation.as_ref(), budget)
                };
            }
            let refined_cost = refinement.map(|_| self.incumbent.cost());
            let has_tracking_error = self.has_tracking_error(task);
            // After convergence there is nothing better nearby; without an error there is nothing better
            // elsewhere.
            let is_done =
                !has_tracking_error && refinement.is_some_and(|refined| refined.converged);
            if !(is_done || is_knowledge_evaluated) {
                self.knowledge.collect(task.problem, task.bounds, warm_plan);
            }
            let is_late =
                searches && refinement.is_some() && self.error_is_late(task, warm_plan, budget);
            if is_late {
                // A later cycle searches if the error stays until it is near.
            } else if searches && refinement.is_some() && has_tracking_error {
                (iterations, refinement) = self.search_from_warm_start(
                    task,
                    (warm_plan, evaluation.as_ref()),
                    refinement,
                    budget,
                );
            } else if searches && !is_done {
                iterations = self.search(task, refinement, budget);
            } else if !(searches || is_knowledge_evaluated || is_done)
                && self.incumbent.cost() > task.settings.cost_tolerance()
            {
                self.knowledge
                    .evaluate(task.problem, budget, &mut self.incumbent);
            }
            let is_new = refined_cost != Some(self.incumbent.cost());
            if refines && is_new {
                refinement = Some(self.refine(task, budget));
            }
            // A search has already tried the escape directions at its start.
            if refines
                && (is_new || is_late || !searches)
                && refinement.is_some_and(|refinement| refinement.is_stationary)
                && self.escape_stationary_point(task, budget)
            {
                refinement = Some(self.refine(task, budget));
            }
        }
        if has_rest_plan {
            self.incumbent.take_better(&self.rest_plan);
        }
        let refinement = refinement.unwrap_or_default();
        SolveReport {
            warm_cost,
            gradient_norm: refinement.gradient_norm,
            quanta: budget.quanta(),
            iterations,
            refinements: refinement.accepted,
            seed: task.seed,
            ..SolveReport::from_incumbent(
                &self.incumbent,
                task.settings,
                &refinement,
                budget.is_whole_spent(),
            )
        }
    }

    /// Evaluates the warm start. It may violate a constraint, for example in the new last step, or the budget
    /// may end. Then `rest_plan` becomes a plan with zero rates from there on, in case the budget ends before a
    /// better plan is found. Returns the evaluation, and whether there is such a plan. No search starts from
    /// it, because it leads to other local minima.
    fn evaluate_with_rest_plan(
        &mut self,
        task: &SolveTask,
        warm_plan: &[f64],
        budget: &mut Budget<'_>,
    ) -> (Option<Evaluation<1>>, bool) {
        self.scratch.clear();
        self.scratch.extend_from_slice(warm_plan);
        let (plan, rest_plan) = (&mut self.scratch, &mut self.rest_plan);
        // No violation is allowed, not even those of the warm start.
        rest_plan.restart(warm_plan, None);
        let found = task
            .problem
            .evaluate_until_violation(plan, rest_plan, &mut [], budget);
        let Some((until, is_whole)) = found else {
            return (None, false);
        };
        if is_whole {
            return (Some(until), false);
        }
        let evaluation = task.problem.evaluate_at(warm_plan, budget);
        rest_plan.restart(warm_plan, evaluation.as_ref());
        let holds = until.violations.iter().all(|kind| kind.0[0] == 0.0);
        let has_rest_plan = holds && rest_plan.offer(|i| plan[i], &until, 0, Candidate::WarmStart);
        (evaluation, has_rest_plan)
    }

    /// Refines the warm start. If it violates a constraint, for example in the new last step, the knowledge
    /// candidates compete with its refinement; returns `None` if one of them is better. A new staged plan
    /// takes [`NEW_PLAN_STEPS`] more, because no earlier cycle has come close.
    fn refine_warm_start(
        &mut self,
        task: &SolveTask,
        is_new: bool,
        evaluation: Option<&Evaluation<1>>,
        budget: &mut Budget<'_>,
    ) -> Option<GaussNewtonOutcome> {
        let settings = task.settings.gauss_newton();
        let settings = GaussNewtonSettings {
            steps: settings.steps + if is_new { NEW_PLAN_STEPS } else { 0 },
            ..settings
        };
        if !self.incumbent.is_violated() {
            return Some(self.refine_with(task.problem, task.bounds, &settings, budget));
        }
        self.alternative.restart(self.incumbent.z(), evaluation);
        self.knowledge
            .evaluate(task.problem, budget, &mut self.incumbent);
        let alternative = &mut self.alternative;
        let refinement =
            self.gauss_newton
                .refine(task.problem, task.bounds, &settings, budget, alternative);
        let is_taken = self.incumbent.take_better(alternative);
        is_taken.then_some(refinement)
    }

    /// Searches from the unrefined warm start after a refinement left an error: around the refined plan a
    /// swarm finds no other way past an obstacle. The better of both stays; if the budget ends the search,
    /// [`INTERRUPTED_COST_SHARE`] applies. Returns the iterations begun, and the outcome for the better plan.
    fn search_from_warm_start(
        &mut self,
        task: &SolveTask,
        (warm_plan, evaluation): (&[f64], Option<&Evaluation<1>>),
        refined: Option<GaussNewtonOutcome>,
        budget: &mut Budget<'_>,
    ) -> (u32, Option<GaussNewtonOutcome>) {
        std::mem::swap(&mut self.incumbent, &mut self.alternative);
        self.incumbent.restart(warm_plan, evaluation);
        let iterations = self.search(task, None, budget);
        let mut refinement = Some(self.refine(task, budget));
        let is_clearly_better =
            self.incumbent.cost() < INTERRUPTED_COST_SHARE * self.alternative.cost();
        if budget.is_spent() && !is_clearly_better && !self.alternative.is_violated() {
            std::mem::swap(&mut self.incumbent, &mut self.alternative);
            let evaluations = self.alternative.evaluations().saturating_sub(1);
            self.incumbent.count_evaluations(evaluations as usize);
            refinement = refined;
        } else if self.incumbent.take_better(&self.alternative) {
            refinement = refined;
        }
        (iterations, refinement)
    }

    /// Tries the knowledge candidates, then the swarm around them. `refined` is the outcome of a refinement
    /// of the incumbent, if there was one. Returns the iterations begun.
    fn search(
        &mut self,
        task: &SolveTask,
        refined: Option<GaussNewtonOutcome>,
        budget: &mut Budget<'_>,
    ) -> u32 {
        if !refined.is_some_and(|refined| refined.converged) {
            self.knowledge.add_least_squares(
                task.problem,
                task.bounds,
                task.settings.damping,
                &mut self.gauss_newton,
                budget,
                &mut self.incumbent,
            );
        }
        if self.has_tracking_error(task) {
            let is_stuck = if let Some(refined) = refined {
                refined.is_stationary
            } else {
                let (problem, z) = (task.problem, self.incumbent.z());
                self.gauss_newton
                    .is_stationary_at(problem, task.bounds, budget, z)
            };
            if is_stuck {
                self.escape_stationary_point(task, budget);
            }
        }
        if self.incumbent.cost() <= task.settings.cost_tolerance() {
            return 0;
        }
        let problem = task.problem;
        match problem.motion.coordinates() {
            Coordinates::BendVector => match PositionOnly::new(problem) {
                Some(position_only) => self.search_around(&position_only, task, budget),
                None => self.search_around(&SwarmCost::<VECTORS>::new(problem), task, budget),
            },
            Coordinates::BendAngles => {
                self.search_around(&SwarmCost::<ANGLES>::new(problem), task, budget)
            }
        }
    }

    fn search_around(
        &mut self,
        cost: &impl Cost,
        task: &SolveTask,
        budget: &mut Budget<'_>,
    ) -> u32 {
        let swarm_task = optimizer::SwarmTask {
            cost,
            bounds: task.bounds,
            settings: task.settings.kpso(),
            knowledge: self.knowledge.candidates(),
            origins: self.knowledge.origins(),
            seed: task.seed,
        };
        self.swarm.search(&swarm_task, budget, &mut self.incumbent)
    }

    pub(super) fn refine(
        &mut self,
        task: &SolveTask,
        budget: &mut Budget<'_>,
    ) -> GaussNewtonOutcome {
        let settings = task.settings.gauss_newton();
        self.refine_with(task.problem, task.bounds, &settings, budget)
    }

    pub(super) fn refine_with(
        &mut self,
        problem: &TrackingProblem,
        bounds: &Bounds,
        settings: &GaussNewtonSettings,
        budget: &mut Budget<'_>,
    ) -> GaussNewtonOutcome {
        self.gauss_newton
            .refine(problem, bounds, settings, budget, &mut self.incumbent)
    }

    /// Whether the cost without that of the rates exceeds the cost of a small error.
    pub(super) fn has_tracking_error(&self, task: &SolveTask) -> bool {
        let error = self.incumbent.cost() - task.problem.regularisation_at(self.incumbent.z());
        error > task.settings.small_cost()
    }

    /// Whether the error begins late in the horizon, in a plan with separate rates at every step that
    /// continues from the last cycle. There the reference is too fast for the robot, and a search gains
    /// nothing.
    fn error_is_late(&self, task: &SolveTask, warm_plan: &[f64], budget: &mut Budget<'_>) -> bool {
        let problem = task.problem;
        if !task.continues(warm_plan)
            || self.incumbent.is_violated()
            || !self.has_tracking_error(task)
        {
            return false;
        }
        let steps = problem.steps() / EARLY_PART;
        let early = problem.evaluate_first(steps, self.incumbent.z(), budget);
        early.is_some_and(|early| early <= EARLY_SHARE * self.incumbent.cost())
    }

    /// Tries the escape directions where the gradient vanishes. Returns whether one reduced the cost.
    fn escape_stationary_point(&mut self, task: &SolveTask, budget: &mut Budget<'_>) -> bool {
        let before = self.incumbent.cost();
        if self.has_tracking_error(task) {
            self.scratch.resize(task.problem.dimension(), 0.0);
            self.knowledge.add_escape_steps(
                task.problem,
                task.bounds,
                budget,
                &mut self.incumbent,
                &mut self.scratch,
            );
        }
        self.incumbent.cost() < before
    }
}
