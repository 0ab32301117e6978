//! Observations that the mode machine receives before it decides.

use cdcr_controller::reference::ReferenceSample;
use cdcr_controller::safety::{Mode, Observation, Reason};

use super::Cycle;
use crate::handover::{CycleInputs, Policy, TimedMeasurement};

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
            measurement_rejected: self.state.is_measurement_rejected(),
            tip_contradiction_m: self.state.tip_watch.contradiction_m(),
            pose_differs: self.pose_is_uncertain
                || self.state.following().error().largest_rad() > Policy::POSE_DIFFERS_RAD,
        }
    }

    /// The daemon before this one ended while the robot was measured far from where its last command had left it. This one
    /// does not know that place: the first reset has to accept the pose.
    #[must_use]
    pub fn uncertain_pose(mut self, is_uncertain: bool) -> Self {
        self.pose_is_uncertain = is_uncertain;
        self
    }

    /// A reset was granted: the pose is accepted.
    pub(super) fn end_uncertainty(&mut self) {
        let mode = self.modes.mode();
        self.pose_is_uncertain &= mode.is_latched() || mode == Mode::Starting;
    }

    /// Reason to hold although there is no fault.
    fn wait(&self, inputs: &CycleInputs, reference: &ReferenceSample) -> Option<Reason> {
        if self.has_stale_inputs() {
            return Some(Reason::InputsStale);
        }
        if self.followed.is_replaced(&inputs.window) && self.state.is_too_far(reference) {
            return Some(Reason::ReferenceTooFar);
        }
        if inputs.obstacle_source_silent {
            return Some(Reason::ObstacleSourceSilent);
        }
        let begins = self.modes.mode().is_latched() || self.control_begins;
        (begins && self.state.is_commanded_elsewhere()).then_some(Reason::FollowingError)
    }

    fn fault(&self, measurement: Option<TimedMeasurement>) -> Option<Reason> {
        // Without a first measurement, none can be lost: the mode machine waits for it.
        measurement?;
        if let Some(fault) = self.state.measurement_fault() {
            return Some(fault);
        }
        if self.is_contact() {
            return Some(Reason::ClearanceBroken);
        }
        // A stopped or faulted robot may be moved by hand until control begins again.
        let is_in_control = !self.modes.mode().is_latched() && !self.control_begins;
        if is_in_control && self.state.following().is_broken() {
            return Some(Reason::FollowingError);
        }
        self.state.place_fault()
    }

    /// The offset of an implausible tip sensor must not block the reset of a resting robot.
    fn give_up_wrong_tip(&mut self) {
        if self.modes.mode().is_latched() && self.is_at_rest() && self.is_contact() {
            self.state.give_up_wrong_tip();
        }
    }
}
