//! A simulation of what a daemon does: plan, safety check, move, once a period.
//!
//! Nothing is late, and modes and faults are left out. The robot is the ideal one, exactly where its commands bring it, or one that is
//! not its model ([`Driven`]), with a driver and an estimate.

#![allow(
    clippy::large_types_passed_by_value,
    reason = "a robot is given once for each simulation"
)]

mod driven;
mod figure_eight;

use nalgebra::Vector3;

use crate::nmpc::{Nmpc, NmpcSettings, SettingsError, SolveInput, SolveReport};
use crate::optimizer::{Budget, cycle_seed};
use crate::reference::ReferenceSample;
use crate::robot::{BendRates, Configuration, Obstacle, Robot, RobotError};
use crate::safety::{LimitsHit, SafeCommand, Situation, safe_command};
use driven::DrivenRobot;
pub use driven::{Driven, Part, Sensor};
pub use figure_eight::{FigureEight, FigureEightError, FigureEightRest, FigureEightRun};

/// The robot, the obstacles and the reference around it, and the safety checks of its commands.
///
/// One period is [`Self::step`]; who solves otherwise takes [`Self::input`] and hands the rates to [`Self::advance`].
#[derive(Debug, Clone)]
pub struct ClosedLoop<R> {
    robot: Robot,
    period_s: f64,
    settings: NmpcSettings,
    acceleration_rad_s2: f64,
    /// How long a command moves the robot (periods), and its deceleration after that (rad/s²). None: what the robot has by default.
    stopping: Option<(f64, f64)>,
    /// The body keeps so much more distance, whatever is measured of the tip (m).
    tip_offset_m: f64,
    /// None: the ideal one.
    driven: Option<Box<DrivenRobot>>,
    reference_at: R,
    /// Where they are at time 0.
    obstacles_at_start: Vec<Obstacle>,
    cycle: u64,
    configuration: Configuration,
    /// Where they are when the robot is at `configuration`: behind motors with a lag, after it.
    obstacles: Vec<Obstacle>,
    /// The reference at the steps of the horizon.
    reference: Vec<ReferenceSample>,
    command: SafeCommand,
}

/// What [`ClosedLoop::run`] found after each of its periods.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClosedLoopRun {
    /// Smallest clearance of the body (m); infinite without obstacles.
    pub clearance_min_m: f64,
    /// Largest distance of the tip from the reference (m).
    pub error_max_m: f64,
}

/// How long a driver follows a command without another one (periods), and how fast it comes to rest then, as `motion.deceleration_rad_s2` is by
/// default (rad/s²).
const DRIVEN: (f64, f64) = (3.0, 40.0);
/// The ideal robot gets every command, and stops at once.
const IDEAL: (f64, f64) = (1.0, f64::INFINITY);

impl<R: Fn(f64) -> ReferenceSample> ClosedLoop<R> {
    /// A robot at rest at time 0 in the shape `start`, with a period of `period_s` (s). `obstacles` are where they are then, and
    /// move on at their velocity. `reference_at` is asked for times (s) of releases.
    ///
    /// # Errors
    /// As [`Nmpc::new`]: when a setting, or the period, is out of its range; and when `start` has not the sections of the robot.
    pub fn new(
        robot: &Robot,
        period_s: f64,
        settings: NmpcSettings,
        start: Configuration,
        obstacles: &[Obstacle],
        reference_at: R,
    ) -> Result<Self, SettingsError> {
        settings.validate_with(period_s)?;
        let [sections, start_sections] =
            [robot.section_count(), start.section_count()].map(|count| count as f64);
        if start_sections != sections {
            return Err(SettingsError {
                key: "start_sections",
                value: start_sections,
                low: sections,
                high: sections,
            });
        }
        let mut begin = Self {
            robot: robot.clone(),
            period_s,
            settings,
            acceleration_rad_s2: f64::INFINITY,
            stopping: None,
            tip_offset_m: 0.0,
            driven: None,
            reference_at,
            obstacles: Vec::with_capacity(obstacles.len()),
            obstacles_at_start: obstacles.to_vec(),
            cycle: 0,
            configuration: start,
            reference: Vec::new(),
            command: SafeCommand {
                rates: BendRates::zero(robot.section_count()),
                limits_hit: LimitsHit::default(),
                clearance_hit: false,
                clearance_m: f64::INFINITY,
            },
        };
        begin.look_around();
        Ok(begin)
    }

