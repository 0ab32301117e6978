//! The optimal control problem of Eq. 4-5, and its solution in one cycle (Fig. 2 of the paper).
//!
//! The state is the bend of every section, the controls u are its rates, held over M ≤ N blocks of the
//! horizon, and q(k+1) = q(k) + T u(k) (Eq. 4), with q either the bend vectors (u, v) or the paper's angles
//! (θ, φ). The cost (Eq. 5) is, at each step, the weighted squared error of the tip's position and, where
//! the reference asks for one, of its orientation beyond a tolerance, with an extra weight ω on the last;
//! optional weights on the controls and on their change; and penalties on what is too near to an
//! obstacle or beyond a limit of bend, cable stroke or cable speed.
//!
//! | file | question it answers |
//! |---|---|
//! | `settings` | what can be tuned, within which ranges |
//! | `horizon` | which step belongs to which block |
//! | `motion` | how do the controls bend the robot over the horizon (Eq. 4) |
//! | `pose_error`, `obstacles`, `limits` | what does one step cost (Eq. 5) |
//! | `problem` | what does a plan cost, and how does that change with it |
//! | `knowledge`, `escape` | which candidates are known before the search |
//! | `solver` | in which order do knowledge, swarm and Gauss-Newton work |
//! | `reachable` | what can be reached over a horizon |
//! | `ways` | which ways past obstacles does a new plan try |
//! | `foresight` | which of the plans that cost nothing leads on best |
//! | `report` | how did the solve end |
//!
//! Invariant: nothing here knows a clock, a thread or a message. Time is counted in periods; the
//! budget is a closure. Nothing allocates after [`Nmpc::new`].

mod escape;
mod foresight;
mod horizon;
mod knowledge;
mod limits;
mod motion;
mod obstacles;
mod pose_error;
mod problem;
mod reachable;
mod report;
mod settings;
mod solver;
mod ways;

pub use crate::reference::HORIZON_STEPS_MAX;
pub use horizon::Horizon;
pub use report::{Constraint, SolveReport, SolveStatus};
pub use settings::{Coordinates, NmpcSettings, RateWeight, SettingsError, SolverKind, ranges};

use crate::optimizer::{Budget, Simd};
use crate::reference::ReferenceSample;
use crate::robot::{BendRates, COORDINATES_MAX, Configuration, Obstacle, Robot};
use foresight::Foresight;
use reachable::{Reachable, Start};
use solver::Solver;

/// Control blocks M at most: one for each step.
pub const CONTROL_BLOCKS_MAX: usize = crate::optimizer::BLOCKS_MAX;
/// Control blocks at most where rates have a weight on their change: it ties all of them to each other, in one matrix.
const TIED_BLOCKS_MAX: usize = 20;
/// Scalars of the longest plan: 50 blocks of up to three sections, 25 of six.
pub const PLAN_MAX: usize = 300;
const _: () = assert!(COORDINATES_MAX * TIED_BLOCKS_MAX <= PLAN_MAX);
const _: () = assert!(CONTROL_BLOCKS_MAX >= HORIZON_STEPS_MAX);
/// Particles at most.
pub const SWARM_MAX: usize = 512;

/// Obstacles at most.
pub const OBSTACLES_MAX: usize = 64;

/// What one solve starts from.
#[derive(Debug, Clone, Copy)]
pub struct SolveInput<'a> {
    /// State q at the release. One of another section count than the robot's: the solve answers zero rates.
    pub configuration: &'a Configuration,
    /// Rates of the last command. Likewise.
    pub previous_rates: &'a BendRates,
    /// The reference at the releases 1, 2, …, N periods from now. Fewer than N: the last one counts
    /// for the rest. Empty: the solve answers zero rates.
    pub reference: &'a [ReferenceSample],
    /// What the body must keep away from, at most [`OBSTACLES_MAX`] (further ones are ignored), where
    /// it is at the release; it moves on at its velocity.
    pub obstacles: &'a [Obstacle],
    /// How far the tip may be beside where the bends place it \[m\], 0 or more: so much more distance the body keeps, each section its
    /// part ([`Robot::thicker`], [`Estimator::tip_margin_m`](crate::estimator::Estimator::tip_margin_m)).
    pub tip_offset_m: f64,
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
    /// How fast the rate of a component may grow (rad/s²).
    acceleration_rad_s2: f64,
    settings: NmpcSettings,
    horizon: Horizon,
    reachable: Reachable,
    /// The plan of the last solve: what the next warm start is made of.
    plan: Vec<f64>,
    warm_plan: Vec<f64>,
    /// The plan, while a rehearsal makes another.
    kept_plan: Vec<f64>,
    /// Periods by which a restored plan was moved on already.
    restored_periods: u64,
    solver: Solver,
    foresight: Foresight,
}

