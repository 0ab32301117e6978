//! One robot tracking one curve, cycle by cycle, as fast as it can be computed.

use std::time::{Duration, Instant};

use anyhow::Result;
pub use cdcr_controller::closed_loop::{Scene, SceneLoop};
use cdcr_controller::nmpc::{Nmpc, NmpcSettings, SolveInput, SolveReport, SolverKind};
use cdcr_controller::optimizer::{Budget, Candidate};
use cdcr_controller::robot::{BendRates, Configuration, Obstacle, Pose, Shape};
use nalgebra::Vector3;

pub const PERIOD_S: f64 = Scene::PERIOD_S;

/// Centre of the first ball; infinite without one.
pub fn obstacle_m(scene: &Scene) -> Vector3<f64> {
    match scene.obstacles.first().map(Obstacle::shape) {
        Some(Shape::Sphere { centre_m }) => *centre_m,
        _ => Vector3::repeat(f64::INFINITY),
    }
}

#[derive(Debug, Clone)]
pub struct Sample {
    pub time_s: f64,
    pub reference_m: Vector3<f64>,
    pub tip: Pose,
    pub configuration: Configuration,
    pub rates: BendRates,
    /// Clearance of the whole body at that time \[m\]; infinite without obstacles.
    pub clearance_m: f64,
    pub solve_ns: u64,
    pub swarm_ran: bool,
    pub swarm_won: bool,
    /// The budget ended the solve.
    pub cut_short: bool,
    /// The clearance guard changed the command.
    pub guarded: bool,
}

impl Sample {
    /// The cycle that has just ended, with the report and the time of its solve.
    fn new(scene: &Scene, closed: &SceneLoop<'_>, report: &SolveReport, time: Duration) -> Self {
        let configuration = *closed.configuration();
        Self {
            time_s: closed.time_s(),
            reference_m: scene.point_m(closed.cycle()),
            tip: scene.robot.tip_pose(&configuration),
            configuration,
            rates: closed.command().rates,
            clearance_m: closed.clearance_m(),
            solve_ns: time.as_nanos() as u64,
            swarm_ran: report.iterations > 0,
            swarm_won: report.winner == Candidate::Swarm,
            cut_short: report.budget_spent,
            guarded: closed.command().clearance_hit,
        }
    }

    pub fn offset_mm(&self) -> Vector3<f64> {
        1e3 * (self.tip.position_m - self.reference_m)
    }

    pub fn error_mm(&self) -> f64 {
        self.offset_mm().norm()
    }
}

/// Every cycle of a run.
#[derive(Debug, Clone)]
pub struct SceneRun(pub Vec<Sample>);

impl SceneRun {
    pub fn mean_error_mm(&self) -> f64 {
        self.0.iter().map(Sample::error_mm).sum::<f64>() / self.0.len() as f64
    }

    pub fn most(&self, value: impl Fn(&Sample) -> f64) -> f64 {
        self.0.iter().map(value).fold(0.0, f64::max)
    }

    pub fn share(&self, is_so: impl Fn(&&Sample) -> bool) -> f64 {
        self.0.iter().filter(is_so).count() as f64 / self.0.len() as f64
    }

    /// Infinite without obstacles.
    pub fn least_clearance_m(&self) -> f64 {
        let clearances_m = self.0.iter().map(|sample| sample.clearance_m);
        clearances_m.fold(f64::INFINITY, f64::min)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    Never,
    After(Duration),
    AfterQuanta(u32),
}

type Solved = (BendRates, SolveReport, Duration);

pub fn timed_solve(nmpc: &mut Nmpc, input: &SolveInput, end: End) -> Solved {
    let begin = Instant::now();
    let mut is_spent = || matches!(end, End::After(time) if begin.elapsed() >= time);
    let mut budget = match end {
        End::Never => Budget::unlimited(),
        End::After(_) => Budget::new(&mut is_spent),
        End::AfterQuanta(quanta) => Budget::from_quanta(quanta),
    };
    let (rates, report) = nmpc.solve(input, &mut budget);
    (rates, report, begin.elapsed())
}

pub fn run(scene: &Scene, settings: NmpcSettings) -> Result<SceneRun> {
    run_with(scene, settings, End::Never, true, |_, _| ())
}

/// Solves until `end` in each cycle; `solved` sees each input and its plan. Without `checks` the robot executes the plan,
/// whose seed is the number of the cycle. As in a daemon, the first solve was rehearsed: it touches all memory that a
/// solve needs.
pub fn run_with(
    scene: &Scene,
    settings: NmpcSettings,
    end: End,
    checks: bool,
    mut solved: impl FnMut(&SolveInput, &[f64]),
) -> Result<SceneRun> {
    let mut nmpc = scene.solver(settings)?;
    let mut closed = scene.begin(settings)?;
    nmpc.rehearse(&closed.input(), &mut Budget::unlimited());
    let advance = [SceneLoop::advance_unchecked, SceneLoop::advance][usize::from(checks)];
    let mut samples = Vec::with_capacity(scene.cycles as usize);
    while closed.cycle() < scene.cycles {
        let mut input = closed.input();
        input.seed = [closed.cycle(), input.seed][usize::from(checks)];
        let (desired_rates, report, time) = timed_solve(&mut nmpc, &input, end);
        solved(&input, nmpc.plan());
        advance(&mut closed, &desired_rates);
        samples.push(Sample::new(scene, &closed, &report, time));
    }
    Ok(SceneRun(samples))
}

/// Evaluates the cost of a plan without a budget; a short solve may not even have evaluated its warm start.
pub struct PlanEvaluator(Nmpc);

impl PlanEvaluator {
    pub fn new(scene: &Scene, mut settings: NmpcSettings) -> Result<Self> {
        (settings.solver, settings.refinement_steps) = (SolverKind::GaussNewton, 0);
        Ok(Self(scene.solver(settings)?))
    }

    pub fn cost(&mut self, input: &SolveInput, plan: &[f64]) -> f64 {
        self.0.restore_plan(plan, 0);
        let mut input = *input;
        input.elapsed_periods = 0;
        self.0.solve(&input, &mut Budget::unlimited()).1.warm_cost
    }
}
