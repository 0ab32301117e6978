//! One robot tracking one curve, cycle by cycle, as fast as it can be computed.

use std::time::{Duration, Instant};

use anyhow::Result;
use cdcr_client::model::orientation_of;
use cdcr_controller::closed_loop;
use cdcr_controller::nmpc::{Nmpc, NmpcSettings, SolveInput, SolveReport, SolverKind};
use cdcr_controller::optimizer::Budget;
use cdcr_controller::reference::{Orientation, ReferenceSample, ReferenceState};
use cdcr_controller::robot::{BendRates, Configuration, Pose};
use derive_more::{Deref, DerefMut};
use nalgebra::Vector3;

use crate::scene::Scene;

/// The ideal robot in a scene, with the safety checks of its commands, around any solver. The solver gets the
/// exact curve at each step of its horizon. No command is lost, and the robot stops at once. Therefore the
/// clearance guard certifies each command for one period, whereas a daemon certifies three periods and a
/// ramp.
#[derive(Deref, DerefMut)]
pub struct ClosedLoop<'a> {
    scene: &'a Scene,
    #[deref]
    #[deref_mut]
    inner: closed_loop::ClosedLoop<Box<dyn Fn(f64) -> ReferenceSample + 'a>>,
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
}

impl Sample {
    pub fn offset_mm(&self) -> Vector3<f64> {
        1e3 * (self.tip.position_m - self.reference_m)
    }

    pub fn error_mm(&self) -> f64 {
        self.offset_mm().norm()
    }
}

impl<'a> ClosedLoop<'a> {
    pub fn new(scene: &'a Scene, settings: NmpcSettings) -> Result<Self> {
        let reference_at = |time_s| ReferenceSample {
            orientation: orientation_of(scene.curve.orientation(time_s)),
            ..inside(scene.curve.position_m(time_s).into())
        };
        let inner = closed_loop::ClosedLoop::new(
            &scene.robot,
            scene.period_s,
            settings,
            scene.start,
            &scene.obstacles,
            Box::new(reference_at) as Box<dyn Fn(f64) -> ReferenceSample + 'a>,
        )?;
        Ok(Self { scene, inner })
    }

    pub fn is_over(&self) -> bool {
        self.inner.cycle() >= self.scene.cycles
    }

    /// Sample of the state that the previous cycle led to.
    pub fn sample(&self, solve_time: Duration) -> Sample {
        let configuration = *self.inner.configuration();
        Sample {
            time_s: self.inner.time_s(),
            reference_m: self.scene.point_m(self.inner.cycle()),
            tip: self.scene.robot.tip_pose(&configuration),
            configuration,
            rates: self.inner.command().rates,
            clearance_m: self.inner.clearance_m(),
            solve_ns: solve_time.as_nanos() as u64,
        }
    }
}

/// A point inside a reference, without an orientation.
pub fn inside(position_m: Vector3<f64>) -> ReferenceSample {
    ReferenceSample {
        state: ReferenceState::Inside,
        position_m,
        orientation: Orientation::Free,
    }
}

/// Condition that ends a solve.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    Never,
    After(Duration),
    AfterQuanta(u32),
}

/// Solves, and returns the duration, too.
pub fn timed_solve(
    nmpc: &mut Nmpc,
    input: &SolveInput,
    end: End,
) -> (BendRates, SolveReport, Duration) {
    let begin = Instant::now();
    let mut is_spent = || matches!(end, End::After(time) if begin.elapsed() >= time);
    let mut budget = match end {
        End::Never => Budget::unlimited(),
        End::After(_) => Budget::new(&mut is_spent),
        End::AfterQuanta(quanta) => Budget::of_quanta(quanta),
    };
    let (rates, report) = nmpc.solve(input, &mut budget);
    (rates, report, begin.elapsed())
}

/// Runs the scene with one controller and returns a sample for every cycle.
pub fn run(scene: &Scene, settings: NmpcSettings) -> Result<Vec<Sample>> {
    let mut nmpc = Nmpc::new(scene.robot.clone(), scene.period_s, settings)?;
    let mut closed = ClosedLoop::new(scene, settings)?;
    let mut samples = Vec::with_capacity(scene.cycles as usize);
    while !closed.is_over() {
        let (desired_rates, _, time) = timed_solve(&mut nmpc, &closed.input(), End::Never);
        closed.advance(&desired_rates);
        samples.push(closed.sample(time));
    }
    Ok(samples)
}

/// Evaluates the cost of a plan without a budget; a short solve may not even have evaluated its warm start.
pub struct PlanEvaluator(Nmpc);

impl PlanEvaluator {
    pub fn new(scene: &Scene, settings: NmpcSettings) -> Result<Self> {
        let settings = NmpcSettings {
            solver: SolverKind::GaussNewton,
            refinement_steps: 0,
            ..settings
        };
        let nmpc = Nmpc::new(scene.robot.clone(), scene.period_s, settings)?;
        Ok(Self(nmpc))
    }

    pub fn cost(&mut self, input: &SolveInput, plan: &[f64]) -> f64 {
        self.0.restore_plan(plan, 0);
        let input = SolveInput {
            elapsed_periods: 0,
            ..*input
        };
        self.0.solve(&input, &mut Budget::unlimited()).1.warm_cost
    }
}
