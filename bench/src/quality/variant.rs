//! One way to solve: which course with which solver, budget, swarm and horizon.

use cdcr_controller::nmpc::NmpcSettings;
use serde::Serialize;

use super::course::Course;
use super::sizing::Sizing;
use crate::experiment::Solver;
use crate::named::named;

pub const SOLVERS: [Solver; 3] = [Solver::Kpso, Solver::GaussNewton, Solver::KpsoRefined];
pub const BUDGETS_US: [u64; 9] = [10, 20, 50, 100, 200, 500, 1000, 2000, 4000];
/// Swarms, particles and iterations: the paper's is the second.
pub const SWARMS: [(u32, u32); 5] = [(6, 10), (6, 30), (12, 30), (24, 30), (24, 60)];
pub const HORIZONS: [u32; 5] = [1, 2, 4, 8, 16];
pub(super) const BUDGET_SWARM: u32 = 64;
/// Iterations of the swarm alone, where the budget ends a solve: as many as are allowed.
const BUDGET_ITERATIONS: u32 = 1000;
/// Gauss-Newton steps, where the budget ends a solve: as many as are allowed.
const BUDGET_REFINEMENTS: u32 = 50;

/// Beside a solve: the evaluation of its plan, the guard \[µs\].
const AROUND_US: f64 = 15.0;
/// Of a solve without a budget, all courses and solvers together \[µs\].
const UNLIMITED_US: f64 = 150.0;

named! {
    pub enum Axis {
        /// The time of a solve, on the clock.
        Budget = "budget",
        /// Particles and iterations; as much time as they take.
        Swarm = "swarm",
        /// Prediction steps; as much time as they take.
        Horizon = "horizon",
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Variant {
    pub axis: Axis,
    pub course: Course,
    pub solver: Solver,
    /// Budget of a solve \[µs\]; none: as much as it takes.
    pub budget_us: Option<u64>,
    pub swarm: u32,
    pub iterations: u32,
    pub refinements: u32,
    pub horizon: u32,
    /// Control blocks; 0: one for each step, as far as that goes.
    pub blocks: u32,
}

impl Variant {
    fn of(axis: Axis, course: Course, solver: Solver) -> Self {
        let settings = course.settings();
        let searches = u32::from(solver != Solver::GaussNewton);
        let refines = u32::from(solver != Solver::Kpso);
        Self {
            axis,
            course,
            solver,
            budget_us: None,
            swarm: searches * settings.swarm_size,
            iterations: searches * settings.swarm_iterations,
            refinements: refines * settings.refinement_steps,
            horizon: settings.horizon_steps,
            blocks: settings.control_blocks,
        }
    }

    /// As much work as is allowed, ended by the clock. Before Gauss-Newton the swarm takes half of the time,
    /// or nothing would be left.
    pub fn timed(course: Course, solver: Solver, budget_us: u64, sizing: &Sizing) -> Self {
        let plain = Self::of(Axis::Budget, course, solver);
        let (swarm, iterations) = match solver {
            Solver::GaussNewton => (0, 0),
            Solver::KpsoRefined => (BUDGET_SWARM, sizing.iterations(0.5 * budget_us as f64)),
            _ => (BUDGET_SWARM, BUDGET_ITERATIONS),
        };
        Self {
            budget_us: Some(budget_us),
            swarm,
            iterations,
            refinements: plain.refinements.min(1) * BUDGET_REFINEMENTS,
            ..plain
        }
    }

    pub fn swarm(course: Course, solver: Solver, (swarm, iterations): (u32, u32)) -> Self {
        Self {
            swarm,
            iterations,
            ..Self::of(Axis::Swarm, course, solver)
        }
    }

    /// With so many steps, and controls of their own for each.
    pub fn horizon(course: Course, solver: Solver, steps: u32) -> Self {
        Self {
            horizon: steps,
            blocks: 0,
            ..Self::of(Axis::Horizon, course, solver)
        }
    }

    pub fn settings(&self, seed: u64) -> NmpcSettings {
        let base = self.solver.of(self.course.settings());
        NmpcSettings {
            // A solver without a swarm does not look at these two.
            swarm_size: self.swarm.max(1),
            swarm_iterations: self.iterations,
            refinement_steps: self.refinements,
            horizon_steps: self.horizon,
            control_blocks: self.blocks,
            seed,
            ..base
        }
    }

    pub fn value(&self) -> String {
        match (self.axis, self.budget_us) {
            (Axis::Budget, Some(us)) => format!("{us} µs"),
            (Axis::Swarm, _) => format!("{} x {}", self.swarm, self.iterations),
            _ => format!("{} steps", self.horizon),
        }
    }

    pub fn key(&self) -> String {
        let value = match (self.axis, self.budget_us) {
            (Axis::Budget, Some(us)) => format!("{us}-us"),
            (Axis::Swarm, _) => format!("{}x{}", self.swarm, self.iterations),
            _ => format!("n{}", self.horizon),
        };
        let (axis, course) = (self.axis.name(), self.course.name());
        format!("{axis}/{course}/{}/{value}", self.solver.name())
    }

    /// What a solve takes with all that surrounds it, about, for the progress \[µs\].
    pub(super) fn solve_us(&self) -> f64 {
        self.budget_us
            .map_or(UNLIMITED_US, |us| AROUND_US + us as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_variant_has_legal_settings_and_a_name_of_its_own() {
        let mut keys = Vec::new();
        let sizing = Sizing { iteration_us: 2.0 };
        for course in Course::ALL {
            for solver in SOLVERS {
                let timed = BUDGETS_US.map(|us| Variant::timed(course, solver, us, &sizing));
                let swarms = SWARMS.map(|swarm| Variant::swarm(course, solver, swarm));
                let horizons = HORIZONS.map(|steps| Variant::horizon(course, solver, steps));
                let all = timed.into_iter().chain(swarms).chain(horizons);
                for variant in all {
                    assert_eq!(variant.settings(1).validate(), Ok(()), "{variant:?}");
                    keys.push(variant.key());
                }
            }
        }
        let count = keys.len();
        keys.sort_unstable();
        keys.dedup();
        assert_eq!(keys.len(), count);
    }
}
