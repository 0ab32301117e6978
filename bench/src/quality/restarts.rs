//! How often a solver ends above the best known cost, from a random shape to the tip position of another one.

use std::f64::consts::TAU;
use std::time::Instant;

use anyhow::{Result, bail};
use cdcr_controller::nmpc::{Horizon, Nmpc, NmpcSettings, SolveInput, SolverKind};
use cdcr_controller::optimizer::{Budget, QUANTUM_NS, cycle_seed};
use cdcr_controller::reference::ReferenceSample;
use cdcr_controller::robot::{BendRates, Configuration, Obstacle, Robot, RobotParameters, Shape};
use nalgebra::Vector3;
use serde_json::{Value, json};

use crate::chart::{BLUE, GREEN, GREY, ORANGE, RGBColor, SKY, YELLOW};
use crate::dataset::number;
use crate::named::named;
use crate::numbers::Numbers;

/// So long that the horizon reaches the target; so short that no obstacle is passed between two steps \[s\].
const PERIOD_S: f64 = 0.03;
const HORIZON_STEPS: u32 = 30;
const SECTIONS: usize = 3;
/// Largest bend of a section of a random shape \[rad\].
const BEND_MAX_RAD: f64 = 1.2;
const APART_M: std::ops::Range<f64> = 0.25..0.6;
const SAFE_DISTANCE_M: f64 = 0.01;
/// Least clearance of the start and target shapes \[m\].
const CLEAR_M: f64 = 1.5 * SAFE_DISTANCE_M;
const BALL_RADIUS_M: f64 = 0.05;
/// Radius and half length of a post \[m\].
const POST_M: (f64, f64) = (0.015, 0.2);
/// Largest offset of a post from the straight line along x and y \[m\].
const BESIDE_M: f64 = 0.06;
const DRAWS_MAX: u32 = 10_000;

/// A solver is stuck if its cost exceeds the best one by more than this share.
pub(super) const STUCK_SHARE: f64 = 0.01;
/// Smaller cost differences are ignored: a tenth of a millimetre at each of 30 steps \[m²\].
const STUCK_FLOOR_M2: f64 = 30.0 * 1e-8;
/// A plan that ends farther from the target has not arrived \[mm\].
const ARRIVED_MM: f64 = 10.0;
const SOLVES_MAX: u32 = 20;
/// Solves without progress that end it: more than one, because each has other random numbers.
const IDLE_SOLVES_MAX: u32 = 2;
/// A smaller decrease of the cost, as a share, does not count as progress.
const PROGRESS_SHARE: f64 = 1e-4;
/// Largest absolute rate of a random plan \[rad/s\].
const RANDOM_RATE_RAD_S: f64 = 2.0;

#[derive(Debug)]
pub struct Contender {
    pub name: &'static str,
    pub solver: SolverKind,
    /// Number of random start plans in addition to the plan at rest; the best result counts.
    random_plans: u64,
    /// Work limit of all its solves together.
    quanta: u32,
    pub(super) colour: RGBColor,
}

#[rustfmt::skip]
pub const CONTENDERS: [Contender; 6] = [
    contender("kpso", SolverKind::Kpso, 0, u32::MAX, GREEN),
    contender("gauss-newton", SolverKind::GaussNewton, 0, u32::MAX, ORANGE),
    contender("gauss-newton-restarted", SolverKind::GaussNewton, 3, u32::MAX, GREY),
    contender("kpso-refined", SolverKind::KpsoRefined, 0, u32::MAX, BLUE),
    contender("kpso-refined-20ms", SolverKind::KpsoRefined, 0, 20_000_000 / QUANTUM_NS, SKY),
    contender("kpso-refined-5ms", SolverKind::KpsoRefined, 0, 5_000_000 / QUANTUM_NS, YELLOW),
];

#[rustfmt::skip]
const fn contender(name: &'static str, solver: SolverKind, random_plans: u64, quanta: u32, colour: RGBColor) -> Contender {
    Contender { name, solver, random_plans, quanta, colour }
}

named! {
    /// Obstacles between the tip and its target.
    pub enum Field {
        Free = "free",
        /// A ball in the middle of the straight line.
        Ball = "ball",
        /// Three posts on or beside the straight line.
        Posts = "posts",
    }
}

