use cdcr_controller::estimator::{Estimator, Measurement, Slack};
use cdcr_controller::reference::ReferenceSample;
use cdcr_controller::robot::{BendRates, Configuration, Pose, Robot};
use cdcr_controller::safety::{
    CommonModeWatch, FollowingWatch, MeasurementWatch, Plausibility, Reason,
};
use nalgebra::Vector3;

use crate::config::Interface;
use crate::handover::{CycleInputs, MeasurementUse, Policy, TimedMeasurement};

/// A bend may be measured this much beyond its limit before it is a fault \[rad\]: sensor noise.
const BEND_TOLERANCE_RAD: f64 = 0.05;
/// Motors this near to the end of their way have arrived \[rad\].
const ARRIVED_RAD: f64 = 1e-3;
/// All bends below this are straight at once \[rad\].
const HOME_EXACT_RAD: f64 = 1e-6;
/// A robot whose bends are all within the tolerance for this long is straight, too: sensors have noise \[ns\].
const HOME_SETTLED_NS: u64 = 100_000_000;

/// What a cycle knows of the robot: where it was commanded to be, where it was measured, where it is.
#[derive(Debug)]
pub(super) struct RobotState {
    pub(super) robot: Robot,
    policy: Policy,
    period_ns: u64,
    pub(super) estimator: Estimator,
    present: Configuration,
    /// A state, moved by the commanded rates and by nothing else while the robot is in control. A robot that obeys
    /// positions is told it.
    pub(super) commanded: Configuration,
    pub(super) following: FollowingWatch,
    pub(super) plausibility: MeasurementWatch,
    common_mode: CommonModeWatch,
    /// Of the tip beside bends or cables.
    pub(super) tip_plausibility: MeasurementWatch,
    last_tip_ns: u64,
    /// Sensors that measured it so far.
    tip_sensors: u64,
    /// The tip froze or jumped until nobody could say where it is: it is not used before control begins anew.
    tip_is_wrong: bool,
    /// Where the robot was last measured, as far as that tells its configuration.
    measured: Option<Configuration>,
    last_measured_ns: u64,
    last_gather_ns: u64,
    /// Time of gathers without a fresh measurement \[ns\].
    unmeasured_ns: u64,
    /// How long the robot has been straight within the tolerance \[ns\].
    straight_ns: u64,
    /// What the measurement of this cycle shows.
    measurement_fault: Option<Reason>,
}

impl RobotState {
    /// A robot that is taken to be at `initial` until it is measured.
    pub(super) fn new(
        robot: Robot,
        policy: Policy,
        period_ns: u64,
        initial: Configuration,
    ) -> Self {
        let obeys_positions = policy.interface == Interface::Position;
        let estimator = Estimator::new(initial)
            .with_actuator(&robot, policy.actuator)
            .with_time_constant(policy.estimator_time_constant_s)
            .with_tip_noise(policy.tip_noise_m);
        Self {
            robot,
            policy,
            period_ns,
            estimator,
            present: initial,
            commanded: initial,
            following: FollowingWatch::new(policy.following, obeys_positions, initial),
            plausibility: MeasurementWatch::new(policy.plausibility),
            common_mode: CommonModeWatch::new(policy.cable_common_m),
            tip_plausibility: MeasurementWatch::new(policy.plausibility),
            last_tip_ns: 0,
            tip_sensors: 0,
            tip_is_wrong: false,
            measured: None,
            last_measured_ns: 0,
            last_gather_ns: 0,
            unmeasured_ns: 0,
            straight_ns: 0,
            measurement_fault: None,
        }
    }

    /// Where the commands up to now lead the robot, as far as that is known.
    pub(super) fn configuration(&self) -> &Configuration {
        self.estimator.configuration()
    }

    /// Where they lead its motors: the robot is beside that by the play of its cables.
    pub(super) fn motors(&self) -> &Configuration {
        self.estimator.motors()
    }

    /// What of the play of the cables is taken there; `None`: they have none.
    pub(super) fn slack_led(&self) -> Option<&Slack> {
        self.estimator.slack_led()
    }

    /// Where the motors are led, where the robot is beside that: commanded positions, or motors beside cables that have play.
    pub(super) fn motors_led(&self) -> Option<&Configuration> {
        match self.policy.interface {
            Interface::Position => Some(&self.commanded),
            Interface::Velocity => {
                Some(self.motors()).filter(|motors| *motors != self.configuration())
            }
        }
    }

    /// Where it is now: behind that where its motors are behind their commands.
    pub(super) fn present(&self) -> &Configuration {
        &self.present
    }

    /// Whether its motors have come to where the commands lead them, as far as that is known.
    pub(super) fn has_arrived(&self) -> bool {
        // Not the cables, which stand still while motors run through their play.
        let here = self.estimator.motors_present();
        let ends = self.estimator.motors().as_slice();
        let mut pairs = here.as_slice().iter().zip(ends);
        pairs.all(|(here, end)| (end - here).abs() < ARRIVED_RAD)
    }

