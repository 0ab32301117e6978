//! A tip measured beside bends or cables: which measurements are used, and why others are not.

use cdcr_controller::estimator::{Measurement, TipRefusal};
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
    /// Why the newest measurement is not used; with the bits of the one before, why that one was not.
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
        (self.wrong, self.unused) = (None, None);
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
        match self.take_tip(&timed, release_ns) {
            Ok(()) => {
                self.tip_watch.unused = None;
                MeasurementUse::Used
            }
            Err(cause) => {
                // The same bits again are no reason to distrust the sensor, nor to trust it.
                self.tip_watch.unused = cause.or(self.tip_watch.unused);
                MeasurementUse::Implausible
            }
        }
    }

    /// An error without a cause: the tip has the bits of the last one.
    fn take_tip(
        &mut self,
        timed: &TimedMeasurement,
        release_ns: u64,
    ) -> Result<(), Option<TipCause>> {
        let TimedMeasurement {
            measurement,
            measured_ns,
            ..
        } = timed;
        let watch = &mut self.tip_watch;
        let found = watch
            .plausibility
            .check(&self.robot, measurement, *measured_ns);
        let found_wrong = match found {
            Plausibility::Lost => Some(TipCause::Jumped),
            Plausibility::Frozen => Some(TipCause::Frozen),
            Plausibility::Jump | Plausibility::Good => None,
        };
        watch.wrong = found_wrong.or(watch.wrong);
        if watch.wrong.is_some() {
            return Err(watch.wrong);
        }
        if found == Plausibility::Jump {
            return Err(Some(TipCause::Jumps));
        }
        let Measurement::TipPosition(position_m) = measurement else {
            return Ok(());
        };
        let age_s = age_s(*measured_ns, release_ns);
        self.estimator
            .correct_tip(&self.robot, position_m, age_s)
            .map_err(|refusal| match refusal {
                TipRefusal::Far => Some(TipCause::Far),
                TipRefusal::WasFar => Some(TipCause::WasFar),
                TipRefusal::Repeats => None,
            })
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
