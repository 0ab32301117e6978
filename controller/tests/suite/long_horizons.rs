//! Twenty steps of horizon where they are hard: a spiral so fast that rates saturate, with obstacles around the body, within a budget.

use cdcr_controller::nmpc::{Nmpc, NmpcSettings, SolveInput, SolverKind};
use cdcr_controller::optimizer::{Budget, QUANTUM_NS};
use cdcr_controller::reference::{ReferenceSample, ReferenceState};
use cdcr_controller::robot::{BendRates, Configuration, Obstacle, Robot, RobotParameters, Shape};
use nalgebra::Vector3;

const PERIOD_S: f64 = 0.005;
const STEPS: u32 = 20;
/// Nominal time of a solve: below a period.
const BUDGET_NS: u32 = 4_500_000;

/// Eq. 8 for the last of three sections of the paper's robot.
fn spiral(robot: &Robot, time_s: f64) -> ReferenceSample {
    let lengths_m: Vec<f64> = robot.sections().iter().map(|s| s.length_m).collect();
    let t = 5.0_f64.to_radians() + time_s;
    let (sin, cos) = t.sin_cos();
    let (sin_part, cos_part) = (t / 15.0).sin_cos();
    let h = 15.0 * lengths_m[2] * sin_part / t;
    ReferenceSample {
        state: ReferenceState::Inside,
        position_m: Vector3::new(
            h * sin_part * cos,
            h * sin_part * sin,
            lengths_m[0] + lengths_m[1] + h * cos_part,
        ),
        ..ReferenceSample::default()
    }
}

/// Sixteen balls around the foot of the last section, 16 mm beyond the safe distance.
fn balls(robot: &Robot, safe_distance_m: f64) -> Vec<Obstacle> {
    let last = robot.sections()[2];
    let apart_m = last.body_radius_m + safe_distance_m + 0.016 + 0.01;
    let ball = |i: usize| {
        let (sin, cos) = (2.4 * i as f64).sin_cos();
        let up_m = (2.05 + 0.2 * i as f64 / 16.0) * last.length_m;
        let centre_m = Vector3::new(apart_m * cos, apart_m * sin, up_m);
        Obstacle::new(Shape::Sphere { centre_m }, 0.01, Vector3::zeros()).unwrap()
    };
    (0..16).map(ball).collect()
}

/// Mean error and least clearance \[m\] over a second, at so many times the speed of the paper's spiral. No guard corrects what is planned.
fn followed(solver: SolverKind, speed: f64, budget_ns: u32) -> [f64; 2] {
    let robot = Robot::new(&RobotParameters::paper(3)).unwrap();
    let settings = NmpcSettings {
        solver,
        horizon_steps: STEPS,
        ..NmpcSettings::default()
    };
    let obstacles = balls(&robot, settings.safe_distance_m);
    let mut nmpc = Nmpc::new(robot.clone(), PERIOD_S, settings).unwrap();
    let bend = 2.0 * 5.0_f64.to_radians() / 15.0;
    let mut at =
        Configuration::from_bend_angles(&[[0.0; 2], [0.0; 2], [bend, 5.0_f64.to_radians()]]);
    let mut previous_rates = BendRates::zero(3);
    let (mut sum_m, mut least_m) = (0.0, f64::INFINITY);
    let cycles = 199;
    for cycle in 0..cycles {
        let at_s = |step: u32| speed * f64::from(cycle + step) * PERIOD_S;
        let window: Vec<_> = (1..=STEPS).map(|step| spiral(&robot, at_s(step))).collect();
        let input = SolveInput {
            configuration: &at,
            previous_rates: &previous_rates,
            reference: &window,
            obstacles: &obstacles,
            tip_offset_m: 0.0,
            elapsed_periods: 1,
            seed: cycle.into(),
        };
        let budget = &mut Budget::of_quanta(budget_ns / QUANTUM_NS);
        let (rates, _) = nmpc.solve(&input, budget);
        at = at.advanced(&rates, PERIOD_S);
        previous_rates = rates;
        sum_m += (robot.tip_position(&at) - window[0].position_m).norm();
        let body = robot.body(&at);
        let clearance_m = body.least_clearance_m(obstacles.iter().copied());
        least_m = least_m.min(clearance_m - settings.safe_distance_m);
    }
    [sum_m / f64::from(cycles), least_m]
}

#[test]
fn a_fast_spiral_among_obstacles_is_followed_within_its_budget() {
    for solver in [SolverKind::KpsoRefined, SolverKind::GaussNewton] {
        let [mean_m, spare_m] = followed(solver, 5.0, BUDGET_NS);
        println!("{solver:?}: {mean_m:.1e} m off, {spare_m:.1e} m beyond the safe distance");
        assert!(mean_m < 1e-7, "{solver:?}: {mean_m} m");
        assert!(spare_m > -1e-9, "{solver:?}: {spare_m} m");
    }
}

#[test]
fn a_plan_that_there_is_no_time_to_mend_is_not_followed_into_an_obstacle() {
    for solver in [SolverKind::KpsoRefined, SolverKind::GaussNewton] {
        let [_, spare_m] = followed(solver, 3.0, BUDGET_NS / 15);
        assert!(spare_m > -1e-9, "{solver:?}: {spare_m} m");
    }
}
