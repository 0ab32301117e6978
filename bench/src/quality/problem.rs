//! A random optimal control problem: from one shape to where the tip of another one is.

use std::f64::consts::TAU;

use anyhow::{Result, bail};
use cdcr_controller::nmpc::{Horizon, NmpcSettings, SolveInput};
use cdcr_controller::optimizer::cycle_seed;
use cdcr_controller::reference::{Orientation, ReferenceSample, ReferenceState};
use cdcr_controller::robot::{BendRates, Configuration, Obstacle, Robot, Shape};
use nalgebra::Vector3;

use crate::experiment::Solver;
use crate::named::named;
use crate::numbers::Numbers;

/// A long step, so that the horizon reaches to the target \[s\]. The tip makes 40 mm in it, and no obstacle
/// is so thin that it could be passed between two steps.
pub(super) const PERIOD_S: f64 = 0.03;
const HORIZON_STEPS: u32 = 30;
const BLOCKS: u32 = 5;
const SWARM: (u32, u32) = (32, 40);
const REFINEMENTS: u32 = 25;
pub(super) const SECTIONS: usize = 3;
/// Largest bend of a section of a random shape \[rad\].
const BEND_MAX_RAD: f64 = 1.2;
const APART_M: std::ops::Range<f64> = 0.25..0.6;
const SAFE_DISTANCE_M: f64 = 0.01;
/// Start and target shape keep so many of it.
const CLEAR_DISTANCES: f64 = 1.5;
const BALL_RADIUS_M: f64 = 0.05;
/// Radius of a post, and half its length \[m\].
const POST_M: (f64, f64) = (0.015, 0.2);
/// How far a post may be beside the straight way, along x and y \[m\].
const BESIDE_M: f64 = 0.06;
/// Draws after which a problem is given up.
const DRAWS_MAX: u32 = 10_000;

named! {
    /// What stands between the tip and its target.
    pub enum Field {
        Free = "free",
        /// A ball in the middle of the straight way.
        Ball = "ball",
        /// Three posts beside the straight way or on it.
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
        let mut obstacles = Vec::new();
        match self {
            Self::Free => {}
            Self::Ball => {
                let centre_m = way(0.5);
                let ball = Shape::Sphere { centre_m };
                obstacles.push(Obstacle::new(ball, BALL_RADIUS_M, still)?);
            }
            Self::Posts => {
                for share in [0.3, 0.5, 0.7] {
                    let [x, y] = [(); 2].map(|()| numbers.between(-BESIDE_M, BESIDE_M));
                    let middle_m = way(share) + Vector3::new(x, y, 0.0);
                    let half_m = Vector3::new(0.0, 0.0, POST_M.1);
                    let post = Shape::Capsule {
                        start_m: middle_m - half_m,
                        end_m: middle_m + half_m,
                    };
                    obstacles.push(Obstacle::new(post, POST_M.0, still)?);
                }
            }
        }
        Ok(obstacles)
    }
}

fn shape(numbers: &mut Numbers) -> Configuration {
    let bend_rad = |()| {
        [
            numbers.between(0.0, BEND_MAX_RAD),
            numbers.between(0.0, TAU),
        ]
    };
    Configuration::from_bend_angles(&[(); SECTIONS].map(bend_rad))
}

/// A shape at rest, a target for its tip that it can reach, and what stands around. Both are clear.
#[derive(Debug, Clone)]
pub(super) struct Problem {
    start: Configuration,
    still: BendRates,
    target_m: Vector3<f64>,
    reference: Vec<ReferenceSample>,
    obstacles: Vec<Obstacle>,
}

impl Problem {
    pub(super) fn draw(field: Field, robot: &Robot, seed: u64) -> Result<Self> {
        let mut numbers = Numbers::new(cycle_seed(seed, field as u64));
        for _ in 0..DRAWS_MAX {
            let (start, end) = (shape(&mut numbers), shape(&mut numbers));
            let [from_m, to_m] = [&start, &end].map(|shape| robot.tip_pose(shape).position_m);
            let way = |share: f64| from_m + (to_m - from_m) * share;
            let obstacles = field.obstacles(way, &mut numbers)?;
            let is_clear = |shape: &Configuration| {
                let body = robot.body(shape);
                let least_m = CLEAR_DISTANCES * SAFE_DISTANCE_M;
                obstacles.iter().all(|o| body.clearance_m(o) > least_m)
            };
            let is_apart = APART_M.contains(&(to_m - from_m).norm());
            if is_apart && is_clear(&start) && is_clear(&end) {
                return Ok(Self::new(start, to_m, obstacles));
            }
        }
        let name = field.name();
        bail!("{name}: none of {DRAWS_MAX} random problems is clear; make the obstacles smaller")
    }

    fn new(start: Configuration, target_m: Vector3<f64>, obstacles: Vec<Obstacle>) -> Self {
        let sample = ReferenceSample {
            state: ReferenceState::Inside,
            position_m: target_m,
            orientation: Orientation::Free,
        };
        Self {
            start,
            still: BendRates::zero(SECTIONS),
            target_m,
            reference: vec![sample; HORIZON_STEPS as usize],
            obstacles,
        }
    }

    /// What a solve with this seed starts from, from the plan that is there.
    pub(super) fn input(&self, seed: u64) -> SolveInput<'_> {
        SolveInput {
            configuration: &self.start,
            previous_rates: &self.still,
            reference: &self.reference,
            obstacles: &self.obstacles,
            tip_offset_m: 0.0,
            elapsed_periods: 0,
            seed,
        }
    }

    /// Where a plan leads the tip, from the target \[mm\].
    pub(super) fn end_error_mm(&self, robot: &Robot, plan: &[f64]) -> f64 {
        let width = robot.coordinate_count();
        let horizon = Horizon::new(&settings(Solver::GaussNewton), width);
        let mut end = self.start;
        for step in 0..horizon.steps() {
            let block = horizon.block_of(step);
            let rates = &plan[block * width..(block + 1) * width];
            for (bend_rad, rate) in end.as_mut_slice().iter_mut().zip(rates) {
                *bend_rad += rate * PERIOD_S;
            }
        }
        1e3 * (robot.tip_pose(&end).position_m - self.target_m).norm()
    }
}

pub(super) fn settings(solver: Solver) -> NmpcSettings {
    solver.of(NmpcSettings {
        horizon_steps: HORIZON_STEPS,
        control_blocks: BLOCKS,
        swarm_size: SWARM.0,
        swarm_iterations: SWARM.1,
        refinement_steps: REFINEMENTS,
        safe_distance_m: SAFE_DISTANCE_M,
        ..NmpcSettings::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use cdcr_controller::robot::RobotParameters;

    #[test]
    fn problems_can_be_solved_and_are_the_same_again() {
        let robot = Robot::new(&RobotParameters::paper(SECTIONS)).unwrap();
        for field in Field::ALL {
            for seed in 0..20 {
                let problem = Problem::draw(field, &robot, seed).unwrap();
                let again = Problem::draw(field, &robot, seed).unwrap();
                assert_eq!(problem.target_m, again.target_m);
                let from_m = robot.tip_pose(&problem.start).position_m;
                assert!(APART_M.contains(&(problem.target_m - from_m).norm()));
                let body = robot.body(&problem.start);
                for obstacle in &problem.obstacles {
                    assert!(body.clearance_m(obstacle) > SAFE_DISTANCE_M);
                }
                let other = Problem::draw(field, &robot, seed + 1000).unwrap();
                assert_ne!(problem.target_m, other.target_m);
            }
        }
    }
}
