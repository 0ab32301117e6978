//! Estimate of the configuration at the release, from earlier measurements and the commands since.
//!
//! Invariant: nothing here commands or decides. Inputs are measurements with their ages and the commanded rates; the output is a
//! configuration.

mod actuator;
mod rest;
mod slack;
mod tip_filter;
mod tip_offset;
mod tip_slope;

use nalgebra::Vector3;

use crate::robot::{BendRates, CABLES_MAX, Configuration, Robot};
pub use actuator::Actuator;
use actuator::ActuatorModel;
pub use rest::RestCause;
pub use slack::Slack;
use tip_filter::{TIP_NOISE_M, TipFilter};
use tip_offset::TipOffset;
pub use tip_offset::{FAR_LIMIT, TipRefusal, tip_offset_max_m};

/// Number of low-pass filters in series. The rates follow the estimate at once, so noise changes them by the second difference of the
/// estimate. At the same delay, three filters give a tenth of the second difference of two.
const STAGES: usize = 3;

/// Time constant with which the measured bends are averaged beside the estimate \[s\]: a third of the noise remains, measured at 200 Hz.
const BESIDE_TIME_S: f64 = 0.03;

/// A measurement by a driver or a tip sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Measurement {
    /// The bend vector of every section.
    Configuration(Configuration),
    /// The length of every cable \[m\], section by section.
    CableLengths([f64; CABLES_MAX]),
    /// Position of the tip in the base frame \[m\]. It does not determine the configuration of two or more sections. A Kalman filter weighs
    /// it against the prediction; it assumes 0.3 mm of noise by default ([`Estimator::with_tip_noise`]).
    TipPosition(Vector3<f64>),
}

impl Measurement {
    /// The configuration that it gives; a tip position gives none.
    pub fn configuration(&self, robot: &Robot) -> Option<Configuration> {
        match self {
            Self::Configuration(measured) => Some(*measured),
            Self::CableLengths(lengths) => Some(robot.bend_from_cable_lengths(lengths)),
            Self::TipPosition(_) => None,
        }
    }
}

/// Estimator of the configuration.
///
/// The motors follow their commands after a delay and with a lag ([`Actuator`]). A disturbance is added: zero and load of the encoders and
/// motors, errors of the model. The estimate is the sum of commands and disturbance: the configuration **to which the commands so far lead
/// the robot**, and from which the next command continues. The present configuration is [`Self::present`].
#[derive(Debug)]
pub struct Estimator {
    /// Configurations to which the commands lead the motors, after each filter; the last one is the estimate.
    stages: [Configuration; STAGES],
    /// Configuration of the cables, and of the robot, at that estimate.
    commanded: Configuration,
    /// Unfiltered measurement, advanced by the commanded motion since; the estimate if the time constant is 0.
    measured: Configuration,
    /// Delay with which the disturbance follows the measurements \[s\]; 0: none.
    time_constant_s: f64,
    /// Time predicted since the last measurement \[s\]; `None`: the next measurement is adopted without filtering.
    uncorrected_s: Option<f64>,
    /// Difference of the unfiltered measurement from the estimate: the last two, and the average of medians of three. It shows what the
    /// filters hide.
    beside_last: [Configuration; 2],
    beside: Configuration,
    /// Kalman filter of the bends from tip positions, if nothing else measures the bends.
    tip: TipFilter,
    /// Offset of the tip, if something else measures the bends.
    tip_offset: TipOffset,
    motors: ActuatorModel,
    /// Motion that the newest stated rest has taken and no measurement has shown \[rad\].
    unshown_rad: f64,
    /// Workspace of [`Self::rested`].
    resting: ActuatorModel,
}

impl Clone for Estimator {
    fn clone(&self) -> Self {
        Self {
            stages: self.stages,
            commanded: self.commanded,
            measured: self.measured,
            time_constant_s: self.time_constant_s,
            uncorrected_s: self.uncorrected_s,
            beside_last: self.beside_last,
            beside: self.beside,
            tip: self.tip.clone(),
            tip_offset: self.tip_offset.clone(),
            motors: self.motors.clone(),
            unshown_rad: self.unshown_rad,
            resting: self.resting.clone(),
        }
    }

