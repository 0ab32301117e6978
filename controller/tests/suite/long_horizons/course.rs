//! A robot that follows a reference with a long horizon, and the result.

use cdcr_controller::closed_loop::Scene;
use cdcr_controller::nmpc::{Nmpc, NmpcSettings, SolveInput, SolverKind};
use cdcr_controller::optimizer::Budget;
use cdcr_controller::reference::ReferenceSample;
use cdcr_controller::robot::{BendRates, Configuration, Obstacle, Robot};
use nalgebra::Vector3;

use super::{PERIOD_S, STEPS};
use crate::{input, inside};

pub(super) type Curve = fn(&Robot, f64) -> ReferenceSample;

/// Eq. 8 for the last of three sections of the paper's robot.
pub(super) fn spiral(robot: &Robot, time_s: f64) -> ReferenceSample {
    let t = 5.0_f64.to_radians() + time_s;
    let bent = Configuration::from_bend_angles(&[[0.0; 2], [0.0; 2], [2.0 * t / 15.0, t]]);
    inside(robot.tip_position(&bent))
}

/// A robot that executes the plan exactly, without a guard.
pub(super) struct Course {
    pub(super) robot: Robot,
    pub(super) settings: NmpcSettings,
    pub(super) obstacles: Vec<Obstacle>,
    pub(super) at: Configuration,
    pub(super) reference: Curve,
    /// Speed of the reference as a multiple of the paper's.
    pub(super) speed: f64,
    pub(super) cycles: u32,
}

impl Course {
    /// A second of the paper's spiral at a multiple of its speed, with or without balls.
    pub(super) fn spiral(solver: SolverKind, speed: f64, among_balls: bool) -> Self {
        let settings = NmpcSettings {
            solver,
            horizon_steps: STEPS,
            ..NmpcSettings::default()
        };
        let count = if among_balls { 16 } else { 0 };
        let scene = Scene::spiral(3).unwrap();
        let scene = scene.crowded(count, settings.safe_distance_m, 0).unwrap();
        Self {
            obstacles: scene.obstacles,
            at: scene.start,
            robot: scene.robot,
            settings,
            reference: spiral,
            speed,
            cycles: 199,
        }
    }

    /// The same with an upright capsule instead of each `every`-th ball.
    pub(super) fn with_capsules(mut self, every: usize) -> Self {
        let scene = Scene::spiral(3).unwrap();
        let (count, safe_m) = (self.obstacles.len(), self.settings.safe_distance_m);
        self.obstacles = scene.crowded(count, safe_m, every).unwrap().obstacles;
        self
    }

    pub(super) fn lasting(self, cycles: u32) -> Self {
        Self { cycles, ..self }
    }

    /// The same with this number of horizon steps.
    pub(super) fn with_steps(mut self, steps: u32) -> Self {
        self.settings.horizon_steps = steps;
        self
    }

    /// A goal 15 cm beside the tip, from the first cycle on, for 0.2 s.
    pub(super) fn jump(solver: SolverKind) -> Self {
        Self {
            at: Configuration::from_bend_angles(&[[0.5, 0.0], [0.3, 1.0], [0.4, 2.0]]),
            reference: |robot, _| {
                let start = Configuration::from_bend_angles(&[[0.5, 0.0], [0.3, 1.0], [0.4, 2.0]]);
                inside(robot.tip_position(&start) + Vector3::new(-0.1, 0.1, -0.05))
            },
            cycles: 40,
            ..Self::spiral(solver, 1.0, false)
        }
    }

    fn obstacles_at(&self, cycle: u32) -> Vec<Obstacle> {
        let time_s = f64::from(cycle) * PERIOD_S;
        self.obstacles.iter().map(|one| one.moved(time_s)).collect()
    }

    /// Mean distance from the reference of a robot that stays at rest.
    pub(super) fn mean_at_rest_m(&self) -> f64 {
        let tip_m = self.robot.tip_position(&self.at);
        let errors = (1..=self.cycles).map(|cycle| {
            let time_s = self.speed * f64::from(cycle) * PERIOD_S;
            ((self.reference)(&self.robot, time_s).position_m - tip_m).norm()
        });
        errors.sum::<f64>() / f64::from(self.cycles)
    }

    /// Solves each cycle with a budget of `quanta`.
    pub(super) fn run(&self, quanta: u32) -> Outcome {
        let mut nmpc = Nmpc::new(self.robot.clone(), PERIOD_S, self.settings).unwrap();
        let (mut at, mut previous_rates) = (self.at, BendRates::zero(3));
        let (mut sum_m, mut last_m, mut least_m) = (0.0, 0.0, f64::INFINITY);
        let (mut first_cost, mut work, mut largest_work) = (None, 0, 0);
        for cycle in 0..self.cycles {
            let at_s = |step: u32| self.speed * f64::from(cycle + step) * PERIOD_S;
            let window: Vec<_> = (1..=self.settings.horizon_steps)
                .map(|step| (self.reference)(&self.robot, at_s(step)))
                .collect();
            let input = SolveInput {
                obstacles: &self.obstacles_at(cycle),
                seed: cycle.into(),
                ..input(&at, &previous_rates, &window)
            };
            let (rates, report) = nmpc.solve(&input, &mut Budget::from_quanta(quanta));
            assert!(report.cost <= report.warm_cost, "{report:?}");
            first_cost.get_or_insert(report.cost);
            work += report.quanta;
            largest_work = largest_work.max(report.quanta);
            at = at.advanced(&rates, PERIOD_S);
            previous_rates = rates;
            last_m = (self.robot.tip_position(&at) - window[0].position_m).norm();
            sum_m += last_m;
            let body = self.robot.body(&at);
            let clearance_m = body.least_clearance_m(self.obstacles_at(cycle + 1));
            least_m = least_m.min(clearance_m - self.settings.safe_distance_m);
        }
        Outcome {
            mean_m: sum_m / f64::from(self.cycles),
            last_m,
            spare_m: least_m,
            first_cost: first_cost.unwrap(),
            work,
            largest_work,
            tip_m: self.robot.tip_position(&at),
        }
    }
}

/// Tracking error, and violation of the safe distance.
#[derive(Debug)]
pub(super) struct Outcome {
    pub(super) mean_m: f64,
    pub(super) last_m: f64,
    pub(super) spare_m: f64,
    /// Cost of the plan of the first cycle.
    pub(super) first_cost: f64,
    /// Quanta of all cycles.
    pub(super) work: u32,
    /// Quanta of the cycle with the most of them.
    pub(super) largest_work: u32,
    /// Position of the tip at the end.
    pub(super) tip_m: Vector3<f64>,
}
