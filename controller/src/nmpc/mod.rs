//! The optimal control problem of Eq. 4-5, and its solution in one cycle (Fig. 2 of the paper).
//!
//! The state is the bend vector q of every section, the controls are its rates u, held over M ≤ N
//! blocks of the horizon, and q(k+1) = q(k) + T u(k) (Eq. 4). The cost (Eq. 5) is the weighted squared
//! position error of the tip at each step, with an extra weight ω on the last, and optional weights
//! on the rates and on their change.
//!
//! Invariant: nothing here knows a clock, a thread or a message. Time is counted in periods; the
//! budget is a closure. Nothing allocates after [`Nmpc::new`].

mod horizon;
mod knowledge;
mod problem;
mod report;
mod settings;

pub use crate::reference::HORIZON_STEPS_MAX;
pub use horizon::Horizon;
pub use report::{SolveReport, SolveStatus};
pub use settings::{NmpcSettings, SettingsError, SolverKind, ranges};

use crate::optimizer::{
    Bounds, Budget, GaussNewton, GaussNewtonOutcome, GaussNewtonSettings, Incumbent, Kpso, Path,
    Problem, Task,
};
use crate::reference::ReferenceSample;
use crate::robot::{BendRates, COORDINATES_MAX, Configuration, Robot};
use knowledge::Knowledge;
use problem::TrackingProblem;

/// Control blocks M at most. With six sections this makes 240 unknowns.
pub const CONTROL_BLOCKS_MAX: usize = 20;
/// Scalars of the longest plan.
pub const PLAN_MAX: usize = COORDINATES_MAX * CONTROL_BLOCKS_MAX;
/// Particles at most.
pub const SWARM_MAX: usize = 512;

/// What one solve starts from.
#[derive(Debug, Clone, Copy)]
pub struct SolveInput<'a> {
    /// State q at the release.
    pub configuration: &'a Configuration,
    /// Rates of the last command.
    pub previous_rates: &'a BendRates,
    /// The reference at the releases 1, 2, …, N periods from now. Fewer than N: the last one counts
    /// for the rest. Empty: the solve answers zero rates.
    pub reference: &'a [ReferenceSample],
    /// Periods since the plan was made: how far the warm start is moved on in time.
    pub elapsed_periods: u64,
    /// Seed of this cycle's swarm, see [`cycle_seed`](crate::optimizer::cycle_seed).
    pub seed: u64,
}

/// Nonlinear model predictive control of one robot. Memory for the largest settings is taken at
/// construction.
#[derive(Debug, Clone)]
pub struct Nmpc {
    robot: Robot,
    period_s: f64,
    settings: NmpcSettings,
    horizon: Horizon,
    bounds: Bounds,
    /// The plan of the last solve: what the next warm start is made of.
    plan: Vec<f64>,
    warm_plan: Vec<f64>,
    knowledge: Knowledge,
    swarm: Kpso,
    gauss_newton: GaussNewton,
    incumbent: Incumbent,
}

impl Nmpc {
    /// A controller at rest.
    ///
    /// # Errors
    /// [`SettingsError`] when a setting is out of its range.
    pub fn new(robot: Robot, period_s: f64, settings: NmpcSettings) -> Result<Self, SettingsError> {
        Self::on_path(Path::best(), robot, period_s, settings)
    }

    /// A controller whose swarm is computed on `path`. All paths give the same bits; this is for
    /// comparing their speed.
    ///
    /// # Errors
    /// As [`Nmpc::new`].
    pub fn on_path(
        path: Path,
        robot: Robot,
        period_s: f64,
        settings: NmpcSettings,
    ) -> Result<Self, SettingsError> {
        settings.validate()?;
        let unknowns = robot.coordinate_count() * CONTROL_BLOCKS_MAX;
        let rows = 3 * HORIZON_STEPS_MAX + 2 * unknowns;
        let mut nmpc = Self {
            robot,
            period_s,
            settings,
            horizon: Horizon::new(&settings),
            bounds: Bounds::with_capacity(unknowns),
            plan: Vec::with_capacity(unknowns),
            warm_plan: Vec::with_capacity(unknowns),
            knowledge: Knowledge::with_capacity(unknowns),
            swarm: Kpso::with_capacity(path, SWARM_MAX, unknowns),
            gauss_newton: GaussNewton::with_capacity(unknowns, rows),
            incumbent: Incumbent::with_capacity(unknowns),
        };
        nmpc.apply(settings);
        Ok(nmpc)
    }

    /// Takes over other settings; the plan is cut or continued to the new horizon. No allocation.
    ///
    /// # Errors
    /// [`SettingsError`], and nothing changes, when a setting is out of its range.
    pub fn configure(&mut self, settings: NmpcSettings) -> Result<(), SettingsError> {
        settings.validate()?;
        self.apply(settings);
        Ok(())
    }