impl Field {
    fn obstacles(
        self,
        way: impl Fn(f64) -> Vector3<f64>,
        numbers: &mut Numbers,
    ) -> Result<Vec<Obstacle>> {
        let still = Vector3::zeros();
        let post = |share| {
            let [x, y] = [(); 2].map(|()| numbers.between(-BESIDE_M, BESIDE_M));
            let middle_m = way(share) + Vector3::new(x, y, 0.0);
            let half_m = Vector3::new(0.0, 0.0, POST_M.1);
            let (start_m, end_m) = (middle_m - half_m, middle_m + half_m);
            Obstacle::new(Shape::Capsule { start_m, end_m }, POST_M.0, still)
        };
        let centre_m = way(0.5);
        let ball = Shape::Sphere { centre_m };
        Ok(match self {
            Self::Free => Vec::new(),
            Self::Ball => vec![Obstacle::new(ball, BALL_RADIUS_M, still)?],
            Self::Posts => {
                let posts = [0.3, 0.5, 0.7].into_iter().map(post);
                posts.collect::<Result<_, _>>()?
            }
        })
    }
}

/// A shape at rest, a reachable target for its tip, and obstacles that both are clear of.
struct ReachProblem {
    start: Configuration,
    target_m: Vector3<f64>,
    obstacles: Vec<Obstacle>,
}

impl ReachProblem {
    fn draw(field: Field, robot: &Robot, seed: u64) -> Result<Self> {
        let mut numbers = Numbers::new(cycle_seed(seed, field as u64));
        for _ in 0..DRAWS_MAX {
            let [start, end] = [(); 2].map(|()| shape(&mut numbers));
            let [from_m, target_m] = [start, end].map(|shape| robot.tip_pose(&shape).position_m);
            let way = |share| from_m + share * (target_m - from_m);
            let obstacles = field.obstacles(way, &mut numbers)?;
            let is_clear = |shape| {
                let body = robot.body(shape);
                body.least_clearance_m(obstacles.iter().copied()) > CLEAR_M
            };
            let is_apart = APART_M.contains(&(target_m - from_m).norm());
            if is_apart && is_clear(&start) && is_clear(&end) {
                return Ok(Self {
                    start,
                    target_m,
                    obstacles,
                });
            }
        }
        let name = field.name();
        bail!("{name}: none of {DRAWS_MAX} random problems is clear; make the obstacles smaller")
    }

    fn end_error_mm(&self, robot: &Robot, plan: &[f64]) -> f64 {
        let width = robot.coordinate_count();
        let horizon = Horizon::new(&settings(SolverKind::GaussNewton), width);
        let mut end = self.start;
        for step in 0..horizon.steps() {
            let rates = &plan[horizon.block_of(step) * width..][..width];
            for (bend_rad, rate) in end.as_mut_slice().iter_mut().zip(rates) {
                *bend_rad += rate * PERIOD_S;
            }
        }
        1e3 * (robot.tip_pose(&end).position_m - self.target_m).norm()
    }
}

fn shape(numbers: &mut Numbers) -> Configuration {
    let mut below = |most: f64| numbers.between(0.0, most);
    Configuration::from_bend_angles(&[(); SECTIONS].map(|()| [below(BEND_MAX_RAD), below(TAU)]))
}

fn settings(solver: SolverKind) -> NmpcSettings {
    NmpcSettings {
        solver,
        horizon_steps: HORIZON_STEPS,
        control_blocks: 5,
        swarm_size: 32,
        swarm_iterations: 40,
        refinement_steps: 25,
        safe_distance_m: SAFE_DISTANCE_M,
        ..NmpcSettings::default()
    }
}

pub(super) fn contest(field: Field, seed: u64) -> Result<Vec<Value>> {
    let robot = Robot::new(&RobotParameters::paper(SECTIONS))?;
    let problem = ReachProblem::draw(field, &robot, seed)?;
    let row = |contender| compete(contender, &robot, field, &problem, seed);
    let mut rows: Vec<Value> = CONTENDERS.iter().map(row).collect::<Result<_>>()?;
    let costs = rows.iter().filter_map(|row| number(row, "cost"));
    let best_cost = costs.fold(f64::INFINITY, f64::min);
    for row in &mut rows {
        row["best_cost"] = best_cost.into();
    }
    Ok(rows)
}

