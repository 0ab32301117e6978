//! Rehearsal: the next cycle without any effect, when the cycle thread wakes up before its release.
//!
//! After milliseconds of sleep the processor's caches hold other data, and the same code takes two to three
//! times as long. Time before a release does not count towards the response time. No later command depends on
//! a rehearsal: the plan is restored, the estimate and the followed reference are separate ones, and other
//! results are discarded.
//!
//! Each part runs only if it will usually end before the release, by the median of its recent costs. One that
//! ends later delays its release; after a few of them, and wherever the median is too high, the part is left out and
//! tried again after a while. Such a trial may delay its release by the cost of the part.

use std::hint::black_box;

use cdcr_controller::estimator::Measurement;
use cdcr_controller::nmpc::SolveInput;
use cdcr_controller::optimizer::{Budget, cycle_seed};
use cdcr_controller::reference::{FollowedReference, GridPoint};
use cdcr_controller::safety::{Mode, safe_command};

use super::Cycle;
use super::state::RobotState;
use crate::core_budget::RecentCosts;
use crate::handover::{CycleInputs, TimedMeasurement};
use crate::rt::clock::Clock;

/// Time reserved before a release: the solver checks its budget more often than this
/// ([`QUANTUM_NS`](cdcr_controller::optimizer::QUANTUM_NS)).
const GAP_MIN_NS: u64 = 5000;
/// Cycles without a part until it is tried again: at first, and at most. Each failed trial doubles it.
const WAIT: u32 = 200;
const WAIT_MAX: u32 = 25_600;
/// So many runs that ended late, less those that did not, end the part until its next trial.
const LATE_MAX: u32 = 4;

#[derive(Debug)]
pub(super) struct Rehearsal {
    /// Separate state that only rehearsals advance and read.
    pub(super) state: RobotState,
    /// The same for the followed reference.
    pub(super) followed: FollowedReference,
    /// A part of the next cycle was rehearsed.
    pub(super) took_place: bool,
    /// Longest time between two checks of the clock in each first solve: the code is cold.
    cold_gap: RehearsedPart,
    /// The same in each second solve.
    warm_gap: RehearsedPart,
    /// What does not check the clock.
    rest: RehearsedPart,
}

/// The first or the second solve before a release.
#[derive(Debug, Clone, Copy)]
enum Solve {
    Cold,
    Warm,
}

impl Rehearsal {
    pub(super) fn new(state: RobotState, followed: FollowedReference) -> Self {
        Self {
            state,
            followed,
            took_place: false,
            cold_gap: RehearsedPart::default(),
            warm_gap: RehearsedPart::default(),
            rest: RehearsedPart::default(),
        }
    }

    fn gap(&mut self, solve: Solve) -> &mut RehearsedPart {
        match solve {
            Solve::Cold => &mut self.cold_gap,
            Solve::Warm => &mut self.warm_gap,
        }
    }

    /// The time that the first solve leaves to the rest, of `left_ns`: none if both do not fit.
    fn kept_for_rest_ns(&self, left_ns: u64) -> u64 {
        let rest_ns = self.rest.usual_ns();
        if self.cold_gap.usual_ns() + rest_ns < left_ns {
            rest_ns
        } else {
            0
        }
    }
}

/// Recent costs of a part, and when it is tried again though they are too high.
#[derive(Debug)]
struct RehearsedPart {
    costs: RecentCosts,
    omitted: u32,
    wait: u32,
    is_trial: bool,
    late: u32,
}

impl Default for RehearsedPart {
    fn default() -> Self {
        Self {
            costs: RecentCosts::default(),
            omitted: 0,
            wait: WAIT,
            is_trial: false,
            late: 0,
        }
    }
}

impl RehearsedPart {
    fn usual_ns(&self) -> u64 {
        self.costs.median_ns()
    }

    /// Whether the part begins with `left_ns` before the release.
    fn begins(&mut self, left_ns: u64) -> bool {
        if self.usual_ns() < left_ns {
            self.omitted = 0;
            return true;
        }
        self.omitted += 1;
        self.is_trial = self.omitted >= self.wait;
        self.is_trial
    }

    /// Notes its cost, having begun with `left_ns` before the release.
    fn note(&mut self, cost_ns: u64, left_ns: u64) {
        if !core::mem::take(&mut self.is_trial) {
            self.late = if cost_ns < left_ns {
                self.late.saturating_sub(1)
            } else {
                self.late + 1
            };
            if self.late >= LATE_MAX {
                self.late = 0;
                self.costs = RecentCosts::default();
            }
            return self.costs.note(cost_ns);
        }
        self.omitted = 0;
        self.wait = if cost_ns < left_ns {
            WAIT
        } else {
            (2 * self.wait).min(WAIT_MAX)
        };
        self.costs = RecentCosts::default();
        self.costs.note(cost_ns);
    }
}