    /// The same with a largest acceleration of each bend component (rad/s²), as a robot behind a driver has one.
    #[must_use]
    pub fn with_acceleration(self, acceleration_rad_s2: f64) -> Self {
        Self {
            acceleration_rad_s2,
            ..self
        }
    }

    /// The same with commands that keep clear, as those for a driver do, for `valid_periods` (1 or more) and the ramp that follows, on which the fastest
    /// component loses `deceleration_rad_s2` (rad/s²). Without it a robot that is its model gets every command, and stops at once: 1 and infinite.
    #[must_use]
    pub fn with_stopping(self, valid_periods: f64, deceleration_rad_s2: f64) -> Self {
        Self {
            stopping: Some((valid_periods, deceleration_rad_s2)),
            ..self
        }
    }

    /// The same with a body that is known to be `tip_offset_m` (m) beside its model at the tip, and keeps as much more distance: [`Robot::thicker`].
    /// Where the reference leads the model, `reference_at` says.
    #[must_use]
    pub fn with_tip_offset(self, tip_offset_m: f64) -> Self {
        Self {
            tip_offset_m,
            ..self
        }
    }

    /// The same with a robot that is not its model. Without [`Self::with_stopping`] its commands keep clear for 3 periods and a ramp of 40 rad/s², the
    /// defaults of a daemon with a driver.
    ///
    /// # Errors
    /// When the flaws of its geometry make it no robot.
    pub fn with_driven(self, driven: Driven) -> Result<Self, RobotError> {
        let driven = DrivenRobot::new(&self.robot, &self.configuration, &driven)?;
        let mut begin = self;
        begin.configuration = *driven.configuration();
        begin.driven = Some(Box::new(driven));
        begin.look_around();
        Ok(begin)
    }

    /// A solver for this robot, with its period and settings.
    ///
    /// # Errors
    /// As [`Nmpc::new`], which [`Self::new`] has asked already.
    pub fn solver(&self) -> Result<Nmpc, SettingsError> {
        Nmpc::new(self.robot.clone(), self.period_s, self.settings)
    }

    /// One period: solves without a limit on time, makes the result safe, and moves on.
    pub fn step(&mut self, nmpc: &mut Nmpc) -> SolveReport {
        nmpc.limit_acceleration(self.acceleration_rad_s2);
        let (desired_rates, report) = nmpc.solve(&self.input(), &mut Budget::unlimited());
        self.advance(&desired_rates);
        report
    }

    /// Periods until `until_s` (s), each as [`Self::step`], with a solver of its own.
    ///
    /// # Errors
    /// As [`Self::solver`].
    pub fn run(&mut self, until_s: f64) -> Result<ClosedLoopRun, SettingsError> {
        let mut nmpc = self.solver()?;
        let mut run = ClosedLoopRun {
            clearance_min_m: f64::INFINITY,
            error_max_m: 0.0,
        };
        while self.time_s() < until_s {
            self.step(&mut nmpc);
            run.clearance_min_m = run.clearance_min_m.min(self.clearance_m());
            run.error_max_m = run.error_max_m.max(self.error_m());
        }
        Ok(run)
    }