/// Solves from rest and from each random plan, again and again until the cost no longer decreases.
fn compete(
    contender: &Contender,
    robot: &Robot,
    field: Field,
    problem: &ReachProblem,
    seed: u64,
) -> Result<Value> {
    let begin = Instant::now();
    let mut nmpc = Nmpc::new(robot.clone(), PERIOD_S, settings(contender.solver))?;
    let (mut best_cost, mut best_plan) = (f64::INFINITY, nmpc.plan().to_vec());
    let (mut solves, mut quanta_left) = (0_u64, contender.quanta);
    let still = BendRates::zero(SECTIONS);
    let reference = vec![ReferenceSample::at_position(problem.target_m); HORIZON_STEPS as usize];
    let random = (0..contender.random_plans).map(Some);
    for random_plan in std::iter::once(None).chain(random) {
        if let Some(number) = random_plan {
            let mut numbers = Numbers::new(cycle_seed(seed, number));
            let rate = |_: &f64| numbers.between(-RANDOM_RATE_RAD_S, RANDOM_RATE_RAD_S);
            let plan: Vec<f64> = best_plan.iter().map(rate).collect();
            nmpc.restore_plan(&plan, 0);
        }
        let (mut cost, mut idle) = (f64::INFINITY, 0);
        for _ in 0..SOLVES_MAX {
            let input = SolveInput {
                configuration: &problem.start,
                previous_rates: &still,
                reference: &reference,
                obstacles: &problem.obstacles,
                tip_offset_m: 0.0,
                elapsed_periods: 0,
                seed: cycle_seed(seed, solves),
            };
            let (_, report) = nmpc.solve(&input, &mut Budget::from_quanta(quanta_left));
            quanta_left -= report.quanta;
            solves += 1;
            let better = report.cost < cost * (1.0 - PROGRESS_SHARE);
            idle = if better { 0 } else { idle + 1 };
            cost = cost.min(report.cost);
            if idle >= IDLE_SOLVES_MAX || quanta_left == 0 {
                break;
            }
        }
        if cost < best_cost {
            best_cost = cost;
            best_plan.copy_from_slice(nmpc.plan());
        }
    }
    Ok(json!({
        "field": field,
        "seed": seed,
        "contender": contender.name,
        "cost": best_cost,
        "end_error_mm": problem.end_error_mm(robot, &best_plan),
        "solves": solves,
        "time_ms": 1e3 * begin.elapsed().as_secs_f64(),
    }))
}

fn cost(row: &Value, key: &str) -> f64 {
    row[key].as_f64().unwrap_or(f64::NAN)
}

pub(super) fn excess_share(row: &Value) -> f64 {
    cost(row, "cost") / cost(row, "best_cost") - 1.0
}

pub(super) fn is_stuck(row: &Value) -> bool {
    cost(row, "cost") > cost(row, "best_cost") * (1.0 + STUCK_SHARE) + STUCK_FLOOR_M2
}

pub(super) fn arrives(row: &Value) -> bool {
    number(row, "end_error_mm").is_some_and(|mm| mm <= ARRIVED_MM)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn problems_can_be_solved_and_are_the_same_again() {
        let robot = Robot::new(&RobotParameters::paper(SECTIONS)).unwrap();
        let problems = |field| (0..20).map(move |seed| (field, seed));
        for (field, seed) in Field::ALL.into_iter().flat_map(problems) {
            let draw = |seed| ReachProblem::draw(field, &robot, seed).unwrap();
            let problem = draw(seed);
            assert_eq!(problem.target_m, draw(seed).target_m);
            assert_ne!(problem.target_m, draw(seed + 1000).target_m);
            let from_m = robot.tip_pose(&problem.start).position_m;
            assert!(APART_M.contains(&(problem.target_m - from_m).norm()));
            let body = robot.body(&problem.start);
            assert!(body.least_clearance_m(problem.obstacles) > SAFE_DISTANCE_M);
        }
    }

    #[test]
    fn a_solver_ends_at_the_target_and_another_start_or_more_time_does_no_harm() {
        for row in contest(Field::Free, 3).unwrap() {
            assert!(arrives(&row) && excess_share(&row) < 0.05, "{row}");
        }
        let rows = contest(Field::Ball, 0).unwrap();
        let [once, again] = [&rows[1], &rows[2]];
        assert!(again["solves"].as_u64() > once["solves"].as_u64());
        assert!(excess_share(again) <= excess_share(once));
        let is_best = |row: &&Value| row["cost"] == row["best_cost"];
        let best = rows.iter().find(is_best).unwrap();
        assert!(!is_stuck(best) && excess_share(best) == 0.0);
    }

    #[test]
    fn a_new_plan_takes_the_better_way_in_time() {
        let ball = [5, 2013, 3006].map(|seed| (Field::Ball, seed, "kpso-refined-5ms"));
        let posts = [1010, 3019].map(|seed| (Field::Posts, seed, "kpso-refined-20ms"));
        for (field, seed, contender) in ball.into_iter().chain(posts) {
            let rows = contest(field, seed).unwrap();
            let found = rows
                .iter()
                .find(|row| row["contender"] == contender)
                .unwrap();
            assert!(!is_stuck(found), "{found}");
        }
    }
}
