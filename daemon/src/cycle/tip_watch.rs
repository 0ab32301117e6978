//! A tip measured beside bends or cables: which measurements are used, and why others are not.

use cdcr_controller::estimator::Measurement;
use cdcr_controller::safety::{MeasurementWatch, Plausibility, PlausibilityRules};

use super::silence::age_s;
use super::state::RobotState;
use crate::handover::{CycleInputs, MeasurementUse, TimedMeasurement, TipCause};

#[derive(Debug)]
pub(super) struct TipWatch {
    pub(super) plausibility: MeasurementWatch,
    last_ns: u64,
    /// Number of tip sensors so far.
    sensors: u64,
    /// The tip froze or jumped too often: it is not used until control begins again or another sensor takes over.
    wrong: Option<TipCause>,
    unused: Option<TipCause>,
}

impl TipWatch {
    pub(super) fn new(rules: PlausibilityRules) -> Self {
        Self {
            plausibility: MeasurementWatch::new(rules),
            last_ns: 0,
            sensors: 0,
            wrong: None,
            unused: None,
        }
    }

    /// Why the newest measurement was not used.
    pub(super) fn unused(&self) -> Option<TipCause> {
        self.unused
    }

    pub(super) fn is_wrong(&self) -> bool {
        self.wrong.is_some()
    }

    /// Accepts the next measurement without history.
    pub(super) fn trust(&mut self) {
        self.plausibility = MeasurementWatch::new(*self.plausibility.rules());
        self.wrong = None;
    }
}

impl RobotState {
    /// Uses a tip measured in addition to bends or cables: it shows the error of the model there. An
    /// implausible one is ignored, without a fault: the bends are measured. A new sensor, counted by the
    /// inputs, starts without the history of the last one. The offset remains until the new sensor
    /// corrects it, so that the tip does not jump.
    pub(super) fn measure_tip(
        &mut self,
        measurement: Option<TimedMeasurement>,
        inputs: &CycleInputs,
        release_ns: u64,
    ) -> MeasurementUse {
        let before = core::mem::replace(&mut self.tip_watch.sensors, inputs.tip_sensors);
        if before != inputs.tip_sensors {
            self.trust_tip();
        }
        let Some(timed) = measurement else {
            return MeasurementUse::None;
        };
        if timed.measured_ns <= self.tip_watch.last_ns {
            return MeasurementUse::Repeated;
        }
        self.tip_watch.last_ns = timed.measured_ns;
        self.tip_watch.unused = self.take_tip(&timed, release_ns).err();
        if self.tip_watch.unused.is_some() {
            MeasurementUse::Implausible
        } else {
            MeasurementUse::Used
        }
    }

    fn take_tip(&mut self, timed: &TimedMeasurement, release_ns: u64) -> Result<(), TipCause> {
        let TimedMeasurement {
            measurement,
            measured_ns,
            ..
        } = timed;
        let watch = &mut self.tip_watch;
        let found = watch
            .plausibility
            .check(&self.robot, measurement, *measured_ns);
        match found {
            Plausibility::Lost => watch.wrong = Some(TipCause::Jumped),
            Plausibility::Frozen => watch.wrong = Some(TipCause::Frozen),
            Plausibility::Jump | Plausibility::Good => {}
        }
        if let Some(cause) = watch.wrong {
            return Err(cause);
        }
        if found == Plausibility::Jump {
            return Err(TipCause::Jumps);
        }
        let Measurement::TipPosition(position_m) = measurement else {
            return Ok(());
        };
        let age_s = age_s(*measured_ns, release_ns);
        self.estimator
            .correct_tip(&self.robot, position_m, age_s)
            .map_err(TipCause::from)
    }

    /// Assumes the tip at the place given by the bends if its measurement froze or jumped permanently.
    pub(super) fn give_up_wrong_tip(&mut self) {
        if self.tip_watch.is_wrong() {
            self.estimator.forget_tip_offset();
        }
    }

    /// Accepts the next tip measurement without history.
    pub(super) fn trust_tip(&mut self) {
        self.tip_watch.trust();
        self.estimator.trust_tip();
    }
}