impl Nmpc {
    /// A controller at rest.
    ///
    /// # Errors
    /// [`SettingsError`] when a setting is out of its range, or the period is outside [`ranges::PERIOD_S`].
    pub fn new(robot: Robot, period_s: f64, settings: NmpcSettings) -> Result<Self, SettingsError> {
        Self::with_simd(Simd::best(), robot, period_s, settings)
    }

    /// A controller whose swarm is computed with `simd`. All of them give the same bits; this is for
    /// comparing their speed.
    ///
    /// # Errors
    /// As [`Nmpc::new`].
    pub fn with_simd(
        simd: Simd,
        robot: Robot,
        period_s: f64,
        settings: NmpcSettings,
    ) -> Result<Self, SettingsError> {
        settings.validate_with(period_s)?;
        let width = robot.coordinate_count();
        let unknowns = PLAN_MAX.min(width * CONTROL_BLOCKS_MAX);
        let mut nmpc = Self {
            robot,
            period_s,
            acceleration_rad_s2: f64::INFINITY,
            settings,
            horizon: Horizon::new(&settings, width),
            reachable: Reachable::with_capacity(unknowns),
            plan: Vec::with_capacity(unknowns),
            warm_plan: Vec::with_capacity(unknowns),
            kept_plan: Vec::with_capacity(unknowns),
            restored_periods: 0,
            solver: Solver::with_capacity(simd, unknowns, width * TIED_BLOCKS_MAX),
            foresight: Foresight::with_capacity(unknowns),
        };
        nmpc.apply(settings);
        Ok(nmpc)
    }

    /// From now on the rate of a component grows by `acceleration_rad_s2` \[rad/s²\], above 0, at most; infinite, as at first: as it likes. To slow
    /// down is free, as in [`Situation::acceleration_rad_s2`](crate::safety::Situation::acceleration_rad_s2), by which the command is limited: a plan
    /// that does not know that limit promises, over a long horizon, turns that never come. In bend angles it is not known.
    pub fn limit_acceleration(&mut self, acceleration_rad_s2: f64) {
        self.acceleration_rad_s2 = acceleration_rad_s2;
    }

    /// Takes over other settings; the plan is cut or continued to the new horizon, and forgotten when the
    /// coordinates change. No allocation.
    ///
    /// # Errors
    /// [`SettingsError`], and nothing changes, when a setting is out of its range.
    pub fn configure(&mut self, settings: NmpcSettings) -> Result<(), SettingsError> {
        settings.validate()?;
        if settings.coordinates != self.settings.coordinates {
            self.forget_plan();
        }
        self.apply(settings);
        Ok(())
    }

    fn apply(&mut self, settings: NmpcSettings) {
        self.settings = settings;
        let width = self.robot.coordinate_count();
        self.horizon = Horizon::new(&settings, width);
        self.foresight.configure(&settings, &self.horizon, width);
        let unknowns = width * self.horizon.blocks();
        self.plan.resize(unknowns, 0.0);
        self.warm_plan.resize(unknowns, 0.0);
        self.kept_plan.resize(unknowns, 0.0);
    }

    /// Forgets the plan: the next warm start is zero rates. For cycles in which another than the
    /// solver chose the command.
    pub fn forget_plan(&mut self) {
        self.plan.fill(0.0);
        self.restored_periods = 0;
    }

