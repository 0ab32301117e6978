use cdcr_controller::estimator::{Estimator, Measurement, Slack, tip_offset_max_m};
use cdcr_controller::reference::ReferenceSample;
use cdcr_controller::robot::{BendRates, Configuration, Pose, Robot};
use cdcr_controller::safety::{
    BEND_TOLERANCE_RAD, BendLimitWatch, CommonModeWatch, FollowingWatch, MeasurementWatch,
    Plausibility, Reason,
};
use nalgebra::Vector3;

use super::silence::{HIDDEN_MAX, SilenceWatch, age_s};
use super::tip_watch::TipWatch;
use crate::config::Interface;
use crate::handover::{CycleInputs, MeasurementUse, Policy, TimedMeasurement};

/// Commanded positions within this distance of the measured one stay when control begins \[rad\]: zero and load
/// of motors and encoders. A driver accepts such a first position.
const BESIDE_RAD: f64 = BEND_TOLERANCE_RAD;
/// Motors within this distance of the end of their motion have arrived \[rad\].
const ARRIVED_RAD: f64 = 1e-3;
/// Bends all below this count as straight at once \[rad\].
const HOME_EXACT_RAD: f64 = 1e-6;
/// Bends within the home tolerance for this long count as straight \[ns\]: sensors have noise.
const HOME_SETTLED_NS: u64 = 100_000_000;

/// State of the robot as a cycle knows it: commanded, measured and estimated.
#[derive(Debug)]
pub(super) struct RobotState {
    pub(super) robot: Robot,
    policy: Policy,
    period_ns: u64,
    pub(super) estimator: Estimator,
    present: Configuration,
    delayed: Configuration,
    /// Commanded position: while the robot is in control, only the commanded rates change it. A robot with
    /// the position interface receives it.
    pub(super) commanded: Configuration,
    /// Number of drivers so far, and whether control has not begun since the last one came: it does not yet obey.
    drivers: u64,
    is_driver_new: bool,
    /// Control has begun before: the commanded position is not an assumed one.
    has_begun: bool,
    /// Where control begins, while the commanded position is on its way there.
    begins_at: Option<Configuration>,
    pub(super) following: FollowingWatch,
    pub(super) plausibility: MeasurementWatch,
    common_mode: CommonModeWatch,
    bend_limit: BendLimitWatch,
    pub(super) tip_watch: TipWatch,
    /// Last measured configuration; `None` if the measurement does not determine it.
    pub(super) measured: Option<Configuration>,
    last_measured_ns: u64,
    last_gather_ns: u64,
    silence: SilenceWatch,
    /// Time of gathers without a fresh measurement \[ns\].
    unmeasured_ns: u64,
    /// Time for which the robot has been straight within the tolerance \[ns\].
    straight_ns: u64,
    /// The newest measurement was a jump.
    is_measurement_rejected: bool,
    /// Fault found in the measurement of this cycle.
    measurement_fault: Option<Reason>,
    /// The channel of the newest measurement that is frozen.
    pub(super) frozen_channel: Option<usize>,
}

