//! The optimal control problem of Eq. 4-5, and its solution in one cycle (Fig. 2 of the paper).
//!
//! The state q is the bend of every section. The controls u are its rates, constant over M ≤ N blocks of the
//! horizon. The dynamics are q(k+1) = q(k) + T u(k) (Eq. 4), with q either the bend vectors (u, v) or the
//! paper's angles (θ, φ).
//!
//! The cost (Eq. 5) is a sum over the steps:
//! - the weighted squared error of the tip's position, with an extra weight ω on the last step;
//! - where the reference contains an orientation, the same for the orientation error beyond a tolerance; less for a preferred axis;
//! - optional weights on the controls, as their distance from those of the posture, and on their change;
//! - penalties on clearances below the safe distance, and on bends, cable strokes and cable speeds beyond
//!   their limits.
//!
//! | file | content |
//! |---|---|
//! | `settings` | settings and their ranges |
//! | `horizon` | map from steps to blocks |
//! | `motion` | dynamics: bends over the horizon as a function of the controls (Eq. 4) |
//! | `pose_error`, `obstacles`, `limits` | cost of one step (Eq. 5) |
//! | `posture` | rates that return the body towards straight |
//! | `problem` | cost of a plan and its linear model |
//! | `pace` | reference of a robot that is behind it, as far as it can follow |
//! | `knowledge`, `escape` | candidates known before the search |
//! | `solver` | sequence of knowledge, swarm and Gauss-Newton |
//! | `reachable` | box of the controls; obstacles and limits within reach |
//! | `ways` | several ways past obstacles, tried by a new plan |
//! | `foresight` | choice among plans of zero cost by a longer horizon |
//! | `report` | status and figures of a solve |
//!
//! Invariant: nothing here knows a clock, a thread or a message. Time is counted in periods; the budget is a
//! closure. Nothing allocates after [`Nmpc::new`].

mod escape;
mod foresight;
mod horizon;
mod knowledge;
mod limits;
mod motion;
mod obstacles;
mod pace;
mod pose_error;
mod posture;
mod problem;
mod reachable;
mod report;
mod settings;
mod solver;
mod unintended;
mod ways;

pub use crate::reference::HORIZON_STEPS_MAX;
pub use horizon::Horizon;
pub use pose_error::PREFERRED_LEVER_SHARE;
pub use report::{Constraint, SolveReport, SolveStatus};
pub use settings::{Coordinates, NmpcSettings, RateWeight, SettingsError, SolverKind, ranges};
pub use unintended::{
    budget_warning, posture_gain_warning, rate_change_weight_warning, rate_weight_warning,
    safe_distance_warning,
};

use crate::optimizer::{Budget, Simd};
use crate::reference::ReferenceSample;
use crate::robot::{BendRates, COORDINATES_MAX, Configuration, Obstacle, Robot};
use foresight::Foresight;
use pace::{Surroundings, pace_reference};
use reachable::{Reachable, SolveContext};
use solver::Solver;

/// Largest number of control blocks M: one for each step.
pub const CONTROL_BLOCKS_MAX: usize = crate::optimizer::BLOCKS_MAX;
/// Largest number of control blocks with a weight on the change of rates, which couples all blocks in one
/// dense matrix.
const TIED_BLOCKS_MAX: usize = 20;
/// Scalars of the longest plan: 50 blocks for up to three sections, 37 for four, 30 for five, 25 for six.
pub const PLAN_MAX: usize = 300;
const _: () = assert!(COORDINATES_MAX * TIED_BLOCKS_MAX <= PLAN_MAX);
const _: () = assert!(CONTROL_BLOCKS_MAX >= HORIZON_STEPS_MAX);
/// Largest number of particles.
pub const SWARM_MAX: usize = 512;

/// Largest number of obstacles.
pub const OBSTACLES_MAX: usize = 64;

