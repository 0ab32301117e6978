//! Random restarts: how often a solver ends above the best that is known.

use std::time::Instant;

use anyhow::Result;
use cdcr_controller::nmpc::Nmpc;
use cdcr_controller::optimizer::{Budget, QUANTUM_NS, cycle_seed};
use cdcr_controller::robot::{Robot, RobotParameters};
use serde::Serialize;

use super::problem::{Field, PERIOD_S, Problem, SECTIONS, settings};
use crate::experiment::Solver;
use crate::named::named;
use crate::numbers::Numbers;

/// More than this share above the best cost is stuck.
pub const STUCK_SHARE: f64 = 0.01;
/// Differences of cost below this are none: a tenth of a millimetre at each of 30 steps \[m²\].
pub const STUCK_FLOOR_M2: f64 = 30.0 * 1e-8;
/// A plan that ends further from the target has not arrived \[mm\].
pub const ARRIVED_MM: f64 = 10.0;
const SOLVES_MAX: u32 = 20;
/// Solves without progress after which a solver has ended: its swarm draws other numbers in each.
const IDLE_SOLVES_MAX: u32 = 2;
/// Less than this share of the cost is no progress.
const PROGRESS_SHARE: f64 = 1e-4;
/// Random plans that Gauss-Newton starts from, besides the plan of rest.
const RANDOM_PLANS: u64 = 3;
/// Rates of a random plan, either way \[rad/s\].
const RANDOM_RATE_RAD_S: f64 = 2.0;

named! {
    pub enum Contender {
        Kpso = "kpso",
        GaussNewton = "gauss-newton",
        /// Gauss-Newton from rest and from three random plans; the best of the four.
        GaussNewtonRestarted = "gauss-newton-restarted",
        KpsoRefined = "kpso-refined",
        /// The same with so much work for all solves.
        KpsoRefined20Ms = "kpso-refined-20ms",
        KpsoRefined5Ms = "kpso-refined-5ms",
    }
}

impl Contender {
    pub(super) fn solver(self) -> Solver {
        match self {
            Self::Kpso => Solver::Kpso,
            Self::GaussNewton | Self::GaussNewtonRestarted => Solver::GaussNewton,
            Self::KpsoRefined | Self::KpsoRefined20Ms | Self::KpsoRefined5Ms => Solver::KpsoRefined,
        }
    }