    fn apply(&mut self, settings: NmpcSettings) {
        self.settings = settings;
        self.horizon = Horizon::new(&settings);
        let rate_limits = self
            .robot
            .sections()
            .iter()
            .flat_map(|s| [s.rate_max_rad_s; 2]);
        self.bounds
            .set_symmetric(&rate_limits, self.horizon.blocks());
        self.plan.resize(self.unknowns(), 0.0);
        self.warm_plan.resize(self.unknowns(), 0.0);
    }

    /// Forgets the plan: the next warm start is zero rates. For cycles in which another than the
    /// solver chose the command.
    pub fn forget_plan(&mut self) {
        self.plan.fill(0.0);
    }

    /// Replaces the plan that the next warm start is made of by a recorded warm start of a replay.
    /// False when its length does not fit the settings.
    pub fn restore_plan(&mut self, plan: &[f64]) -> bool {
        let fits = plan.len() == self.plan.len();
        if fits {
            self.plan.copy_from_slice(plan);
        }
        fits
    }

    /// The settings in force.
    pub fn settings(&self) -> &NmpcSettings {
        &self.settings
    }

    /// The robot.
    pub fn robot(&self) -> &Robot {
        &self.robot
    }

    /// The plan of the last solve \[rad/s\]: `2 n` rates for each block.
    pub fn plan(&self) -> &[f64] {
        &self.plan
    }

    /// The warm start of the last solve \[rad/s\].
    pub fn warm_plan(&self) -> &[f64] {
        &self.warm_plan
    }

    fn unknowns(&self) -> usize {
        self.robot.coordinate_count() * self.horizon.blocks()
    }

    /// Finds the rates for the period that begins now (Fig. 2).
    ///
    /// Bounded work, no allocation, never worse than the warm start, the best solution so far when
    /// the budget ends it, and the same bits for the same input, settings, plan and work done.
    pub fn solve<F: FnMut() -> bool>(
        &mut self,
        input: &SolveInput,
        budget: &mut Budget<F>,
    ) -> (BendRates, SolveReport) {
        let problem = TrackingProblem::new(
            &self.robot,
            self.period_s,
            &self.settings,
            &self.horizon,
            input,
        );
        self.horizon
            .shift(&self.plan, input.elapsed_periods, &mut self.warm_plan);
        self.bounds.project(&mut self.warm_plan);
        let warm_cost = problem.cost_at(&self.warm_plan);
        self.incumbent.restart(&self.warm_plan, warm_cost);

        let mut outcome = GaussNewtonOutcome::default();
        let mut iterations = 0;
        if problem.is_posed() {
            let (knowledge, solver) = (&mut self.knowledge, self.settings.solver);
            knowledge.gather(&problem, &self.bounds, input, budget, &mut self.incumbent);
            if solver.searches() {
                knowledge.add_least_squares(
                    &problem,
                    &self.bounds,
                    self.settings.damping,
                    &mut self.gauss_newton,
                    budget,
                    &mut self.incumbent,
                );
                let task = Task {
                    problem: &problem,
                    bounds: &self.bounds,
                    settings: self.settings.kpso(),
                    seed: input.seed,
                };
                let candidates = knowledge.candidates();
                iterations = self
                    .swarm
                    .search(&task, candidates, budget, &mut self.incumbent);
            }
            if solver.refines() {
                outcome = self.gauss_newton.refine(
                    &problem,
                    &self.bounds,
                    &self.settings.gauss_newton(),
                    budget,
                    &mut self.incumbent,
                );
            }
        }
        self.plan.copy_from_slice(self.incumbent.z());
        let report = SolveReport {
            status: SolveStatus::of(&self.incumbent, &self.settings, &outcome, budget.is_over()),
            cost: self.incumbent.cost(),
            warm_cost,
            gradient_norm: outcome.gradient_norm,
            evaluations: self.incumbent.evaluations(),
            quanta: budget.passed(),
            iterations,
            refinements: outcome.accepted,
            winner: self.incumbent.origin(),
            seed: input.seed,
        };
        (self.first_rates(&report), report)
    }

    /// The rates of the first block; zero when nothing finite was found.
    fn first_rates(&mut self, report: &SolveReport) -> BendRates {
        let zero = BendRates::zero(self.robot.section_count());
        if report.status == SolveStatus::NonFinite {
            self.forget_plan();
            return zero;
        }
        BendRates::from_slice(&self.plan[..self.robot.coordinate_count()]).unwrap_or(zero)
    }
}

impl NmpcSettings {
    fn gauss_newton(&self) -> GaussNewtonSettings {
        GaussNewtonSettings {
            steps: self.refinement_steps,
            damping: self.damping,
            step_tolerance: settings::STEP_TOLERANCE_RAD_S,
        }
    }
}