    /// What a solve of this period starts from.
    pub fn input(&self) -> SolveInput<'_> {
        SolveInput {
            configuration: &self.configuration,
            previous_rates: &self.command.rates,
            reference: &self.reference,
            obstacles: &self.obstacles,
            tip_offset_m: self.margin_m(),
            elapsed_periods: 1,
            seed: cycle_seed(self.settings.seed, self.cycle),
        }
    }

    /// Makes `desired_rates` safe as a daemon does (acceleration, limits, clearance guard on the way to rest of [`Self::with_stopping`]), moves the robot by what is left of them and
    /// the obstacles by their velocity, and goes on to the next period.
    pub fn advance(&mut self, desired_rates: &BendRates) {
        let otherwise = if self.driven.is_some() { DRIVEN } else { IDEAL };
        let (valid_periods, deceleration_rad_s2) = self.stopping.unwrap_or(otherwise);
        let situation = Situation {
            robot: &self.robot,
            at: &self.configuration,
            commanded: self.driven.as_ref().and_then(|driven| driven.commanded()),
            slack: self.driven.as_ref().and_then(|driven| driven.slack()),
            previous: &self.command.rates,
            obstacles: &self.obstacles,
            safe_distance_m: self.settings.safe_distance_m,
            tip_offset_m: self.margin_m(),
            acceleration_rad_s2: self.acceleration_rad_s2,
            period_s: self.period_s,
            moving_s: valid_periods * self.period_s,
            deceleration_rad_s2,
            comes_to_rest: false,
        };
        self.command = safe_command(&situation, desired_rates);
        self.configuration = match &mut self.driven {
            None => self
                .configuration
                .advanced(&self.command.rates, self.period_s),
            Some(driven) => {
                driven.advance(&self.command.rates, self.period_s);
                *driven.configuration()
            }
        };
        self.cycle += 1;
        self.look_around();
    }

    /// Time since the start (s).
    pub fn time_s(&self) -> f64 {
        self.cycle as f64 * self.period_s
    }

    /// Periods that have passed.
    pub fn cycle(&self) -> u64 {
        self.cycle
    }

    /// The robot.
    pub fn robot(&self) -> &Robot {
        &self.robot
    }

    /// How the ideal robot is bent now; of one that is not its model, where its commands lead it, as far as is known.
    pub fn configuration(&self) -> &Configuration {
        &self.configuration
    }

    /// The last command, and what limits and guard changed of it.
    pub fn command(&self) -> &SafeCommand {
        &self.command
    }

    /// From where the reference is now to where the tip is (m).
    pub fn error_m(&self) -> f64 {
        let goal_m = (self.reference_at)(self.time_s()).position_m;
        (self.tip_m() - goal_m).norm()
    }

    /// Largest difference of a motor from where it is commanded (m); of the ideal robot 0.
    pub fn following_error_m(&self) -> f64 {
        self.driven
            .as_ref()
            .map_or(0.0, |driven| driven.following_error_m())
    }

    /// Where the tip is in truth (m).
    pub fn tip_m(&self) -> Vector3<f64> {
        match &self.driven {
            None => self.robot.tip_position(&self.configuration),
            Some(driven) => driven.plant().tip_m(),
        }
    }

    /// Clearance of the whole body in truth now (m); infinite without obstacles.
    pub fn clearance_m(&self) -> f64 {
        let from_the_start = self.obstacles_at_start.iter();
        let now = from_the_start.map(|obstacle| obstacle.moved(self.time_s()));
        match &self.driven {
            None => (self.robot.body(&self.configuration)).least_clearance_m(now),
            Some(driven) => driven.plant().clearance_m(now),
        }
    }

    /// How far the tip is measured beside where the bends place it (m).
    fn tip_offset_m(&self) -> Vector3<f64> {
        let driven = self.driven.as_ref();
        driven.map_or_else(Vector3::zeros, |driven| driven.tip_offset_m())
    }

    /// How much more distance the body keeps (m).
    fn margin_m(&self) -> f64 {
        let driven = self.driven.as_ref();
        driven
            .map_or(0.0, |driven| driven.margin_m())
            .max(self.tip_offset_m)
    }

    /// Obstacles, and the reference over the horizon, in the time of the robot that lags.
    fn look_around(&mut self) {
        let time_s = self.time_s();
        self.obstacles.clear();
        let from_the_start = self.obstacles_at_start.iter();
        let lead_s = self.driven.as_ref().map_or(0.0, |driven| driven.lead_s());
        self.obstacles
            .extend(from_the_start.map(|obstacle| obstacle.moved(time_s + lead_s)));
        let first = self.cycle + 1;
        let cycles = first..first + u64::from(self.settings.horizon_steps);
        let times_s = cycles.map(|cycle| cycle as f64 * self.period_s + lead_s);
        let offset_m = self.tip_offset_m();
        let reference_at = |time_s| (self.reference_at)(time_s).moved(&-offset_m);
        self.reference.clear();
        self.reference.extend(times_s.map(reference_at));
    }
}
