//! What the mode machine is told of a cycle, before it decides.

use cdcr_controller::reference::ReferenceSample;
use cdcr_controller::safety::{Observation, Reason};

use super::Cycle;
use crate::handover::{CycleInputs, TimedMeasurement};

impl Cycle {
    pub(super) fn observe(
        &mut self,
        measurement: Option<TimedMeasurement>,
        reference: &ReferenceSample,
        inputs: &CycleInputs,
    ) -> Observation {
        Observation {
            measured: measurement.is_some(),
            reference: reference.state,
            too_far: self.is_too_far(reference),
            lease: inputs.lease,
            at_home: self.state.is_at_home(),
            misses_overflow: self.policy.stops_on_misses() && self.accounting.bucket().overflows(),
            suspended: core::mem::replace(&mut self.suspends, inputs.suspends) != inputs.suspends,
            wait: self.wait(inputs),
            fault: self.fault(measurement),
        }
    }

    /// Whether a reference is farther from the tip than it may be approached from.
    fn is_too_far(&self, reference: &ReferenceSample) -> bool {
        let most_m = self.policy.approach_distance_m;
        most_m.is_finite() && (self.state.tip().position_m - reference.position_m).norm() > most_m
    }

    /// Why the robot should not move on, though nothing is broken.
    fn wait(&self, inputs: &CycleInputs) -> Option<Reason> {
        if self.stale_ns > self.policy.stale_inputs_max_ns {
            return Some(Reason::InputsStale);
        }
        inputs
            .obstacle_source_silent
            .then_some(Reason::ObstacleSourceSilent)
    }

    fn fault(&self, measurement: Option<TimedMeasurement>) -> Option<Reason> {
        // What was never measured is not lost: the machine waits for it.
        measurement?;
        if let Some(fault) = self.state.measurement_fault() {
            return Some(fault);
        }
        if self.clearance_m < self.policy.clearance_fault_m {
            return Some(Reason::ClearanceBroken);
        }
        // A robot that is stopped or faulted may be moved by hand, until control begins anew.
        let is_in_control = !self.modes.mode().is_latched() && !self.control_begins;
        if is_in_control && self.state.following().is_broken() {
            return Some(Reason::FollowingError);
        }
        self.state.place_fault()
    }
}