/// Inputs of one solve.
#[derive(Debug, Clone, Copy)]
pub struct SolveInput<'a> {
    /// State q at the release. The solve returns zero rates if its section count differs from the robot's.
    pub configuration: &'a Configuration,
    /// Rates of the last command. The same check applies.
    pub previous_rates: &'a BendRates,
    /// The reference at the releases 1, 2, …, N periods from now. If it is shorter than N, the last sample
    /// applies to the other steps. If it is empty, the solve returns zero rates.
    pub reference: &'a [ReferenceSample],
    /// Obstacles at their positions at the release, with constant velocity; at most [`OBSTACLES_MAX`],
    /// further ones are ignored.
    pub obstacles: &'a [Obstacle],
    /// Largest distance of the tip from the position given by the bends \[m\], 0 or more. The body's
    /// clearance grows by this distance, in proportion for each section ([`Robot::enlarged`],
    /// [`Estimator::tip_margin_m`](crate::estimator::Estimator::tip_margin_m)).
    pub tip_offset_m: f64,
    /// Periods since the plan was made: the shift of the warm start.
    pub elapsed_periods: u64,
    /// Seed of this cycle's swarm, see [`cycle_seed`](crate::optimizer::cycle_seed).
    pub seed: u64,
}

/// Nonlinear model predictive control of one robot. The constructor allocates memory for the largest
/// settings, and so does a clone.
#[derive(Debug)]
pub struct Nmpc {
    robot: Robot,
    period_s: f64,
    /// Largest growth of the rate of a component \[rad/s²\].
    acceleration_rad_s2: f64,
    /// Largest speed of a tip that is behind its reference \[m/s\].
    pace_m_s: f64,
    settings: NmpcSettings,
    horizon: Horizon,
    memory: PlanMemory,
    reachable: Reachable,
    /// The saved plan during a rehearsal.
    saved_plan: Vec<f64>,
    solver: Solver,
    foresight: Foresight,
    /// The reference, as far as a robot that is behind it can follow.
    paced: Vec<ReferenceSample>,
}

/// What a solve leaves to the next. All other memory of a controller is workspace.
#[derive(Debug)]
struct PlanMemory {
    /// The plan of the last solve, from which the next warm start is made.
    plan: Vec<f64>,
    /// The warm start of the last solve.
    warm_plan: Vec<f64>,
    /// Periods by which a restored plan was already shifted.
    restored_periods: u64,
}

impl PlanMemory {
    fn with_capacity(unknowns: usize) -> Self {
        Self {
            plan: Vec::with_capacity(unknowns),
            warm_plan: Vec::with_capacity(unknowns),
            restored_periods: 0,
        }
    }

    fn resize(&mut self, unknowns: usize) {
        self.plan.resize(unknowns, 0.0);
        self.warm_plan.resize(unknowns, 0.0);
    }

    /// Copies a memory of the same size.
    fn copy_from(&mut self, other: &Self) {
        self.plan.copy_from_slice(&other.plan);
        self.warm_plan.copy_from_slice(&other.warm_plan);
        self.restored_periods = other.restored_periods;
    }
}

impl Clone for Nmpc {
    /// A derived clone would lose the capacity of the vectors, and its first solve would allocate.
    fn clone(&self) -> Self {
        let simd = self.solver.simd();
        let mut clone = Self::from_valid(simd, self.robot.clone(), self.period_s, self.settings);
        clone.acceleration_rad_s2 = self.acceleration_rad_s2;
        clone.pace_m_s = self.pace_m_s;
        clone.memory.copy_from(&self.memory);
        clone
    }
}

impl Nmpc {
    /// A controller with a plan of zero rates.
    ///
    /// # Errors
    /// [`SettingsError`] when a setting is out of its range, or the period is outside [`ranges::PERIOD_S`].
    pub fn new(robot: Robot, period_s: f64, settings: NmpcSettings) -> Result<Self, SettingsError> {
        Self::with_simd(Simd::best(), robot, period_s, settings)
    }

