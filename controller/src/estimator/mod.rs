//! The configuration at the release, from what was measured before it and commanded meanwhile.
//!
//! Invariant: nothing here commands or decides. A measurement and its age come in, a configuration
//! goes out.

mod actuator;
mod slack;
mod tip_filter;
mod tip_offset;
mod tip_slope;

use nalgebra::Vector3;

use crate::robot::{BendRates, CABLES_MAX, Configuration, Robot};
pub use actuator::Actuator;
use actuator::ActuatorModel;
pub use slack::Slack;
use tip_filter::{TIP_NOISE_M, TipFilter};
use tip_offset::TipOffset;

/// Filters that what is measured passes. The rates follow the estimate at once, so its second difference is what noise changes them by:
/// at the same delay that of three filters is a tenth of that of two.
const STAGES: usize = 3;

/// What a driver measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Measurement {
    /// The bend vector of every section.
    Configuration(Configuration),
    /// The length of every cable \[m\], section by section.
    CableLengths([f64; CABLES_MAX]),
    /// Position of the tip in the base frame \[m\]. It does not determine the configuration of two or
    /// more sections: a filter weighs it against what was known and commanded, and expects 0.3 mm of noise unless it is told otherwise
    /// ([`Estimator::with_tip_noise`]).
    TipPosition(Vector3<f64>),
}

/// Keeps the estimate of the configuration.
///
/// The motors follow their commands after a delay and with a lag ([`Actuator`]), and beside what they were told by a disturbance:
/// zero and load of the encoders and motors, errors of the model. The estimate is the sum of what was commanded and of the disturbance,
/// so it says **where the commands up to now lead the robot**, from where the next one moves it on. Where it is
/// meanwhile says [`Self::present`].
#[derive(Debug)]
pub struct Estimator {
    /// Where the commands lead the motors, as far as the measurements have been smoothed: the last one is the estimate.
    stages: [Configuration; STAGES],
    /// Where that takes the cables, and the robot with them.
    led: Configuration,
    /// What the measurements alone say, moved on as commanded; where they are believed at once, it is the estimate.
    measured: Configuration,
    /// By how much the disturbance follows later what is measured \[s\]; 0: at once.
    time_constant_s: f64,
    /// Predicted since the last measurement \[s\]; none: the next one is believed whole.
    uncorrected_s: Option<f64>,
    /// What tip positions have told of the bends, where nothing else measures them.
    tip: TipFilter,
    /// What they have told of the tip, where something does.
    tip_offset: TipOffset,
    motors: ActuatorModel,
}

impl Clone for Estimator {
    fn clone(&self) -> Self {
        Self {
            stages: self.stages,
            led: self.led,
            measured: self.measured,
            time_constant_s: self.time_constant_s,
            uncorrected_s: self.uncorrected_s,
            tip: self.tip.clone(),
            tip_offset: self.tip_offset.clone(),
            motors: self.motors.clone(),
        }
    }

    /// Takes no memory.
    fn clone_from(&mut self, source: &Self) {
        self.stages = source.stages;
        self.led = source.led;
        self.measured = source.measured;
        self.time_constant_s = source.time_constant_s;
        self.uncorrected_s = source.uncorrected_s;
        self.tip.clone_from(&source.tip);
        self.tip_offset.clone_from(&source.tip_offset);
        self.motors.clone_from(&source.motors);
    }
}

impl Estimator {
    /// Begins with a configuration that is known or assumed, and ideal motors. Measurements are believed at once.
    pub fn new(configuration: Configuration) -> Self {
        Self {
            stages: [configuration; STAGES],
            led: configuration,
            measured: configuration,
            time_constant_s: 0.0,
            uncorrected_s: None,
            tip: TipFilter::new(TIP_NOISE_M),
            tip_offset: TipOffset::new(TIP_NOISE_M),
            motors: ActuatorModel::new(Actuator::IDEAL, configuration.section_count()),
        }
    }

    /// The same with motors that follow their commands like this.
    #[must_use]
    pub fn with_actuator(mut self, robot: &Robot, actuator: Actuator) -> Self {
        self.motors = ActuatorModel::new(actuator, self.measured.section_count()).with_play(robot);
        self
    }

