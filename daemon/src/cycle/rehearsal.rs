//! Rehearsal: the next cycle without any effect, when the cycle thread wakes up before its release.
//!
//! After milliseconds of sleep the processor's caches hold other data, and the same code takes two to three
//! times as long. Time before a release does not count towards the response time. No later command depends on
//! a rehearsal: the plan is restored, the estimate is a separate one, and other results are discarded.

use std::hint::black_box;

use cdcr_controller::estimator::Measurement;
use cdcr_controller::nmpc::SolveInput;
use cdcr_controller::optimizer::{Budget, cycle_seed};
use cdcr_controller::safety::{Mode, safe_command};

use super::Cycle;
use crate::handover::{CycleInputs, TimedMeasurement};
use crate::rt::clock::Clock;

impl Cycle {
    /// Estimates, checks and solves once with the inputs known before `release_ns`, the release of `cycle`,
    /// and discards the result. Omits the steps that might not end in time.
    pub fn rehearse(
        &mut self,
        cycle: u64,
        release_ns: u64,
        inputs: &CycleInputs,
        clock: &impl Clock,
    ) {
        self.was_rehearsed = true;
        let begin_ns = clock.now_ns();
        if begin_ns + self.rehearsal_costs.high_by_clock_ns() >= release_ns {
            return;
        }
        self.rehearse_estimate(release_ns, inputs);
        black_box(inputs.window.get(cycle));
        black_box(safe_command(&self.situation(false), &self.rates));
        self.rehearsal_costs.note(clock.now_ns() - begin_ns);
        // A check of the clock may come late by the longest gap between two checks.
        let end_ns = release_ns.saturating_sub(self.longest_gap_ns);
        if matches!(self.modes.mode(), Mode::Tracking { .. }) && clock.now_ns() < end_ns {
            let settings = self.nmpc.settings();
            let input = SolveInput {
                configuration: self.state.configuration(),
                previous_rates: &self.rates,
                reference: inputs.window.ahead(cycle, settings.horizon_steps as usize),
                obstacles: &self.obstacles,
                tip_offset_m: self.state.tip_margin_m(),
                elapsed_periods: 1,
                seed: cycle_seed(settings.seed, cycle),
            };
            let mut is_spent = || clock.now_ns() >= end_ns;
            self.nmpc.rehearse(&input, &mut Budget::new(&mut is_spent));
        }
    }

    /// Advances the rehearsal's estimate by the commanded rates and the measurements.
    fn rehearse_estimate(&mut self, release_ns: u64, inputs: &CycleInputs) {
        let measurement = inputs.measurement.unwrap_or(TimedMeasurement {
            measurement: Measurement::Configuration(*self.state.configuration()),
            measured_ns: release_ns,
        });
        let state = &mut self.rehearsed;
        state.count_silence(Some(measurement), inputs);
        state.move_on(&self.rates, self.period_ns);
        state.measure(Some(measurement), release_ns);
        state.measure_tip(inputs.tip, inputs.tip_sensors, release_ns);
        state.locate(self.period_ns);
        black_box(state.tip());
    }
}