    pub(super) fn commanded(&self) -> &Configuration {
        &self.commanded
    }

    pub(super) fn following(&self) -> &FollowingWatch {
        &self.following
    }

    /// The robot moved by `rates`, the last command, `elapsed_ns` ago.
    pub(super) fn move_on(&mut self, rates: &BendRates, elapsed_ns: u64) {
        let moving_ns = self.policy.moving_ns(elapsed_ns, self.period_ns);
        let (moving_s, elapsed_s) = (moving_ns as f64 * 1e-9, elapsed_ns as f64 * 1e-9);
        self.estimator.predict(rates, moving_s);
        if elapsed_ns > moving_ns {
            // Then it held.
            let rest = BendRates::zero(self.robot.section_count());
            self.estimator.predict(&rest, elapsed_s - moving_s);
        }
        self.commanded = self.commanded.advanced(rates, moving_s);
        self.following.commanded(rates, moving_s, elapsed_s);
        self.plausibility.commanded(rates, moving_s);
        self.tip_plausibility.commanded(rates, moving_s);
    }

    /// Takes in what was measured before `release_ns`, if it is new and can be.
    pub(super) fn measure(
        &mut self,
        measurement: Option<TimedMeasurement>,
        release_ns: u64,
    ) -> MeasurementUse {
        self.measurement_fault = None;
        let Some(TimedMeasurement {
            measurement,
            measured_ns,
        }) = measurement
        else {
            return MeasurementUse::None;
        };
        if measured_ns <= self.last_measured_ns {
            return MeasurementUse::Repeated;
        }
        let is_first = self.last_measured_ns == 0;
        self.last_measured_ns = measured_ns;
        match self
            .plausibility
            .check(&self.robot, &measurement, measured_ns)
        {
            Plausibility::Jump => return MeasurementUse::Implausible,
            Plausibility::Lost => {
                self.measurement_fault = Some(Reason::MeasurementJump);
                return MeasurementUse::Implausible;
            }
            Plausibility::Frozen => self.measurement_fault = Some(Reason::MeasurementFrozen),
            Plausibility::Good => {}
        }
        if let Measurement::CableLengths(lengths_m) = &measurement
            && self.common_mode.is_broken(&self.robot, lengths_m)
        {
            self.measurement_fault = Some(Reason::CommonMode);
        }
        let age_s = (release_ns as f64 - measured_ns as f64) * 1e-9;
        self.estimator.correct(&self.robot, &measurement, age_s);
        self.measured = configuration_of(&self.robot, &measurement);
        if is_first {
            // A tip that was measured before is beside bends that were a guess.
            self.estimator.forget_tip_offset();
            self.take_control();
        }
        if let Some(measured) = &self.measured {
            self.following.measured(&self.robot, measured);
        }
        MeasurementUse::Used
    }

    /// Takes in a tip that was measured beside bends or cables: it says how far the model is off there. One that cannot be is
    /// left out; that is no fault, since the bends are measured. What one sensor said is no reason to doubt the next one, of `tip_sensors` so far;
    /// the offset stays until that has told otherwise: it is the model that is off, and the tip must not jump.
    pub(super) fn measure_tip(
        &mut self,
        measurement: Option<TimedMeasurement>,
        tip_sensors: u64,
        release_ns: u64,
    ) -> MeasurementUse {
        if core::mem::replace(&mut self.tip_sensors, tip_sensors) != tip_sensors {
            self.trust_tip();
        }
        let Some(timed) = measurement else {
            return MeasurementUse::None;
        };
        if timed.measured_ns <= self.last_tip_ns {
            return MeasurementUse::Repeated;
        }
        self.last_tip_ns = timed.measured_ns;
        let TimedMeasurement {
            measurement,
            measured_ns,
        } = timed;
        let found = self
            .tip_plausibility
            .check(&self.robot, &measurement, measured_ns);
        self.tip_is_wrong |= matches!(found, Plausibility::Lost | Plausibility::Frozen);
        if self.tip_is_wrong || found == Plausibility::Jump {
            return MeasurementUse::Implausible;
        }
        let Measurement::TipPosition(position_m) = measurement else {
            return MeasurementUse::None;
        };
        let age_s = (release_ns as f64 - measured_ns as f64) * 1e-9;
        if self.estimator.correct_tip(&self.robot, &position_m, age_s) {
            MeasurementUse::Used
        } else {
            MeasurementUse::Implausible
        }
    }

    /// A tip that froze or jumped for good is taken to be where the bends place it.
    pub(super) fn give_up_wrong_tip(&mut self) {
        if self.tip_is_wrong {
            self.estimator.forget_tip_offset();
        }
    }

    /// How far the tip is measured beside where the bends place it (m).
    pub(super) fn tip_offset_m(&self) -> Vector3<f64> {
        self.estimator.tip_offset_m()
    }

