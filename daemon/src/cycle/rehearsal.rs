//! Rehearsal: the next cycle without any effect, when the cycle thread wakes up before its release.
//!
//! After milliseconds of sleep the processor's caches hold other data, and the same code takes two to three
//! times as long. Time before a release does not count towards the response time. No later command depends on
//! a rehearsal: the plan is restored, the estimate is a separate one, and other results are discarded.
//!
//! Each part runs only if it will end before the release, by its recent costs.

use std::hint::black_box;

use cdcr_controller::estimator::Measurement;
use cdcr_controller::nmpc::SolveInput;
use cdcr_controller::optimizer::{Budget, cycle_seed};
use cdcr_controller::safety::{Mode, safe_command};

use super::Cycle;
use super::state::RobotState;
use crate::core_budget::RecentCosts;
use crate::handover::{CycleInputs, TimedMeasurement};
use crate::rt::clock::Clock;

/// Time reserved before a release at least: the solver checks its budget more often than this
/// ([`QUANTUM_NS`](cdcr_controller::optimizer::QUANTUM_NS)).
const GAP_MIN_NS: u64 = 5000;

#[derive(Debug)]
pub(super) struct Rehearsal {
    /// Separate state that only rehearsals advance and read.
    pub(super) state: RobotState,
    /// The next cycle was rehearsed.
    pub(super) took_place: bool,
    /// Longest time between two checks of the clock in each solve.
    gaps: RecentCosts,
    /// Cost of the part that does not check the clock.
    costs: RecentCosts,
}

impl Rehearsal {
    pub(super) fn new(state: RobotState) -> Self {
        Self {
            state,
            took_place: false,
            gaps: RecentCosts::default(),
            costs: RecentCosts::default(),
        }
    }
}

impl Cycle {
    /// Solves, estimates and checks once with the inputs known before `release_ns`, the release of `cycle`,
    /// solves again in the rest of the time, and discards the results. The solve is first: it is the longest
    /// part and can be cut.
    pub fn rehearse(
        &mut self,
        cycle: u64,
        release_ns: u64,
        inputs: &CycleInputs,
        clock: &impl Clock,
    ) {
        self.rehearsal.took_place = true;
        let _ = self.rehearse_solve(cycle, release_ns, inputs, clock)
            && self.rehearse_rest(cycle, release_ns, inputs, clock)
            && self.rehearse_solve(cycle, release_ns, inputs, clock);
    }

    /// Solves from the state expected at the release until shortly before it. Returns whether there was time
    /// to begin.
    fn rehearse_solve(
        &mut self,
        cycle: u64,
        release_ns: u64,
        inputs: &CycleInputs,
        clock: &impl Clock,
    ) -> bool {
        if !matches!(self.modes.mode(), Mode::Tracking { .. }) {
            return true;
        }
        let gap_ns = self.rehearsal.gaps.high_by_clock_ns().max(GAP_MIN_NS);
        let end_ns = release_ns.saturating_sub(gap_ns);
        let mut checked_ns = clock.now_ns();
        if checked_ns >= end_ns {
            self.rehearsal.gaps.note_omitted();
            return false;
        }
        let period_s = self.period_ns as f64 * 1e-9;
        let settings = self.nmpc.settings();
        let input = SolveInput {
            configuration: &self.state.configuration().advanced(&self.rates, period_s),
            previous_rates: &self.rates,
            reference: inputs.window.ahead(cycle, settings.horizon_steps as usize),
            obstacles: &self.obstacles,
            tip_offset_m: self.state.tip_margin_m(),
            elapsed_periods: 1,
            seed: cycle_seed(settings.seed, cycle),
        };
        let mut longest_gap_ns = 0;
        let mut is_spent = || {
            let now_ns = clock.now_ns();
            longest_gap_ns = longest_gap_ns.max(now_ns - checked_ns);
            checked_ns = now_ns;
            now_ns >= end_ns
        };
        self.nmpc.rehearse(&input, &mut Budget::new(&mut is_spent));
        is_spent();
        self.rehearsal.gaps.note(longest_gap_ns);
        true
    }

    /// Rehearses what a cycle does beside its solve. Returns whether the release was still ahead.
    fn rehearse_rest(
        &mut self,
        cycle: u64,
        release_ns: u64,
        inputs: &CycleInputs,
        clock: &impl Clock,
    ) -> bool {
        let begin_ns = clock.now_ns();
        if begin_ns + self.rehearsal.costs.high_by_clock_ns() >= release_ns {
            self.rehearsal.costs.note_omitted();
            return begin_ns < release_ns;
        }
        self.rehearse_estimate(release_ns, inputs);
        black_box(inputs.window.get(cycle));
        black_box(safe_command(&self.situation(false), &self.rates));
        self.rehearsal.costs.note(clock.now_ns() - begin_ns);
        true
    }

    /// Advances the rehearsal's estimate by the commanded rates and the measurements.
    fn rehearse_estimate(&mut self, release_ns: u64, inputs: &CycleInputs) {
        let measurement = inputs.measurement.unwrap_or(TimedMeasurement {
            measurement: Measurement::Configuration(*self.state.configuration()),
            measured_ns: release_ns,
            rested_ns: [0; 2],
        });
        let state = &mut self.rehearsal.state;
        state.count_silence(Some(measurement), inputs);
        state.move_on(&self.rates, self.period_ns);
        state.measure(Some(measurement), release_ns);
        state.measure_tip(inputs.tip, inputs.tip_sensors, release_ns);
        state.locate(self.period_ns);
        black_box(state.tip());
    }
}