    /// Replaces the plan that the next warm start is made of by a recorded warm start of a replay, to be
    /// solved with `elapsed_periods` = 0: it was moved on by `moved_on` periods already. False when its length does not fit the settings.
    pub fn restore_plan(&mut self, plan: &[f64], moved_on: u64) -> bool {
        let fits = plan.len() == self.plan.len();
        if fits {
            self.plan.copy_from_slice(plan);
            self.restored_periods = moved_on;
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

    /// The plan of the last solve \[rad/s\]: `2 n` controls for each block, in the coordinates of the
    /// settings.
    pub fn plan(&self) -> &[f64] {
        &self.plan
    }

    /// The warm start of the last solve \[rad/s\], likewise.
    pub fn warm_plan(&self) -> &[f64] {
        &self.warm_plan
    }

    /// Finds the rates for the period that begins now (Fig. 2).
    ///
    /// Bounded work, no allocation, never worse than the warm start, the best solution so far when
    /// the budget ends it, and the same bits for the same input, settings, plan and work done. A warm start that the budget leaves no
    /// time to evaluate is followed as far as it was planned, and rests after that; with blocks of several steps, after one period.
    pub fn solve(
        &mut self,
        input: &SolveInput,
        budget: &mut Budget<'_>,
    ) -> (BendRates, SolveReport) {
        let n = self.robot.section_count();
        let counts = [
            input.configuration.section_count(),
            input.previous_rates.section_count(),
        ];
        if counts != [n; 2] {
            self.forget_plan();
            return (BendRates::zero(n), SolveReport::default());
        }
        self.solve_within(input, budget)
    }

    /// Solves, and forgets it: the plan stays, so that every later solve gives the bits that it would have given. After a
    /// pause this brings the solver's code and data back into the processor's caches before the time that matters, as the
    /// preparation phase of the real-time iteration does (Diehl et al. 2005, doi:10.1137/S0363012902400713).
    pub fn rehearse(&mut self, input: &SolveInput, budget: &mut Budget<'_>) {
        self.kept_plan.copy_from_slice(&self.plan);
        self.solve(input, budget);
        core::mem::swap(&mut self.plan, &mut self.kept_plan);
    }

    fn solve_within(
        &mut self,
        input: &SolveInput,
        budget: &mut Budget<'_>,
    ) -> (BendRates, SolveReport) {
        let thicker = self.robot.thicker(input.configuration, input.tip_offset_m);
        let robot: &Robot = &thicker;
        let start = Start {
            robot,
            period_s: self.period_s,
            acceleration_rad_s2: self.acceleration_rad_s2,
            settings: &self.settings,
            input,
        };
        let motion = start.motion(&self.horizon);
        let limits = self.reachable.survey(&start, &motion, budget);
        let moved_on = input.elapsed_periods.saturating_add(self.restored_periods);
        self.restored_periods = 0;
        self.horizon
            .shift(&self.plan, input.elapsed_periods, &mut self.warm_plan);
        motion.continue_plan(
            &mut self.warm_plan,
            input.previous_rates,
            input.elapsed_periods,
        );
        self.reachable.bounds.project(&mut self.warm_plan);
        let problem = start.problem(&motion, &limits, &self.reachable, input.reference);
        let task = solver::Task {
            problem: &problem,
            bounds: &self.reachable.bounds,
            settings: &self.settings,
            seed: input.seed,
        };
        let mut report = self.solver.solve(&task, &self.warm_plan, budget);
        self.foresight
            .improve(&mut self.solver, &task, &start, budget, &mut report);
        self.plan.copy_from_slice(self.solver.best());
        if !self.solver.is_evaluated() {
            self.horizon.rest_unforeseen(&mut self.plan, moved_on);
        }
        let rates = match report.status {
            SolveStatus::NonFinite => None,
            _ if !problem.is_posed() => None,
            _ => motion.first_rates(robot, &self.plan),
        };
        let rates = rates.unwrap_or_else(|| {
            self.plan.fill(0.0);
            BendRates::zero(self.robot.section_count())
        });
        (rates, report)
    }
}