    /// The same with a disturbance that follows what is measured this much later \[s\], 0 or more: through three filters of first order, each
    /// with a third of it as its time constant. One alone makes the rates change forty times as much by noise (docs/robustness.md). Where the
    /// motors lag by more than the [`Actuator`] says, four times what is missing or more keeps the loop from oscillating.
    #[must_use]
    pub fn with_time_constant(mut self, time_constant_s: f64) -> Self {
        self.time_constant_s = time_constant_s;
        self
    }

    /// The same with tips whose coordinates are measured with noise of this standard deviation \[m\], above 0.
    #[must_use]
    pub fn with_tip_noise(mut self, noise_m: f64) -> Self {
        self.tip = TipFilter::new(noise_m);
        self.tip_offset = TipOffset::new(noise_m);
        self
    }

    /// The same where the offset of the tip does not go along with it: to see what that is for. Call it after [`Self::with_tip_noise`].
    #[must_use]
    pub fn without_tip_slope(mut self) -> Self {
        self.tip_offset = self.tip_offset.without_slope();
        self
    }

    /// Begins anew at `configuration`, with motors at rest. How far the tip is beside its bends stays: it is the model that is off.
    pub fn begin(&mut self, configuration: Configuration) {
        self.stages = [configuration; STAGES];
        self.measured = configuration;
        self.uncorrected_s = None;
        self.tip.begin();
        self.tip_offset.begin();
        self.motors.begin();
        self.led = self.motors.cables_led(&configuration);
    }

    /// Begins anew where the measurements alone say that the commands lead, with motors that are still on their way there.
    pub fn begin_moving(&mut self) {
        self.stages = [self.measured; STAGES];
        self.led = self.motors.cables_led(self.motors());
        self.uncorrected_s = None;
        self.tip_offset.begin();
    }

    /// Where the commands up to now lead the robot.
    pub fn configuration(&self) -> &Configuration {
        &self.led
    }

    /// Where the commands up to now lead the motors: the robot is beside that by the play of its cables.
    pub fn motors(&self) -> &Configuration {
        &self.stages[STAGES - 1]
    }

    /// What of the play of its cables is taken there; `None`: they have none.
    pub fn slack_led(&self) -> Option<&Slack> {
        self.motors.slack_led()
    }

    /// Where the motors are: behind that by what they have left of their way.
    pub fn motors_present(&self) -> Configuration {
        self.motors.way_left(0.0).back_from(self.motors())
    }

    /// Where the robot is: behind that by what its motors are behind their commands.
    pub fn present(&self) -> Configuration {
        let way = self.motors.way_left(0.0);
        way.cables(&way.back_from(self.motors()))
    }

    /// How far the tip is measured beside where the bends place it (m), as [`Self::correct_tip`] has learnt: what the model is off by there.
    pub fn tip_offset_m(&self) -> Vector3<f64> {
        self.tip_offset.offset_m()
    }

    /// How far the tip may be beside where the bends place it (m): the length of [`Self::tip_offset_m`], and three standard deviations of what
    /// the measurements leave open of it. So much more distance the body keeps ([`Robot::thicker`]). 0 before a tip was measured beside bends.
    pub fn tip_margin_m(&self) -> f64 {
        self.tip_offset.margin_m()
    }

    /// The tip is where the bends place it, until it is measured again.
    pub fn forget_tip_offset(&mut self) {
        self.tip_offset = self.tip_offset.forgotten();
        self.motors.let_go();
        self.led = self.motors.cables_led(self.motors());
    }

    /// The last estimate moved on by `elapsed_s` with the `rates` commanded meanwhile.
    pub fn predict(&mut self, rates: &BendRates, elapsed_s: f64) -> &Configuration {
        for stage in &mut self.stages {
            *stage = stage.advanced(rates, elapsed_s);
        }
        self.measured = self.measured.advanced(rates, elapsed_s);
        self.uncorrected_s = self.uncorrected_s.map(|time_s| time_s + elapsed_s);
        self.tip.predict(elapsed_s);
        self.tip_offset.predict(elapsed_s);
        self.motors.command(rates, elapsed_s);
        self.led = self.motors.cables_led(self.motors());
        &self.led
    }