    /// A controller whose swarm is evaluated with `simd`, to compare the speed of the SIMD paths. All paths
    /// give the same bits.
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
        Ok(Self::from_valid(simd, robot, period_s, settings))
    }

    fn from_valid(simd: Simd, robot: Robot, period_s: f64, settings: NmpcSettings) -> Self {
        let width = robot.coordinate_count();
        let unknowns = PLAN_MAX.min(width * CONTROL_BLOCKS_MAX);
        let mut nmpc = Self {
            robot,
            period_s,
            acceleration_rad_s2: f64::INFINITY,
            pace_m_s: f64::INFINITY,
            settings,
            horizon: Horizon::new(&settings, width),
            memory: PlanMemory::with_capacity(unknowns),
            reachable: Reachable::with_capacity(unknowns),
            saved_plan: Vec::with_capacity(unknowns),
            solver: Solver::with_capacity(simd, unknowns, width * TIED_BLOCKS_MAX),
            foresight: Foresight::with_capacity(unknowns),
            paced: Vec::with_capacity(HORIZON_STEPS_MAX),
        };
        nmpc.apply(settings);
        nmpc
    }

    /// Limits the growth of each component's rate to `acceleration_rad_s2` \[rad/s²\], above 0; infinite, the
    /// default: no limit. Deceleration is not limited.
    ///
    /// Commands are limited in the same way
    /// ([`Situation::acceleration_rad_s2`](crate::safety::Situation::acceleration_rad_s2)). Without this
    /// limit, a plan over a long horizon contains turns that the robot cannot execute. It applies to bend
    /// vectors only, not to bend angles.
    pub fn limit_acceleration(&mut self, acceleration_rad_s2: f64) {
        self.acceleration_rad_s2 = acceleration_rad_s2;
    }

    /// Limits how fast a tip that is behind its reference returns to it \[m/s\], above 0; infinite, the default: as fast as
    /// all other limits allow. It does not slow the evasion of an obstacle.
    pub fn limit_pace(&mut self, pace_m_s: f64) {
        self.pace_m_s = pace_m_s;
    }

    /// Replaces the settings. The plan is truncated or extended to the new horizon, and reset to zero when
    /// the coordinates change. No allocation.
    ///
    /// # Errors
    /// [`SettingsError`] when a setting is out of its range; then nothing changes.
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
        self.memory.resize(unknowns);
        self.saved_plan.resize(unknowns, 0.0);
    }

    /// Resets the plan, so that the next warm start is zero rates. For cycles whose command does not come
    /// from the solver.
    pub fn forget_plan(&mut self) {
        self.memory.plan.fill(0.0);
        self.memory.restored_periods = 0;
    }

    /// Replaces the plan by the recorded warm start of a replay, which was already shifted by `shifted_periods`.
    /// The next solve uses `elapsed_periods` = 0. Returns false if the length does not fit the
    /// settings.
    pub fn restore_plan(&mut self, plan: &[f64], shifted_periods: u64) -> bool {
        let fits = plan.len() == self.memory.plan.len();
        if fits {
            self.memory.plan.copy_from_slice(plan);
            self.memory.restored_periods = shifted_periods;
        }
        fits
    }

    /// The settings in force.
    pub fn settings(&self) -> &NmpcSettings {
        &self.settings
    }

    /// The limit of [`Self::limit_pace`] in force \[m/s\].
    pub fn pace_m_s(&self) -> f64 {
        self.pace_m_s
    }

    /// The robot that the solver predicts.
    pub fn robot(&self) -> &Robot {
        &self.robot
    }

    /// The plan of the last solve \[rad/s\]: `2 n` controls for each block, in the coordinates of the
    /// settings.
    pub fn plan(&self) -> &[f64] {
        &self.memory.plan
    }

    /// The warm start of the last solve \[rad/s\], in the same layout.
    pub fn warm_plan(&self) -> &[f64] {
        &self.memory.warm_plan
    }

    /// Computes the rates for the period that begins now (Fig. 2).
    ///
    /// A reference that is farther away than the tip may be by then is followed at the pace that is permitted, on the
    /// straight line to it ([`Nmpc::limit_pace`], [`Robot::tip_speed_max_m_s`]).
    ///
    /// The work is bounded and nothing allocates. The result is never worse than the warm start; when the
    /// budget ends the solve, it is the incumbent. Same input, settings, plan and work give the same bits.
    ///
    /// If the budget ends before the warm start is evaluated, the plan keeps the rates that were planned and
    /// has zero rates after them. With blocks of several steps it keeps the first block for one period only.
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
        let own_m_s = self.robot.tip_speed_max_m_s().unwrap_or(f64::INFINITY);
        let step_m = self.pace_m_s.min(own_m_s) * self.period_s;
        if step_m == f64::INFINITY {
            return self.solve_within(input, budget);
        }
        let tip = self.robot.tip_pose(input.configuration);
        let mut paced = core::mem::take(&mut self.paced);
        let steps = self.horizon.steps();
        let is_behind = pace_reference(input.reference, steps, &tip, step_m, &mut paced);
        let is_blocked = is_behind && self.surroundings(input).are_near();
        let reference = if is_behind && !is_blocked {
            &paced
        } else {
            input.reference
        };
        let seen = SolveInput {
            reference,
            ..*input
        };
        let (mut rates, report) = self.solve_within(&seen, budget);
        if is_behind {
            // The robot's own limit is applied to the command, which reports it.
            rates = self.surroundings(input).slow_down(rates, self.pace_m_s);
        }
        self.paced = paced;
        (rates, report)
    }

    /// Solves and keeps the previous plan, so that later solves give the same bits as without the rehearsal.
    ///
    /// After a pause, this loads the solver's code and data into the processor's caches before the release.
    /// It plays the part of the preparation phase of the real-time iteration (Diehl et al. 2005,
    /// doi:10.1137/S0363012902400713).
    pub fn rehearse(&mut self, input: &SolveInput, budget: &mut Budget<'_>) {
        self.saved_plan.copy_from_slice(&self.memory.plan);
        self.solve(input, budget);
        core::mem::swap(&mut self.memory.plan, &mut self.saved_plan);
    }

    fn surroundings<'a>(&'a self, input: &'a SolveInput<'a>) -> Surroundings<'a> {
        Surroundings {
            robot: &self.robot,
            input,
            safe_distance_m: self.settings.safe_distance_m,
            period_s: self.period_s,
        }
    }

    fn solve_within(
        &mut self,
        input: &SolveInput,
        budget: &mut Budget<'_>,
    ) -> (BendRates, SolveReport) {
        let enlarged = self.robot.enlarged(input.configuration, input.tip_offset_m);
        let robot: &Robot = &enlarged;
        let context = SolveContext {
            robot,
            period_s: self.period_s,
            acceleration_rad_s2: self.acceleration_rad_s2,
            settings: &self.settings,
            input,
        };
        let motion = context.motion(&self.horizon);
        let limits = self.reachable.update(&context, &motion, budget);
        let memory = &mut self.memory;
        let restored_periods = core::mem::take(&mut memory.restored_periods);
        let shifted_periods = input.elapsed_periods.saturating_add(restored_periods);
        self.horizon
            .shift(&memory.plan, input.elapsed_periods, &mut memory.warm_plan);
        motion.continue_through_straight(
            &mut memory.warm_plan,
            input.previous_rates,
            input.elapsed_periods,
        );
        self.reachable.bounds.project(&mut memory.warm_plan);
        let problem = context.problem(&motion, &limits, &self.reachable, input.reference);
        let task = solver::SolveTask {
            problem: &problem,
            bounds: &self.reachable.bounds,
            settings: &self.settings,
            seed: input.seed,
        };
        let end = task.quanta_max();
        let solve_end = if task.continues(&memory.warm_plan) {
            end
        } else {
            u32::MAX
        };
        let mut report = budget.until(solve_end, |budget| {
            self.solver.solve(&task, &memory.warm_plan, budget)
        });
        budget.until(end, |budget| {
            self.foresight
                .improve(&mut self.solver, &task, &context, budget, &mut report);
        });
        memory.plan.copy_from_slice(self.solver.best());
        if !self.solver.is_evaluated() {
            self.horizon
                .zero_past_horizon(&mut memory.plan, shifted_periods);
        }
        let rates = match report.status {
            SolveStatus::NonFinite => None,
            _ if !problem.has_reference() => None,
            _ => motion.first_rates(robot, &memory.plan),
        };
        let rates = rates.unwrap_or_else(|| {
            memory.plan.fill(0.0);
            BendRates::zero(self.robot.section_count())
        });
        (rates, report)
    }
}
