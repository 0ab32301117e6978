//! A tip measured beside bends or cables: which measurements are used, and why others are not.

use cdcr_controller::estimator::{Measurement, TipRefusal, tip_offset_max_m};
use cdcr_controller::safety::{MeasurementWatch, Plausibility, PlausibilityRules};

use super::silence::age_s;
use super::state::RobotState;
use crate::handover::{CycleInputs, MeasurementUse, Policy, TimedMeasurement, TipCause};

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
    /// See [`Self::contradiction_m`].
    contradiction_m: f64,
}

impl TipWatch {
    pub(super) fn new(rules: PlausibilityRules) -> Self {
        Self {
            plausibility: MeasurementWatch::new(rules),
            last_ns: 0,
            sensors: 0,
            wrong: None,
            unused: None,
            contradiction_m: 0.0,
        }
    }

    /// Why the newest measurement was not used.
    pub(super) fn unused(&self) -> Option<TipCause> {
        self.unused
    }

    /// Distance of the measured tip from where the measured bends place it \[m\], where the body cannot be in both places; else 0.
    pub(super) fn contradiction_m(&self) -> f64 {
        self.contradiction_m
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
        let tip_use = self.use_tip(&timed, release_ns);
        self.compare_tip(&timed, release_ns);
        tip_use
    }

    fn use_tip(&mut self, timed: &TimedMeasurement, release_ns: u64) -> MeasurementUse {
        if timed.measured_ns <= self.tip_watch.last_ns {
            return MeasurementUse::Repeated;
        }
        self.tip_watch.last_ns = timed.measured_ns;
        match self.take_tip(timed, release_ns) {
            Ok(()) => {
                self.tip_watch.unused = None;
                MeasurementUse::Used
            }
            Err(cause) => {
                // A value that repeats is not a reason to distrust the sensor, nor to trust it.
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
            Plausibility::Frozen { .. } => Some(TipCause::Frozen),
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

    /// Compares the newest tip with the measured bends, also one with the bits of the one before: a camera of coarse resolution
    /// repeats them at rest, where encoders may lose their zero. A sensor that is wrong by itself, or measures no more, contradicts nothing.
    fn compare_tip(&mut self, tip: &TimedMeasurement, release_ns: u64) {
        let measures = release_ns.saturating_sub(tip.measured_ns) <= Policy::TIP_SILENT_NS;
        if measures && self.tip_watch.unused == Some(TipCause::Jumps) {
            // A stray one.
            return;
        }
        let trusted = Some(tip.measurement).filter(|_| measures && !self.tip_watch.is_wrong());
        self.tip_watch.contradiction_m = match (trusted, &self.measured) {
            (Some(Measurement::TipPosition(tip_m)), Some(bends)) => {
                let (reach_m, place_m) = (self.robot.reach_m(), self.robot.tip_position(bends));
                let away_m = (tip_m - place_m).norm();
                // No body reaches half as far again as its model: there the sensor is wrong.
                let is_place = tip_m.norm() < 1.5 * reach_m;
                let is_far = is_place && away_m > tip_offset_max_m(reach_m);
                if is_far { away_m } else { 0.0 }
            }
            _ => 0.0,
        };
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