    /// How far it may be beside that (m): so much thicker the body counts.
    pub(super) fn tip_margin_m(&self) -> f64 {
        self.estimator.tip_margin_m()
    }

    pub(super) fn tip(&self) -> Pose {
        self.tip_at(&self.present)
    }

    /// Whether a reference is farther from the tip than it may be approached from.
    pub(super) fn is_too_far(&self, reference: &ReferenceSample) -> bool {
        let most_m = self.policy.approach_distance_m;
        most_m.is_finite() && (self.tip().position_m - reference.position_m).norm() > most_m
    }

    /// Where the commands up to now lead the tip.
    pub(super) fn tip_led(&self) -> Pose {
        self.tip_at(self.configuration())
    }

    fn tip_at(&self, configuration: &Configuration) -> Pose {
        let pose = self.robot.tip_pose(configuration);
        Pose {
            position_m: pose.position_m + self.tip_offset_m(),
            ..pose
        }
    }

    /// Control begins where the robot is: at the start, and when a latched mode is left, in which it may have been moved
    /// by hand.
    pub(super) fn take_control(&mut self) {
        let here = self.measured.unwrap_or(*self.estimator.motors());
        self.following.begin(here);
        self.estimator.begin(here);
        self.begin_at(here);
    }

    /// The same while the motors are still on their way: control begins where that leads them from where they were measured.
    pub(super) fn take_control_moving(&mut self) {
        self.estimator.begin_moving();
        let end = *self.estimator.motors();
        self.following.begin_moving(end);
        self.begin_at(end);
    }

    fn begin_at(&mut self, at: Configuration) {
        self.commanded = at;
        self.present = self.estimator.present();
        self.common_mode.begin();
        self.trust_tip();
    }

    /// Whatever is measured of the tip next may be right.
    fn trust_tip(&mut self) {
        self.tip_plausibility = MeasurementWatch::new(self.policy.plausibility);
        self.tip_is_wrong = false;
    }

    /// Counts how long no fresh measurement has come, in time that gathers have seen: after a stall of the machine
    /// what the driver sent meanwhile must first be taken in.
    pub(super) fn count_silence(
        &mut self,
        measurement: Option<TimedMeasurement>,
        inputs: &CycleInputs,
    ) {
        let passed_ns = inputs.gather_ns.saturating_sub(self.last_gather_ns);
        self.last_gather_ns = inputs.gather_ns;
        let Some(TimedMeasurement { measured_ns, .. }) = measurement else {
            return;
        };
        let age_ns = inputs.gather_ns.saturating_sub(measured_ns);
        let is_fresh =
            measured_ns > self.last_measured_ns && age_ns <= self.policy.measurement_timeout_ns;
        self.unmeasured_ns = if is_fresh {
            age_ns
        } else {
            self.unmeasured_ns + passed_ns.min(2 * self.period_ns)
        };
    }

    /// Where the robot is after all that was measured and commanded, and how long it has been straight, in time that was
    /// seen: a stall on the way through is no rest.
    pub(super) fn locate(&mut self, elapsed_ns: u64) {
        self.present = self.estimator.present();
        self.straight_ns = if self.is_within(self.policy.home_tolerance_rad) {
            let seen_ns = elapsed_ns.min(2 * self.period_ns);
            self.straight_ns.saturating_add(seen_ns)
        } else {
            0
        };
    }

    /// Whether it is straight, exactly or for long enough.
    pub(super) fn is_at_home(&self) -> bool {
        self.is_within(HOME_EXACT_RAD) || self.straight_ns >= HOME_SETTLED_NS
    }

    fn is_within(&self, tolerance_rad: f64) -> bool {
        let mut bends = self.present.as_slice().iter();
        bends.all(|bend| bend.abs() < tolerance_rad)
    }

    pub(super) fn measurement_fault(&self) -> Option<Reason> {
        if self.unmeasured_ns > self.policy.measurement_timeout_ns {
            return Some(Reason::MeasurementLost);
        }
        self.measurement_fault
    }

    /// What is wrong with where it is.
    pub(super) fn place_fault(&self) -> Option<Reason> {
        let estimate = self.configuration();
        if !estimate.is_finite() {
            return Some(Reason::NonFinite);
        }
        let at = self.measured.as_ref().unwrap_or(estimate);
        let mut sections = self.robot.sections().iter().enumerate();
        let beyond = sections
            .any(|(index, section)| at.bend_rad(index) > section.bend_max_rad + BEND_TOLERANCE_RAD);
        beyond.then_some(Reason::LimitBroken)
    }
}

/// The configuration that a measurement tells; a tip position does not.
fn configuration_of(robot: &Robot, measurement: &Measurement) -> Option<Configuration> {
    match measurement {
        Measurement::Configuration(measured) => Some(*measured),
        Measurement::CableLengths(lengths) => Some(robot.bend_from_cable_lengths(lengths)),
        Measurement::TipPosition(_) => None,
    }
}