impl Cycle {
    /// Solves, estimates and checks once with the inputs known before `release_ns`, the release of `cycle`,
    /// solves again in the rest of the time, and discards the results. The first solve leaves time for estimate
    /// and checks where there is time for both.
    pub fn rehearse(
        &mut self,
        cycle: u64,
        release_ns: u64,
        inputs: &CycleInputs,
        clock: &impl Clock,
    ) {
        let left_ns = release_ns.saturating_sub(clock.now_ns());
        if left_ns <= GAP_MIN_NS {
            return;
        }
        let rest_ns = release_ns - self.rehearsal.kept_for_rest_ns(left_ns);
        let next = GridPoint {
            cycle,
            release_ns,
            period_ns: self.period_ns,
        };
        let parts = [
            self.rehearse_solve(Solve::Cold, next, rest_ns, inputs, clock),
            self.rehearse_rest(cycle, release_ns, inputs, clock),
            self.rehearse_solve(Solve::Warm, next, release_ns, inputs, clock),
        ];
        self.rehearsal.took_place = parts.contains(&true);
    }

    /// Solves from the state expected at the release until shortly before `until_ns`. Returns whether there was
    /// time to begin.
    fn rehearse_solve(
        &mut self,
        solve: Solve,
        next: GridPoint,
        until_ns: u64,
        inputs: &CycleInputs,
        clock: &impl Clock,
    ) -> bool {
        let begin_ns = clock.now_ns();
        let left_ns = until_ns.saturating_sub(begin_ns);
        let is_tracking = matches!(self.modes.mode(), Mode::Tracking { .. });
        if !is_tracking || left_ns <= GAP_MIN_NS || !self.rehearsal.gap(solve).begins(left_ns) {
            return false;
        }
        let end_ns = until_ns - GAP_MIN_NS;
        let period_s = self.period_ns as f64 * 1e-9;
        let settings = self.nmpc.settings();
        let (state, offset_m) = (&self.state, self.state.tip_offset_m());
        let followed = self.rehearsal.followed.ahead(
            &inputs.window,
            next,
            settings.horizon_steps as usize,
            || state.commanded_tip(),
            &offset_m,
        );
        let input = SolveInput {
            configuration: &self.state.configuration().advanced(&self.rates, period_s),
            previous_rates: &self.rates,
            reference: followed.samples,
            obstacles: &self.obstacles,
            tip_offset_m: self.state.tip_margin_m(),
            elapsed_periods: 1,
            seed: cycle_seed(settings.seed, next.cycle),
        };
        let (mut checked_ns, mut longest_gap_ns) = (begin_ns, 0);
        let mut is_spent = || {
            let now_ns = clock.now_ns();
            longest_gap_ns = longest_gap_ns.max(now_ns - checked_ns);
            checked_ns = now_ns;
            now_ns >= end_ns
        };
        self.nmpc.rehearse(&input, &mut Budget::new(&mut is_spent));
        is_spent();
        self.rehearsal.gap(solve).note(longest_gap_ns, left_ns);
        true
    }

    /// Rehearses what a cycle does beside its solve. Returns whether there was time to begin.
    fn rehearse_rest(
        &mut self,
        cycle: u64,
        release_ns: u64,
        inputs: &CycleInputs,
        clock: &impl Clock,
    ) -> bool {
        let begin_ns = clock.now_ns();
        let left_ns = release_ns.saturating_sub(begin_ns);
        if !self.rehearsal.rest.begins(left_ns) {
            return false;
        }
        self.rehearse_estimate(release_ns, inputs);
        black_box(inputs.window.get(cycle));
        black_box(self.costs(inputs));
        black_box(safe_command(&self.situation(false), &self.rates));
        let cost_ns = clock.now_ns() - begin_ns;
        self.rehearsal.rest.note(cost_ns, left_ns);
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
        state.measure_tip(inputs.tip, inputs, release_ns);
        state.locate(self.period_ns);
        black_box(state.tip());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const US: u64 = 1000;
    const LEFT_NS: u64 = 57 * US;

    /// Cycles of `count` in which a part of `cost_ns` runs.
    fn runs(part: &mut RehearsedPart, count: usize, cost_ns: u64) -> Vec<usize> {
        let mut ran = Vec::new();
        for cycle in 0..count {
            if part.begins(LEFT_NS) {
                part.note(cost_ns, LEFT_NS);
                ran.push(cycle);
            }
        }
        ran
    }

    #[test]
    fn a_part_that_takes_too_long_is_tried_ever_more_rarely() {
        let mut part = RehearsedPart::default();
        let ran = runs(&mut part, 200_000, 80 * US);
        let trials: Vec<_> = ran.into_iter().filter(|cycle| *cycle > 10).collect();
        let apart: Vec<_> = trials.windows(2).map(|pair| pair[1] - pair[0]).collect();
        assert!(apart.is_sorted(), "{apart:?}");
        assert_eq!(apart[0], 2 * WAIT as usize);
        assert_eq!(apart.last(), Some(&(WAIT_MAX as usize)));
    }

    #[test]
    fn a_part_that_becomes_expensive_delays_few_releases() {
        let mut part = RehearsedPart::default();
        assert_eq!(runs(&mut part, 200, 20 * US).len(), 200);
        let ran = runs(&mut part, 199, 80 * US);
        assert_eq!(ran.len(), LATE_MAX as usize, "{ran:?}");
    }

    #[test]
    fn a_part_that_was_too_slow_for_a_while_runs_again() {
        let mut part = RehearsedPart::default();
        runs(&mut part, 300, 80 * US);
        let ran = runs(&mut part, 2000, 20 * US);
        let after = ran[0];
        assert!(after <= 2 * WAIT as usize, "{after}");
        assert_eq!(ran.len(), 2000 - after);
    }
}
