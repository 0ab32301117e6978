//! Costs of a cycle beside its solve, learnt from earlier cycles.

use super::Cycle;
use crate::core_budget::Costs;
use crate::handover::CycleInputs;
use crate::rt::clock::Clock;

impl Cycle {
    /// Ends the measurement of the work after the solver: the thread is about to sleep.
    pub fn rest(&mut self, clock: &impl Clock) {
        if self.solve_until_ns > 0 {
            let took_ns = clock.now_ns().saturating_sub(self.solve_over_ns);
            self.took_after_solve_ns = Some(took_ns);
        }
    }

    /// Records the cost of the previous cycle, unless its thread lost the core or stale inputs leave that
    /// unknown.
    pub(super) fn learn_cost(&mut self, inputs: &CycleInputs, stale_inputs: bool) {
        let before = core::mem::replace(&mut self.interruptions, inputs.interruptions);
        if let Some(took_ns) = self.took_after_solve_ns.take()
            && before == inputs.interruptions
            && !stale_inputs
        {
            self.costs_after_solve.note(took_ns);
        }
    }

    /// Time that the core needs in this period beside the solve.
    pub(super) fn costs(&self, inputs: &CycleInputs) -> Costs {
        Costs {
            after_solve_ns: self.costs_after_solve.high_by_clock_ns(),
            exchange_ns: inputs.exchange_ns,
        }
    }
}