    /// Does not allocate.
    fn clone_from(&mut self, source: &Self) {
        self.stages = source.stages;
        self.commanded = source.commanded;
        self.measured = source.measured;
        self.time_constant_s = source.time_constant_s;
        self.uncorrected_s = source.uncorrected_s;
        self.beside_last = source.beside_last;
        self.beside = source.beside;
        self.tip.clone_from(&source.tip);
        self.tip_offset.clone_from(&source.tip_offset);
        self.motors.clone_from(&source.motors);
        self.unshown_rad = source.unshown_rad;
    }
}

impl Estimator {
    /// Starts from a known or assumed configuration, with ideal motors and unfiltered measurements.
    pub fn new(configuration: Configuration) -> Self {
        Self {
            stages: [configuration; STAGES],
            commanded: configuration,
            measured: configuration,
            time_constant_s: 0.0,
            uncorrected_s: None,
            beside_last: [Configuration::straight(configuration.section_count()); 2],
            beside: Configuration::straight(configuration.section_count()),
            tip: TipFilter::new(TIP_NOISE_M),
            tip_offset: TipOffset::new(TIP_NOISE_M),
            motors: ActuatorModel::new(Actuator::IDEAL, configuration.section_count()),
            unshown_rad: 0.0,
            resting: ActuatorModel::new(Actuator::IDEAL, configuration.section_count()),
        }
    }

    /// Sets the dynamics of the motors.
    #[must_use]
    pub fn with_actuator(mut self, robot: &Robot, actuator: Actuator) -> Self {
        self.motors = ActuatorModel::new(actuator, self.measured.section_count()).with_play(robot);
        self.resting = self.motors.clone();
        self
    }

    /// Sets the delay with which the disturbance follows the measurements \[s\], 0 or more: three first-order filters, each with a third of
    /// it as time constant. With one filter, noise changes the rates forty times as much (docs/robustness.md). If the motors lag more than
    /// the [`Actuator`] states, a time constant of four times the difference or more prevents oscillation.
    #[must_use]
    pub fn with_time_constant(mut self, time_constant_s: f64) -> Self {
        self.time_constant_s = time_constant_s;
        self
    }

    /// Sets the standard deviation of the noise in each coordinate of a measured tip \[m\], above 0.
    #[must_use]
    pub fn with_tip_noise(mut self, noise_m: f64) -> Self {
        self.tip = TipFilter::new(noise_m);
        self.tip_offset = TipOffset::new(noise_m);
        self
    }

    /// Takes the offset of the tip as constant in space, to show the effect of its slope. Call it after [`Self::with_tip_noise`].
    #[must_use]
    pub fn without_tip_slope(mut self) -> Self {
        self.tip_offset = self.tip_offset.without_slope();
        self
    }

    /// Restarts at `configuration`, with motors at rest. The tip offset is kept, because it is an error of the model.
    pub fn begin(&mut self, configuration: Configuration) {
        self.stages = [configuration; STAGES];
        self.measured = configuration;
        self.uncorrected_s = None;
        self.forget_beside();
        self.tip.begin();
        self.tip_offset.begin();
        self.unshown_rad = 0.0;
        self.motors.begin();
        self.commanded = self.motors.cables_commanded(&configuration);
    }

    /// Restarts at the unfiltered measurement, with motors still moving towards it.
    pub fn begin_moving(&mut self) {
        self.stages = [self.measured; STAGES];
        self.commanded = self.motors.cables_commanded(self.motors());
        self.uncorrected_s = None;
        self.forget_beside();
        self.tip_offset.begin();
    }

    /// Configuration to which the commands so far lead the robot.
    pub fn configuration(&self) -> &Configuration {
        &self.commanded
    }

