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
        self.give_up_wrong_tip();
        Observation {
            measured: measurement.is_some(),
            reference: reference.state,
            too_far: self.state.is_too_far(reference),
            lease: inputs.lease,
            lease_number: inputs.lease_number,
            at_home: self.state.is_at_home(),
            misses_overflow: self.policy.stops_on_misses() && self.accounting.bucket().overflows(),
            suspended: core::mem::replace(&mut self.suspends, inputs.suspends) != inputs.suspends,
            wait: self.wait(inputs, reference),
            fault: self.fault(measurement),
        }
    }

    /// Why the robot should not move on, though nothing is broken.
    fn wait(&self, inputs: &CycleInputs, reference: &ReferenceSample) -> Option<Reason> {
        if self.has_stale_inputs() {
            return Some(Reason::InputsStale);
        }
        if self.followed.is_replaced(&inputs.window) && self.state.is_too_far(reference) {
            return Some(Reason::ReferenceTooFar);
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
        if self.is_contact() {
            return Some(Reason::ClearanceBroken);
        }
        // A robot that is stopped or faulted may be moved by hand, until control begins anew.
        let is_in_control = !self.modes.mode().is_latched() && !self.control_begins;
        if is_in_control && self.state.following().is_broken() {
            return Some(Reason::FollowingError);
        }
        self.state.place_fault()
    }

    /// What a wrong tip said before must not refuse the reset of a robot that rests.
    fn give_up_wrong_tip(&mut self) {
        if self.modes.mode().is_latched() && self.is_at_rest() && self.is_contact() {
            self.state.give_up_wrong_tip();
        }
    }
}