    /// Takes a measurement that was made `age_s` before the instant of the last prediction. What the motors did
    /// since makes up for its age, so take each measurement **once**.
    pub fn correct(
        &mut self,
        robot: &Robot,
        measurement: &Measurement,
        age_s: f64,
    ) -> &Configuration {
        let way = self.motors.way_left(age_s);
        self.measured = match measurement {
            Measurement::Configuration(measured) => {
                self.tip.know_all();
                way.from(measured)
            }
            Measurement::CableLengths(lengths) => {
                self.tip.know_all();
                way.from(&robot.bend_from_cable_lengths(lengths))
            }
            Measurement::TipPosition(position_m) => {
                let then = way.cables(&way.back_from(&self.measured));
                way.from(&way.motors(&self.tip.correct(robot, &then, position_m)))
            }
        };
        let gain = match self.uncorrected_s.replace(0.0) {
            Some(since_s) if self.time_constant_s > 0.0 => {
                since_s / (since_s + self.time_constant_s / STAGES as f64)
            }
            _ => 1.0,
        };
        let mut before = self.measured;
        let led = *self.motors();
        for stage in &mut self.stages {
            *stage = towards(stage, &before, gain);
            before = *stage;
        }
        if self.tip_offset.is_measured() {
            // The sensor of the tip makes up for what is not believed of them.
            self.motors.hold(&led, &before);
        }
        self.led = self.motors.cables_led(self.motors());
        if self.tip_offset.is_measured() {
            self.follow_tip(robot);
        }
        &self.led
    }

    /// Takes the position of a tip (m) whose bends are measured, too: they stay, and how far the tip is beside where they place it
    /// is learnt ([`Self::tip_offset_m`]), and how that changes along its way: between two positions it goes along. False, and nothing learnt, where it is more than 0.1 m beside, not finite, or in every bit the
    /// last one: a sensor that stands still while the robot moves says nothing.
    pub fn correct_tip(&mut self, robot: &Robot, position_m: &Vector3<f64>, age_s: f64) -> bool {
        self.follow_tip(robot);
        let way = self.motors.way_left(age_s);
        let then = way.cables(&way.back_from(self.motors()));
        let placed_m = robot.tip_position(&then);
        let has_play = self.motors.slack_led().is_some();
        self.tip_offset.correct(position_m, &placed_m, has_play)
    }

    /// The offset of the tip goes along with it. Cables that begin to move are taken to be elsewhere in their play; the tip stays.
    fn follow_tip(&mut self, robot: &Robot) {
        self.tip_offset.follow(&robot.tip_position(&self.led));
        if self.motors.rest(!self.tip_offset.is_moving()) {
            self.led = self.motors.cables_led(self.motors());
            self.tip_offset.place(&robot.tip_position(&self.led));
        }
    }
}

