//! What a cycle takes beside its solve, learnt from the cycles before.

use super::Cycle;
use crate::core_budget::Costs;
use crate::handover::CycleInputs;
use crate::rt::clock::Clock;

impl Cycle {
    /// The thread is about to sleep: what followed the solver is over.
    pub fn rest(&mut self, clock: &impl Clock) {
        if self.solve_until_ns > 0 {
            let took_ns = clock.now_ns().saturating_sub(self.solve_over_ns);
            self.took_after_solve_ns = Some(took_ns);
        }
    }

    /// Takes note of what the cycle before took, unless it lost its core meanwhile, or nobody has said so far whether it did.
    pub(super) fn learn_cost(&mut self, inputs: &CycleInputs, stale_inputs: bool) {
        let before = core::mem::replace(&mut self.interruptions, inputs.interruptions);
        if let Some(took_ns) = self.took_after_solve_ns.take()
            && before == inputs.interruptions
            && !stale_inputs
        {
            self.costs_after_solve.note(took_ns);
        }
    }

    /// What the core needs in this period beside the solve.
    pub(super) fn costs(&self, inputs: &CycleInputs) -> Costs {
        Costs {
            after_solve_ns: self.costs_after_solve.high_by_clock_ns(),
            exchange_ns: inputs.exchange_ns,
        }
    }
}