impl RobotState {
    /// A robot assumed to be at `initial` until the first measurement.
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
            delayed: initial,
            commanded: initial,
            drivers: 0,
            is_driver_new: false,
            has_begun: false,
            begins_at: None,
            following: FollowingWatch::new(policy.following, obeys_positions, initial),
            plausibility: MeasurementWatch::new(policy.plausibility),
            common_mode: CommonModeWatch::new(policy.cable_common_m),
            bend_limit: BendLimitWatch::new(0.5 * policy.plausibility.jump_rad, initial),
            tip_watch: TipWatch::new(policy.plausibility),
            measured: None,
            last_measured_ns: 0,
            last_gather_ns: 0,
            silence: SilenceWatch::new(&policy),
            unmeasured_ns: 0,
            straight_ns: 0,
            is_measurement_rejected: false,
            measurement_fault: None,
            frozen_channel: None,
        }
    }

    /// Estimated configuration to which the commands so far lead the robot.
    pub(super) fn configuration(&self) -> &Configuration {
        self.estimator.configuration()
    }

    /// Motor positions to which the commands lead; the play of the cables separates them from the
    /// configuration.
    pub(super) fn motors(&self) -> &Configuration {
        self.estimator.motors()
    }

    /// State of the cables' play there; `None`: no play.
    pub(super) fn commanded_slack(&self) -> Option<&Slack> {
        self.estimator.commanded_slack()
    }

    /// Motor positions, if they differ from the configuration: commanded positions, or motors whose cables
    /// have play.
    pub(super) fn commanded_motors(&self) -> Option<&Configuration> {
        match self.policy.interface {
            Interface::Position => Some(&self.commanded),
            Interface::Velocity => {
                Some(self.motors()).filter(|motors| *motors != self.configuration())
            }
        }
    }

    /// Present configuration; behind the commanded one if the motors lag.
    pub(super) fn present(&self) -> &Configuration {
        &self.present
    }

    /// Configuration at the end of the motors' delay, where the next command begins to act.
    pub(super) fn delayed(&self) -> &Configuration {
        &self.delayed
    }

    /// The motors are estimated to have completed their commands.
    pub(super) fn has_arrived(&self) -> bool {
        // Motors, not cables: cables stand still while the motors take up the play.
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

    /// Advances the state by `rates`, the last command, over the `elapsed_ns` since it was given.
    pub(super) fn move_on(&mut self, rates: &BendRates, elapsed_ns: u64) {
        let moving_ns = self.policy.moving_ns(elapsed_ns, self.period_ns);
        let (moving_s, elapsed_s) = (moving_ns as f64 * 1e-9, elapsed_ns as f64 * 1e-9);
        self.estimator.predict(rates, moving_s);
        if elapsed_ns > moving_ns {
            // Afterwards the robot held.
            let rest = BendRates::zero(self.robot.section_count());
            self.estimator.predict(&rest, elapsed_s - moving_s);
        }
        self.commanded = self.commanded.advanced(rates, moving_s);
        self.following.commanded(rates, moving_s, elapsed_s);
        // On the way of the commanded position to the robot, motors may hold and not yet obey.
        if self.begins_at.is_none() {
            self.plausibility.commanded(rates, moving_s);
            self.tip_watch.plausibility.commanded(rates, moving_s);
        }
    }

    /// Uses a measurement made before `release_ns`, if it is new and plausible.
    pub(super) fn measure(
        &mut self,
        measurement: Option<TimedMeasurement>,
        release_ns: u64,
    ) -> MeasurementUse {
        self.measurement_fault = None;
        self.frozen_channel = None;
        let Some(timed) = measurement else {
            return MeasurementUse::None;
        };
        let (measurement, measured_ns) = (timed.measurement, timed.measured_ns);
        if measured_ns <= self.last_measured_ns {
            return MeasurementUse::Repeated;
        }
        let is_first = self.last_measured_ns == 0;
        self.last_measured_ns = measured_ns;
        let found = self
            .plausibility
            .check(&self.robot, &measurement, measured_ns);
        self.is_measurement_rejected = matches!(found, Plausibility::Jump | Plausibility::Lost);
        match found {
            Plausibility::Jump => return MeasurementUse::Implausible,
            Plausibility::Lost => {
                self.measurement_fault = Some(Reason::MeasurementJump);
                return MeasurementUse::Implausible;
            }
            Plausibility::Frozen { channel } => {
                self.measurement_fault = Some(Reason::MeasurementFrozen);
                self.frozen_channel = Some(channel);
            }
            Plausibility::Good => {}
        }
        if let Measurement::CableLengths(lengths_m) = &measurement
            && self.common_mode.is_broken(&self.robot, lengths_m)
        {
            self.measurement_fault = Some(Reason::CommonMode);
        }
        let age_s = age_s(measured_ns, release_ns);
        for rest in self.silence.rests(&timed, release_ns) {
            let mut rests_s = [const { 0.0..0.0 }; 1 + HIDDEN_MAX];
            let count = self.silence.fill_ages(&rest, release_ns, &mut rests_s);
            let (robot, rests_s) = (&self.robot, &rests_s[..count]);
            if (self.estimator).rested(robot, &measurement, age_s, rests_s, rest.cause) {
                self.silence.believe(&rest);
                break;
            }
        }
        self.estimator.correct(&self.robot, &measurement, age_s);
        self.measured = measurement.configuration(&self.robot);
        if is_first {
            // A tip offset measured earlier was relative to assumed bends.
            self.estimator.forget_tip_offset();
            // No command has been sent.
            self.is_driver_new = true;
            self.take_control();
        } else if self.is_driver_new && self.is_accepted() && !self.following.is_latched() {
            self.is_driver_new = false;
        }
        if let Some(measured) = &self.measured {
            self.following.measured(&self.robot, measured);
            if let Measurement::CableLengths(lengths_m) = &measurement {
                self.following.measured_lengths(&self.robot, lengths_m);
            }
            self.bend_limit.measured(measured, measured_ns);
        } else {
            self.following.unmeasured();
        }
        MeasurementUse::Used
    }

    /// Offset of the measured tip from the place given by the bends \[m\].
    pub(super) fn tip_offset_m(&self) -> Vector3<f64> {
        self.estimator.tip_offset_m()
    }

    /// Uncertainty of the tip's place beside that offset \[m\]; added to the body's radius.
    pub(super) fn tip_margin_m(&self) -> f64 {
        self.estimator.tip_margin_m()
    }

    pub(super) fn tip(&self) -> Pose {
        self.tip_at(&self.present)
    }

    /// The reference is farther from the tip than the approach distance.
    pub(super) fn is_too_far(&self, reference: &ReferenceSample) -> bool {
        let most_m = self.policy.approach_distance_m;
        most_m.is_finite() && (self.tip().position_m - reference.position_m).norm() > most_m
    }

    /// Pose of the tip to which the commands so far lead.
    pub(super) fn commanded_tip(&self) -> Pose {
        self.tip_at(self.configuration())
    }

    fn tip_at(&self, configuration: &Configuration) -> Pose {
        let pose = self.robot.tip_pose(configuration);
        Pose {
            position_m: pose.position_m + self.tip_offset_m(),
            ..pose
        }
    }

    /// The motors are where the commanded position leads, or on their way there. A new driver that measures the tip alone
    /// is believed to find them where the driver before it left them, if the tip is near.
    fn obeys_positions(&self) -> bool {
        let stays = || self.has_begun && self.measured.is_none() && self.is_commanded_here();
        self.policy.interface == Interface::Position && (!self.is_driver_new || stays())
    }

    fn measured_place(&self) -> Configuration {
        self.measured.unwrap_or(*self.estimator.motors())
    }

    /// Begins control at the robot's position: at the first measurement, and after a latched mode, in which
    /// the robot may have been moved by hand. A driver that obeys positions keeps its commanded position.
    pub(super) fn take_control(&mut self) {
        let here = self.measured_place();
        self.estimator.begin(here);
        self.begin_at(here);
        self.following.begin(self.commanded);
    }

    /// Begins control while the motors still move: at the end of their motion, computed from the measured
    /// positions.
    pub(super) fn take_control_moving(&mut self) {
        self.estimator.begin_moving();
        self.begin_at(*self.estimator.motors());
        self.following.begin_moving(self.commanded);
    }

    fn begin_at(&mut self, at: Configuration) {
        if !self.obeys_positions() {
            self.commanded = at;
        }
        self.begins_at = None;
        self.is_driver_new = false;
        self.has_begun = true;
        self.present = self.estimator.present();
        self.delayed = self.estimator.delayed();
        self.common_mode.begin();
        self.trust_tip();
    }

    /// A new driver accepts its first position beside the measured bends, and obeys from then on. (The driver's own limit,
    /// 0.05 rad along the bend and along each cable, is not reached.)
    fn is_accepted(&self) -> bool {
        const ACCEPTED_RAD: f64 = 0.035;
        let measured = self.measured.as_ref();
        measured.is_some_and(|at| !is_apart(&self.commanded, at, ACCEPTED_RAD))
    }

    /// Control may begin after a latched mode only when the commanded position has moved to the robot.
    pub(super) fn is_commanded_elsewhere(&self) -> bool {
        self.obeys_positions()
            && match &self.begins_at {
                Some(begins_at) => is_apart(&self.commanded, begins_at, HOME_EXACT_RAD),
                None => !self.is_commanded_here(),
            }
    }

    /// The commanded position is beside the robot: one measurement may be noise, and the average is late.
    fn is_commanded_here(&self) -> bool {
        if self.measured.is_none() {
            // Many bends have the same tip: motors are elsewhere only if their tip is.
            let tips_m =
                [&self.commanded, self.estimator.motors()].map(|at| self.robot.tip_position(at));
            return (tips_m[0] - tips_m[1]).norm() <= tip_offset_max_m(self.robot.reach_m());
        }
        [self.estimator.motors_measured(), self.estimator.motors()]
            .iter()
            .any(|at| !is_apart(&self.commanded, at, BESIDE_RAD))
    }

    /// The way ends, too, where the robot has come to its commanded position.
    pub(super) fn end_way_beside(&mut self) {
        if self.measured.is_some() && self.is_commanded_here() {
            self.begins_at = None;
        }
    }

    /// Sets where control begins to the present place of the robot, for the whole way there: a measurement
    /// that is wrong by a constant moves along with the robot.
    pub(super) fn set_out(&mut self) {
        let here = self.measured_place();
        self.begins_at.get_or_insert(here);
    }

    /// The way to that place ends where the commanded position is.
    pub(super) fn give_up_way(&mut self) {
        self.begins_at = None;
    }

    /// Commanded position, seen from where control begins, zero on arrival; `None` if it is not on its way there.
    pub(super) fn way_to_begin(&self) -> Option<Configuration> {
        let begins_at = self.begins_at?;
        if !self.is_commanded_elsewhere() {
            return Some(Configuration::straight(self.robot.section_count()));
        }
        let mut way = self.commanded;
        for (way, begin) in way.as_mut_slice().iter_mut().zip(begins_at.as_slice()) {
            *way -= begin;
        }
        Some(way)
    }

    /// Counts the time without a fresh measurement, as seen by gathers: after a stall of the machine, the
    /// driver's messages must be gathered first.
    pub(super) fn count_silence(
        &mut self,
        measurement: Option<TimedMeasurement>,
        inputs: &CycleInputs,
    ) {
        let drivers = core::mem::replace(&mut self.drivers, inputs.drivers);
        self.is_driver_new |= drivers != inputs.drivers;
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

    /// Updates the present configuration and the time for which the robot has been straight. A stall counts
    /// as two periods at most: a motion through the straight pose is not rest.
    pub(super) fn locate(&mut self, elapsed_ns: u64) {
        self.present = self.estimator.present();
        self.delayed = self.estimator.delayed();
        self.straight_ns = if self.is_within(self.policy.home_tolerance_rad) {
            let seen_ns = elapsed_ns.min(2 * self.period_ns);
            self.straight_ns.saturating_add(seen_ns)
        } else {
            0
        };
    }

    /// The robot is straight: exactly, or within the tolerance for long enough.
    pub(super) fn is_at_home(&self) -> bool {
        self.is_within(HOME_EXACT_RAD) || self.straight_ns >= HOME_SETTLED_NS
    }

    fn is_within(&self, tolerance_rad: f64) -> bool {
        let mut bends = self.present.as_slice().iter();
        bends.all(|bend| bend.abs() < tolerance_rad)
    }

    pub(super) fn is_measurement_rejected(&self) -> bool {
        self.is_measurement_rejected
    }

    pub(super) fn measurement_fault(&self) -> Option<Reason> {
        let is_lost = self.unmeasured_ns > self.policy.measurement_timeout_ns;
        let lost = is_lost.then_some(Reason::MeasurementLost);
        lost.or(self.measurement_fault)
    }

    /// Fault of the robot's configuration.
    pub(super) fn place_fault(&self) -> Option<Reason> {
        let estimate = self.configuration();
        if !estimate.is_finite() {
            return Some(Reason::NonFinite);
        }
        let is_beyond = match self.measured {
            Some(_) => self.bend_limit.is_broken(&self.robot),
            None => BendLimitWatch::is_beyond(&self.robot, estimate),
        };
        is_beyond.then_some(Reason::LimitBroken)
    }
}

/// A bend component differs by more than `within_rad`, or is not a number.
fn is_apart(one: &Configuration, other: &Configuration, within_rad: f64) -> bool {
    let mut pairs = one.as_slice().iter().zip(other.as_slice());
    !pairs.all(|(one, other)| (one - other).abs() <= within_rad)
}