/// `from`, moved by a part `gain` of the way to `to`.
fn towards(from: &Configuration, to: &Configuration, gain: f64) -> Configuration {
    let mut moved = *from;
    for (moved, to) in moved.as_mut_slice().iter_mut().zip(to.as_slice()) {
        *moved += gain * (to - *moved);
    }
    moved
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::RobotParameters;

    fn robot(sections: usize) -> Robot {
        Robot::new(&RobotParameters::paper(sections)).expect("the paper's robot")
    }

    #[test]
    fn age_is_made_up_by_what_was_commanded_since_not_by_the_present_rates() {
        let robot = robot(1);
        let rates = |u: f64| BendRates::from_slice(&[u, 0.0]).unwrap();
        let mut estimator = Estimator::new(Configuration::straight(1));
        for u in [1.0, 2.0, -3.0] {
            estimator.predict(&rates(u), 0.005);
        }
        // Measured 12.5 ms ago: after half of the first move.
        let measured = Configuration::from_slice(&[0.1, 0.0]).unwrap();
        let lengths = robot.cable_lengths(&measured);
        let expected = 0.1 + 0.0025 * 1.0 + 0.005 * 2.0 - 0.005 * 3.0;
        for measurement in [
            Measurement::Configuration(measured),
            Measurement::CableLengths(lengths),
        ] {
            let estimate = *estimator.correct(&robot, &measurement, 0.0125);
            assert!(
                (estimate.as_slice()[0] - expected).abs() < 1e-13,
                "{estimate:?}"
            );
        }
    }

    #[test]
    fn a_tip_position_determines_one_section_and_corrects_several() {
        for sections in 1..=3 {
            let robot = robot(sections);
            let values: Vec<f64> = (0..2 * sections).map(|i| 0.4 - 0.1 * i as f64).collect();
            let truth = Configuration::from_slice(&values).unwrap();
            let off: Vec<f64> = values.iter().map(|value| value + 0.02).collect();
            let mut estimator = Estimator::new(Configuration::from_slice(&off).unwrap());
            let rates = BendRates::from_slice(&vec![1.0; 2 * sections]).unwrap();
            estimator.predict(&rates, 0.005);
            // Measured before that move.
            let tip = robot.tip_position(&truth);
            let estimate = *estimator.correct(&robot, &Measurement::TipPosition(tip), 0.005);
            let now = truth.advanced(&rates, 0.005);
            let error = (robot.tip_position(&estimate) - robot.tip_position(&now)).norm();
            // Nothing was known before, so that the noise which the filter expects counts for little.
            assert!(error < 5e-4, "{error}");
        }
    }

    /// A robot that obeys positions is pushed aside, and only its tip is measured: filter and smoothing follow each other, and
    /// do not weaken each other's gain.
    #[test]
    fn the_offset_of_a_tip_is_learnt_within_a_second() {
        for sections in 1..=3 {
            let robot = robot(sections);
            let truth = Configuration::from_slice(&vec![0.31; 2 * sections]).unwrap();
            let begin = Configuration::from_slice(&vec![0.3; 2 * sections]).unwrap();
            let mut estimator = Estimator::new(begin).with_time_constant(0.1);
            // It was known where it is.
            let begin_tip = Measurement::TipPosition(robot.tip_position(&begin));
            estimator.correct(&robot, &begin_tip, 0.0);
            let tip = robot.tip_position(&truth);
            let error_m = |estimate: &Configuration| (robot.tip_position(estimate) - tip).norm();
            let begin_m = error_m(&begin);
            let rest = BendRates::zero(sections);
            let mut left = 0.0;
            for _ in 0..200 {
                estimator.predict(&rest, 0.005);
                let estimate = *estimator.correct(&robot, &Measurement::TipPosition(tip), 0.0);
                left = error_m(&estimate) / begin_m;
            }
            assert!(left < 0.05, "{sections} sections: {left} is left");
        }
    }

    /// Normal numbers of standard deviation 1, the same in every run.
    fn noise(state: &mut u64) -> f64 {
        let mut uniform = || {
            *state = state
                .wrapping_mul(0x5851_f42d_4c95_7f2d)
                .wrapping_add(0x1405_7b7e_f767_814f);
            ((*state >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
        };
        let radius = (-2.0 * uniform().ln()).sqrt();
        radius * (core::f64::consts::TAU * uniform()).cos()
    }

    fn noisy(position_m: Vector3<f64>, deviation_m: f64, state: &mut u64) -> Measurement {
        let noise_m = Vector3::from_fn(|_, _| deviation_m * noise(state));
        Measurement::TipPosition(position_m + noise_m)
    }

    /// A step that believes each measurement goes 1e5 rad astray here: no bend moves the tip of a straight robot along its axis.
    #[test]
    fn a_noisy_tip_of_a_straight_robot_at_rest_does_not_lead_the_estimate_astray() {
        for sections in 1..=6 {
            let robot = robot(sections);
            let truth = Configuration::straight(sections);
            let rest = BendRates::zero(sections);
            let mut estimator = Estimator::new(truth);
            let (mut state, mut farthest_m) = (sections as u64, 0.0_f64);
            let tip = robot.tip_position(&truth);
            for cycle in 0..4000 {
                estimator.predict(&rest, 0.005);
                let measured = noisy(tip, 1e-3, &mut state);
                let estimate = *estimator.correct(&robot, &measured, 0.0);
                let bend = estimate
                    .as_slice()
                    .iter()
                    .fold(0.0_f64, |a, b| a.max(b.abs()));
                assert!(bend < 1.0, "{sections} sections, cycle {cycle}: {bend} rad");
                if cycle > 100 {
                    farthest_m = farthest_m.max((robot.tip_position(&estimate) - tip).norm());
                }
            }
            assert!(farthest_m < 3e-3, "{sections} sections: {farthest_m} m");
        }
    }

    /// Of a sensor that is known to be better, the same measurement moves the estimate farther.
    #[test]
    fn a_tip_counts_by_its_noise() {
        let robot = robot(1);
        let truth = Configuration::from_slice(&[0.31, 0.3]).unwrap();
        let begin = Configuration::from_slice(&[0.3, 0.3]).unwrap();
        let left = |noise_m: f64| {
            let mut estimator = Estimator::new(begin).with_tip_noise(noise_m);
            let tip = Measurement::TipPosition(robot.tip_position(&truth));
            let estimate = *estimator.correct(&robot, &tip, 0.0);
            (truth.as_slice()[0] - estimate.as_slice()[0]) / 0.01
        };
        // Known to 0.01 rad before, and 0.15 m from the base a radian moves the tip by that.
        assert!(
            left(1e-5) < 1e-3 && left(1e-1) > 0.99,
            "{} {}",
            left(1e-5),
            left(1e-1)
        );
        assert!((0.3..0.7).contains(&left(1.5e-3)), "{}", left(1.5e-3));
    }

    #[test]
    fn the_filter_averages_the_noise_of_a_tip_that_moves_as_commanded() {
        for sections in 1..=3 {
            let robot = robot(sections);
            let mut truth = Configuration::from_slice(&vec![0.3; 2 * sections]).unwrap();
            let mut estimator = Estimator::new(Configuration::straight(sections));
            let mut state = 7 + sections as u64;
            let mut squares = 0.0;
            for cycle in 0..4000 {
                let turn = f64::from(cycle) * 0.005;
                let rates: Vec<_> = (0..2 * sections)
                    .map(|i| 0.4 * (turn * (1.0 + 0.3 * i as f64) + i as f64).sin())
                    .collect();
                let rates = BendRates::from_slice(&rates).unwrap();
                truth = truth.advanced(&rates, 0.005);
                estimator.predict(&rates, 0.005);
                let tip = robot.tip_position(&truth);
                let measured = noisy(tip, 3e-4, &mut state);
                let estimate = *estimator.correct(&robot, &measured, 0.0);
                if cycle >= 1000 {
                    squares += (robot.tip_position(&estimate) - tip).norm_squared();
                }
            }
            let deviation_m = (squares / 3000.0).sqrt();
            // Of the measurements themselves: √3 · 0.3 mm.
            assert!(deviation_m < 3e-4, "{sections} sections: {deviation_m} m");
        }
    }

    /// Beside the offset the body keeps what noise leaves open of it: along an axis the tip is farther beside in few moments, and for less noise
    /// it keeps less.
    #[test]
    fn the_margin_is_the_offset_and_what_noise_leaves_open_of_it() {
        let robot = robot(3);
        let at = Configuration::from_slice(&[0.3; 6]).unwrap();
        let truth_m = Vector3::new(0.01, -0.02, 0.005);
        let tip_m = robot.tip_position(&at) + truth_m;
        let lengths = Measurement::CableLengths(robot.cable_lengths(&at));
        let [more_m, less_m] = [3e-4, 1e-4].map(|noise_m| {
            let estimator = Estimator::new(at).with_time_constant(0.1);
            let mut estimator = estimator.with_tip_noise(noise_m);
            assert_eq!(estimator.tip_margin_m(), 0.0);
            let (mut state, mut beyond, mut open_m) = (7, 0, 0.0);
            for cycle in 0..2200 {
                estimator.predict(&BendRates::zero(3), 0.005);
                estimator.correct(&robot, &lengths, 0.0);
                let seen_m = tip_m.map(|m| m + noise_m * noise(&mut state));
                assert!(estimator.correct_tip(&robot, &seen_m, 0.0));
                let offset_m = estimator.tip_offset_m();
                open_m = estimator.tip_margin_m() - offset_m.norm();
                let off_m = offset_m - truth_m;
                if cycle >= 200 {
                    beyond += off_m.iter().filter(|m| m.abs() > open_m).count();
                }
            }
            println!("{noise_m} m: {open_m} m, {beyond} of 6000 beyond");
            assert!(beyond < 30 && open_m < 1.5 * noise_m, "{beyond}, {open_m}");
            open_m
        });
        assert!(less_m < 0.7 * more_m, "{less_m} {more_m}");
    }
}