    /// Configuration to which the commands so far lead the motors. The robot differs from it by the play of its cables.
    pub fn motors(&self) -> &Configuration {
        &self.stages[STAGES - 1]
    }

    /// The same by the last measurement alone, unfiltered.
    pub fn motors_measured(&self) -> &Configuration {
        &self.measured
    }

    /// State of the cables' play at [`Self::motors`]; `None`: no play.
    pub fn commanded_slack(&self) -> Option<&Slack> {
        self.motors.commanded_slack()
    }

    /// Present configuration of the motors: [`Self::motors`] less their remaining motion.
    pub fn motors_present(&self) -> Configuration {
        self.motors.remaining_motion(0.0).start_from(self.motors())
    }

    /// Present configuration of the robot: that of the motors, with the play of the cables.
    pub fn present(&self) -> Configuration {
        let motion = self.motors.remaining_motion(0.0);
        motion.cables_at_start(&motion.start_from(self.motors()))
    }

    /// Configuration of the robot at the end of the motors' delay, where the next command begins to act.
    pub fn delayed(&self) -> Configuration {
        let motion = self.motors.motion_after_delay();
        motion.cables_at_start(&motion.start_from(self.motors()))
    }

    /// Difference of the measured bends, averaged over some measurements, from [`Self::present`]: what the estimate does not know yet, for
    /// example a lag that the [`Actuator`] does not state. One wrong measurement does not change it.
    pub fn measured_beside(&self) -> &Configuration {
        &self.beside
    }

    fn forget_beside(&mut self) {
        let none = Configuration::straight(self.measured.section_count());
        self.beside_last = [none; 2];
        self.beside = none;
    }

    /// Takes the newest difference of the measurement from the estimate, `since_s` after the last one.
    fn learn_beside(&mut self, since_s: f64) {
        let gain = since_s / (since_s + BESIDE_TIME_S);
        let mut newest = self.measured;
        let pairs = newest.as_mut_slice().iter_mut();
        for (measured, estimated) in pairs.zip(self.stages[STAGES - 1].as_slice()) {
            *measured -= estimated;
        }
        let [before, last] = self.beside_last;
        let mut median = newest;
        let pairs = before.as_slice().iter().zip(last.as_slice());
        for (newest, (before, last)) in median.as_mut_slice().iter_mut().zip(pairs) {
            *newest = newest.min(before.max(*last)).max(before.min(*last));
        }
        self.beside = towards(&self.beside, &median, gain);
        self.beside_last = [last, newest];
    }

    /// Measured tip position minus the one from the bends (m), as learnt by [`Self::correct_tip`]: the error of the model at the tip.
    pub fn tip_offset_m(&self) -> Vector3<f64> {
        self.tip_offset.offset_m()
    }

    /// Upper bound on the tip's distance from the position given by the bends (m): the length of [`Self::tip_offset_m`] plus three standard
    /// deviations of its uncertainty, without the limit of its rate. The safe distance grows by as much ([`Robot::enlarged`]). 0 before the first tip position beside
    /// measured bends. While the tip is measured more than [`tip_offset_max_m`] from the position given by the bends, three times in a row, the bound is that
    /// distance: such a tip is not followed, but the body may be there.
    pub fn tip_margin_m(&self) -> f64 {
        self.tip_offset.margin_m()
    }

    /// Follows the tip again at once, though it was lost: another sensor measures it.
    pub fn trust_tip(&mut self) {
        self.tip_offset.trust();
    }

    /// Discards the tip offset, until the tip is measured again.
    pub fn forget_tip_offset(&mut self) {
        self.tip_offset = self.tip_offset.forgotten();
        self.motors.reset_band();
        self.commanded = self.motors.cables_commanded(self.motors());
    }

