//! One robot tracking one curve, cycle by cycle, as fast as it can be computed.

use std::time::{Duration, Instant};

use anyhow::Result;
use cdcr_client::Trajectory;
use cdcr_client::model::orientation_of;
use cdcr_controller::closed_loop;
use cdcr_controller::nmpc::{
    Nmpc, NmpcSettings, SettingsError, SolveInput, SolveReport, SolverKind,
};
use cdcr_controller::optimizer::Budget;
use cdcr_controller::reference::ReferenceSample;
use cdcr_controller::robot::{BendRates, Configuration, Obstacle, Pose, Robot, Shape};
use nalgebra::Vector3;

pub const PERIOD_S: f64 = 0.005;

pub struct Scene {
    pub robot: Robot,
    pub start: Configuration,
    /// The curve. Time 0 is the first release; it lasts longer than the samples.
    pub curve: Box<dyn Trajectory + Send>,
    /// Obstacles at time 0; each moves at its velocity.
    pub obstacles: Vec<Obstacle>,
    pub cycles: u64,
}

impl Scene {
    #[must_use]
    pub fn at_most(mut self, cycles: u64) -> Self {
        self.cycles = self.cycles.min(cycles);
        self
    }

    pub fn time_s(&self, cycle: u64) -> f64 {
        cycle as f64 * PERIOD_S
    }

    pub fn point_m(&self, cycle: u64) -> Vector3<f64> {
        Vector3::from(self.curve.position_m(self.time_s(cycle)))
    }

    /// Centre of the first ball; infinite without one.
    pub fn obstacle_m(&self) -> Vector3<f64> {
        match self.obstacles.first().map(Obstacle::shape) {
            Some(Shape::Sphere { centre_m }) => *centre_m,
            _ => Vector3::repeat(f64::INFINITY),
        }
    }

    pub fn solver(&self, settings: NmpcSettings) -> Result<Nmpc, SettingsError> {
        Nmpc::new(self.robot.clone(), PERIOD_S, settings)
    }

    pub fn begin(&self, settings: NmpcSettings) -> Result<ClosedLoop<'_>, SettingsError> {
        let reference_at = |time_s| ReferenceSample {
            orientation: orientation_of(self.curve.orientation(time_s)),
            ..ReferenceSample::at(self.curve.position_m(time_s).into())
        };
        let (robot, start, obstacles) = (&self.robot, self.start, &self.obstacles);
        let reference_at = Box::new(reference_at);
        ClosedLoop::new(robot, PERIOD_S, settings, start, obstacles, reference_at)
    }

    pub fn sample(&self, closed: &ClosedLoop<'_>, solve_time: Duration) -> Sample {
        let configuration = *closed.configuration();
        Sample {
            time_s: closed.time_s(),
            reference_m: self.point_m(closed.cycle()),
            tip: self.robot.tip_pose(&configuration),
            configuration,
            rates: closed.command().rates,
            clearance_m: closed.clearance_m(),
            solve_ns: solve_time.as_nanos() as u64,
        }
    }
}

/// The ideal robot in a scene, with the safety checks of its commands. No command is lost, and the robot stops at
/// once: the clearance guard certifies each command for one period, a daemon for three periods and a ramp.
pub type ClosedLoop<'a> = closed_loop::ClosedLoop<Box<dyn Fn(f64) -> ReferenceSample + 'a>>;

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
}

impl Sample {
    pub fn offset_mm(&self) -> Vector3<f64> {
        1e3 * (self.tip.position_m - self.reference_m)
    }

    pub fn error_mm(&self) -> f64 {
        self.offset_mm().norm()
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

pub fn run(scene: &Scene, settings: NmpcSettings) -> Result<Vec<Sample>> {
    let mut nmpc = scene.solver(settings)?;
    let mut closed = scene.begin(settings)?;
    let mut samples = Vec::with_capacity(scene.cycles as usize);
    while closed.cycle() < scene.cycles {
        let (desired_rates, _, time) = timed_solve(&mut nmpc, &closed.input(), End::Never);
        closed.advance(&desired_rates);
        samples.push(scene.sample(&closed, time));
    }
    Ok(samples)
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
