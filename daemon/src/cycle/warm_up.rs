//! Before the first cycle: checks that a cycle fits into its period, and brings code and data into memory.

use cdcr_controller::nmpc::{HORIZON_STEPS_MAX, SolveInput};
use cdcr_controller::optimizer::Budget;
use cdcr_controller::reference::{ReferenceSample, ReferenceState};
use cdcr_controller::robot::{Obstacle, Shape};
use nalgebra::Vector3;

use super::Cycle;
use crate::core_budget::Costs;
use crate::rt::clock::Clock;

/// Longest duration of the warm-up \[ns\].
const WARM_UP_MAX_NS: u64 = 300_000_000;
/// Solves before the first release, for the check and for the warm-up each.
const TRIALS: u64 = 20;

impl Cycle {
    /// Rejects settings that leave no time for a cycle without any search, as measured.
    ///
    /// # Errors
    ///
    /// A message with the numbers.
    pub fn check_that_it_fits(&mut self, clock: &impl Clock) -> Result<(), String> {
        let measured_ns = (0..TRIALS).map(|seed| {
            let begin_ns = clock.now_ns();
            self.solve_once(seed, true, || true);
            self.make_safe(&self.rates.clone(), true);
            clock.now_ns() - begin_ns
        });
        let least_ns = measured_ns.min().unwrap_or_default();
        self.nmpc.forget_plan();
        let Some(shortfall_ns) = self.core_budget.shortfall_ns(least_ns) else {
            return Ok(());
        };
        let ms = |ns: u64| ns as f64 / 1e6;
        Err(format!(
            "a cycle does not fit into cycle.period_ms = {}: without a search it takes {:.3} ms (sections: {}, \
             controller.horizon_steps = {}), {:.3} ms too long; {}",
            ms(self.period_ns),
            ms(least_ns),
            self.robot.section_count(),
            self.nmpc.settings().horizon_steps,
            ms(shortfall_ns),
            self.core_budget.describe(Costs::default()),
        ))
    }

    /// Runs the solver up to `TRIALS` times, so that the first real solve finds code and data in memory.
    pub fn warm_up(&mut self, clock: &impl Clock) {
        let end_ns = clock.now_ns() + WARM_UP_MAX_NS;
        for seed in 0..TRIALS {
            // Plain costs are evaluated by a loop of their own.
            let has_obstacle = seed.is_multiple_of(2);
            self.solve_once(seed, has_obstacle, || clock.now_ns() >= end_ns);
        }
        self.nmpc.forget_plan();
    }

    /// A solve with a reference out of reach, with or without an obstacle.
    fn solve_once(&mut self, seed: u64, has_obstacle: bool, mut is_over: impl FnMut() -> bool) {
        let tip_m = self.robot.tip_position(self.state.configuration());
        let sample = ReferenceSample {
            state: ReferenceState::Inside,
            position_m: tip_m * 0.99,
            ..ReferenceSample::default()
        };
        let shape = Shape::Sphere {
            centre_m: tip_m * 1.05,
        };
        let obstacle = Obstacle::new(shape, 0.01, Vector3::zeros());
        let obstacle = obstacle.ok().filter(|_| has_obstacle);
        let input = SolveInput {
            configuration: self.state.configuration(),
            previous_rates: &self.rates,
            reference: &[sample; HORIZON_STEPS_MAX][..self.nmpc.settings().horizon_steps as usize],
            obstacles: obstacle.as_slice(),
            tip_offset_m: 0.0,
            elapsed_periods: 1,
            seed,
        };
        self.nmpc.solve(&input, &mut Budget::new(&mut is_over));
    }
}