    /// The work that all its solves may do.
    fn quanta(self) -> u32 {
        match self {
            Self::KpsoRefined20Ms => 20_000_000 / QUANTUM_NS,
            Self::KpsoRefined5Ms => 5_000_000 / QUANTUM_NS,
            _ => u32::MAX,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Ending {
    pub field: Field,
    /// Seed of the problem, and of the swarms.
    pub seed: u64,
    pub contender: Contender,
    pub cost: f64,
    pub best_cost: f64,
    /// From the end of its plan to the target \[mm\].
    pub end_error_mm: f64,
    pub solves: u32,
    pub time_ms: f64,
}

impl Ending {
    /// By how much its cost is above the best one, as a share of that.
    pub fn excess_share(&self) -> f64 {
        self.cost / self.best_cost - 1.0
    }

    /// Whether it ended above the best that is known.
    pub fn is_stuck(&self) -> bool {
        self.cost > self.best_cost * (1.0 + STUCK_SHARE) + STUCK_FLOOR_M2
    }

    pub fn arrives(&self) -> bool {
        self.end_error_mm <= ARRIVED_MM
    }
}

/// Lets every contender solve the problem of this seed.
pub fn contest(field: Field, seed: u64) -> Result<Vec<Ending>> {
    let robot = Robot::new(&RobotParameters::paper(SECTIONS))?;
    let problem = Problem::draw(field, &robot, seed)?;
    let mut endings = Vec::new();
    for contender in Contender::ALL {
        let begin = Instant::now();
        let mut attempt = Attempt::new(&robot, &problem, contender, seed)?;
        attempt.converge();
        if contender == Contender::GaussNewtonRestarted {
            for plan in 0..RANDOM_PLANS {
                attempt.restart(cycle_seed(seed, plan));
                attempt.converge();
            }
        }
        endings.push(Ending {
            field,
            seed,
            contender,
            cost: attempt.best_cost,
            best_cost: attempt.best_cost,
            end_error_mm: problem.end_error_mm(&robot, &attempt.best_plan),
            solves: attempt.solves,
            time_ms: begin.elapsed().as_secs_f64() * 1e3,
        });
    }
    let costs = endings.iter().map(|ending| ending.cost);
    let best_cost = costs.fold(f64::INFINITY, f64::min);
    for ending in &mut endings {
        ending.best_cost = best_cost;
    }
    Ok(endings)
}

struct Attempt<'a> {
    problem: &'a Problem,
    nmpc: Nmpc,
    seed: u64,
    solves: u32,
    quanta_left: u32,
    best_cost: f64,
    best_plan: Vec<f64>,
}

impl<'a> Attempt<'a> {
    fn new(robot: &Robot, problem: &'a Problem, contender: Contender, seed: u64) -> Result<Self> {
        let nmpc = Nmpc::new(robot.clone(), PERIOD_S, settings(contender.solver()))?;
        Ok(Self {
            problem,
            best_plan: nmpc.plan().to_vec(),
            nmpc,
            seed,
            solves: 0,
            quanta_left: contender.quanta(),
            best_cost: f64::INFINITY,
        })
    }

    fn restart(&mut self, seed: u64) {
        let mut numbers = Numbers::new(seed);
        let mut rate = || numbers.between(-RANDOM_RATE_RAD_S, RANDOM_RATE_RAD_S);
        let plan: Vec<f64> = self.best_plan.iter().map(|_| rate()).collect();
        self.nmpc.restore_plan(&plan, 0);
    }

    /// Goes on from its own plan until that becomes no better, and keeps the best.
    fn converge(&mut self) {
        let (mut cost, mut idle) = (f64::INFINITY, 0);
        for _ in 0..SOLVES_MAX {
            let seed = cycle_seed(self.seed, u64::from(self.solves));
            let input = self.problem.input(seed);
            let mut budget = Budget::of_quanta(self.quanta_left);
            let (_, report) = self.nmpc.solve(&input, &mut budget);
            self.quanta_left -= report.quanta;
            self.solves += 1;
            let better = report.cost < cost * (1.0 - PROGRESS_SHARE);
            idle = if better { 0 } else { idle + 1 };
            cost = cost.min(report.cost);
            if idle >= IDLE_SOLVES_MAX || self.quanta_left == 0 {
                break;
            }
        }
        if cost < self.best_cost {
            self.best_cost = cost;
            self.best_plan.copy_from_slice(self.nmpc.plan());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_obstacles_all_end_at_the_target() {
        for ending in contest(Field::Free, 3).unwrap() {
            assert!(ending.arrives(), "{ending:?}");
            assert!(ending.excess_share() < 0.05, "{ending:?}");
        }
    }

    #[test]
    fn restarts_never_make_gauss_newton_worse_and_the_best_is_not_stuck() {
        let endings = contest(Field::Ball, 0).unwrap();
        let of = |contender| *endings.iter().find(|e| e.contender == contender).unwrap();
        let (once, again) = (
            of(Contender::GaussNewton),
            of(Contender::GaussNewtonRestarted),
        );
        assert!(again.cost <= once.cost && again.solves > once.solves);
        let best = endings.iter().find(|e| e.cost == e.best_cost).unwrap();
        assert!(!best.is_stuck() && best.excess_share() == 0.0);
    }

    #[test]
    fn a_new_plan_takes_the_better_way_round_a_ball() {
        let endings = contest(Field::Ball, 5).unwrap();
        let found = endings
            .iter()
            .find(|e| e.contender == Contender::KpsoRefined20Ms);
        assert!(!found.unwrap().is_stuck(), "{found:?}");
    }

    #[test]
    fn stuck_is_more_than_a_hundredth_above_the_best_and_more_than_rounding() {
        let ending = |cost, best_cost| Ending {
            field: Field::Free,
            seed: 0,
            contender: Contender::Kpso,
            cost,
            best_cost,
            end_error_mm: 11.0,
            solves: 1,
            time_ms: 1.0,
        };
        assert!(!ending(1.009, 1.0).is_stuck());
        assert!(ending(1.011, 1.0).is_stuck());
        assert!(!ending(2e-7, 1e-9).is_stuck());
        assert!(!ending(1.0, 1.0).arrives());
    }
}