    /// Advances the estimate by `elapsed_s` at the commanded `rates`.
    pub fn predict(&mut self, rates: &BendRates, elapsed_s: f64) -> &Configuration {
        for stage in &mut self.stages {
            *stage = stage.advanced(rates, elapsed_s);
        }
        self.measured = self.measured.advanced(rates, elapsed_s);
        self.uncorrected_s = self.uncorrected_s.map(|time_s| time_s + elapsed_s);
        self.tip.predict(elapsed_s);
        self.tip_offset.predict(elapsed_s);
        self.motors.command(rates, elapsed_s);
        self.commanded = self.motors.cables_commanded(self.motors());
        &self.commanded
    }

    /// Takes a measurement made `age_s` before the time of the last prediction. The motion of the motors since then is added, so take each
    /// measurement only **once**.
    pub fn correct(
        &mut self,
        robot: &Robot,
        measurement: &Measurement,
        age_s: f64,
    ) -> &Configuration {
        let motion = self.motors.remaining_motion(age_s);
        self.measured = match measurement {
            Measurement::Configuration(measured) => {
                self.tip.set_known();
                motion.end_from(measured)
            }
            Measurement::CableLengths(lengths) => {
                self.tip.set_known();
                motion.end_from(&robot.bend_from_cable_lengths(lengths))
            }
            Measurement::TipPosition(position_m) => {
                let then = motion.cables_at_start(&motion.start_from(&self.measured));
                motion
                    .end_from(&motion.motors_at_start(&self.tip.correct(robot, &then, position_m)))
            }
        };
        let uncorrected_s = self.uncorrected_s.replace(0.0);
        let gain = match uncorrected_s {
            Some(since_s) if self.time_constant_s > 0.0 => {
                since_s / (since_s + self.time_constant_s / STAGES as f64)
            }
            _ => 1.0,
        };
        let mut before = self.measured;
        let motors_before = *self.motors();
        for stage in &mut self.stages {
            *stage = towards(stage, &before, gain);
            before = *stage;
        }
        self.learn_beside(uncorrected_s.unwrap_or_default());
        if self.tip_offset.is_measured() {
            // The tip sensor corrects the part of the motors' motion that the band withholds.
            self.motors.hold_cables(&motors_before, &before);
        }
        self.commanded = self.motors.cables_commanded(self.motors());
        if self.tip_offset.is_measured() {
            self.update_tip_offset(robot);
        }
        &self.commanded
    }

    /// Takes a tip position (m) beside measured bends. The bends are kept; the tip offset ([`Self::tip_offset_m`]) and its change along the
    /// path of the tip are learnt.
    ///
    /// # Errors
    /// It is not followed, and nothing is learnt.
    pub fn correct_tip(
        &mut self,
        robot: &Robot,
        position_m: &Vector3<f64>,
        age_s: f64,
    ) -> Result<(), TipRefusal> {
        self.update_tip_offset(robot);
        let motion = self.motors.remaining_motion(age_s);
        let then = motion.cables_at_start(&motion.start_from(self.motors()));
        let model_tip_m = robot.tip_position(&then);
        let has_play = self.motors.commanded_slack().is_some();
        self.tip_offset
            .correct(position_m, &model_tip_m, robot.reach_m(), has_play)
    }

    /// Updates the tip offset along the path of the tip. When cables begin to move, their place in the play is revised; the tip stays.
    fn update_tip_offset(&mut self, robot: &Robot) {
        self.tip_offset
            .update_model_tip(&robot.tip_position(&self.commanded));
        if self.motors.set_rest(!self.tip_offset.is_moving()) {
            self.commanded = self.motors.cables_commanded(self.motors());
            self.tip_offset
                .revise_model_tip(&robot.tip_position(&self.commanded));
        }
    }
}

/// `from` moved towards `to` by the share `gain`.
fn towards(from: &Configuration, to: &Configuration, gain: f64) -> Configuration {
    let mut moved = *from;
    for (moved, to) in moved.as_mut_slice().iter_mut().zip(to.as_slice()) {
        *moved += gain * (to - *moved);
    }
    moved
}

#[cfg(test)]
mod tests;
