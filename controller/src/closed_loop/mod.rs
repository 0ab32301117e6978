//! Simulation of the control cycle of a daemon: solve, safety checks, motion, once a period.
//!
//! Nothing is late, and modes and faults are omitted. The robot is ideal and follows its commands exactly, or it
//! differs from its model ([`Driven`]) and has a driver and an estimate.

#![allow(
    clippy::large_types_passed_by_value,
    reason = "a robot is given once for each simulation"
)]

mod driven;
mod figure_eight;
mod scene;

use nalgebra::Vector3;

use crate::nmpc::{Nmpc, NmpcSettings, SettingsError, SolveInput, SolveReport};
use crate::optimizer::{Budget, cycle_seed};
use crate::reference::ReferenceSample;
use crate::robot::{BendRates, Configuration, Obstacle, Robot, RobotError};
use crate::safety::{Lag, LimitsHit, SafeCommand, Situation, safe_command};
use driven::DrivenRobot;
pub use driven::{Driven, Sensor, TipPart};
pub use figure_eight::{FigureEight, FigureEightError, FigureEightRest, FigureEightRun};
pub use scene::{Scene, SceneError, SceneLoop};

/// The robot, its obstacles and reference, and the safety checks of its commands.
///
/// One period is [`Self::step`]. A caller with another solver takes [`Self::input`] and passes the rates to
/// [`Self::advance`].
#[derive(Debug, Clone)]
pub struct ClosedLoop<R> {
    robot: Robot,
    period_s: f64,
    settings: NmpcSettings,
    acceleration_rad_s2: f64,
    /// Time for which a command moves the robot (periods), and the deceleration after it (rad/s²). `None`: the default
    /// of the robot.
    stopping: Option<(f64, f64)>,
    /// Additional safe distance for a known tip offset (m), whatever is measured.
    tip_offset_m: f64,
    /// `None`: the ideal robot.
    driven: Option<Box<DrivenRobot>>,
    reference_at: R,
    /// Obstacles at time 0.
    obstacles_at_start: Vec<Obstacle>,
    cycle: u64,
    configuration: Configuration,
    /// Obstacles at the time when the robot reaches `configuration`: for motors with a lag, later than now.
    obstacles: Vec<Obstacle>,
    /// The reference at the steps of the horizon.
    reference: Vec<ReferenceSample>,
    command: SafeCommand,
}

/// Result of [`ClosedLoop::run`], from the ends of its periods.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClosedLoopRun {
    /// Smallest clearance of the body (m); infinite without obstacles.
    pub clearance_min_m: f64,
    /// Largest distance of the tip from the reference (m).
    pub error_max_m: f64,
}

/// Time for which a driver follows a command without a newer one (periods), and its deceleration after that, the
/// default of `motion.deceleration_rad_s2` (rad/s²).
const DRIVER_STOPPING: (f64, f64) = (3.0, 40.0);
/// The ideal robot receives every command and stops at once.
const IDEAL_STOPPING: (f64, f64) = (1.0, f64::INFINITY);

impl<R: Fn(f64) -> ReferenceSample> ClosedLoop<R> {
    /// A robot at rest at time 0 in the shape `start`, with a period of `period_s` (s). `obstacles` are those at time
    /// 0; they move at their velocity. `reference_at` returns the reference at the time (s) of a release.
    ///
    /// # Errors
    /// As [`Nmpc::new`] if a setting or the period is out of range, and if `start` does not have the section count of
    /// the robot.
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
        begin.update_surroundings();
        Ok(begin)
    }

    /// Sets the largest acceleration of each bend component (rad/s²), as for a robot behind a driver.
    #[must_use]
    pub fn with_acceleration(self, acceleration_rad_s2: f64) -> Self {
        Self {
            acceleration_rad_s2,
            ..self
        }
    }

    /// Makes commands safe, as for a driver, during `valid_periods` (1 or more) and the ramp to rest that follows. On
    /// the ramp the fastest component decelerates by `deceleration_rad_s2` (rad/s²). Default of the ideal robot, which
    /// receives every command and stops at once: 1 and infinity.
    #[must_use]
    pub fn with_stopping(self, valid_periods: f64, deceleration_rad_s2: f64) -> Self {
        Self {
            stopping: Some((valid_periods, deceleration_rad_s2)),
            ..self
        }
    }

    /// Keeps an additional safe distance for a body whose tip is `tip_offset_m` (m) beside its model:
    /// [`Robot::enlarged`]. The reference is not shifted; `reference_at` must include the offset.
    #[must_use]
    pub fn with_tip_offset(self, tip_offset_m: f64) -> Self {
        Self {
            tip_offset_m,
            ..self
        }
    }

    /// Replaces the robot by one that differs from its model. Without [`Self::with_stopping`], its commands are safe
    /// for 3 periods and a ramp of 40 rad/s², the defaults of a daemon with a driver.
    ///
    /// # Errors
    /// If the flaws make no valid robot.
    pub fn with_driven(self, driven: Driven) -> Result<Self, RobotError> {
        let driven = DrivenRobot::new(&self.robot, &self.configuration, &driven)?;
        let mut begin = self;
        begin.configuration = *driven.configuration();
        begin.driven = Some(Box::new(driven));
        begin.update_surroundings();
        Ok(begin)
    }

    /// A solver for this robot, with its period and settings.
    ///
    /// # Errors
    /// As [`Nmpc::new`]; [`Self::new`] has already checked the arguments.
    pub fn solver(&self) -> Result<Nmpc, SettingsError> {
        Nmpc::new(self.robot.clone(), self.period_s, self.settings)
    }

    /// One period: solves without a time limit, makes the result safe, and moves the robot.
    pub fn step(&mut self, nmpc: &mut Nmpc) -> SolveReport {
        nmpc.limit_acceleration(self.acceleration_rad_s2);
        let (desired_rates, report) = nmpc.solve(&self.input(), &mut Budget::unlimited());
        self.advance(&desired_rates);
        report
    }

    /// Runs periods as [`Self::step`] until `until_s` (s), with a new solver.
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

    /// Input of a solve in this period.
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

    /// Makes `desired_rates` safe as a daemon does: acceleration, limits, clearance guard over the ramp of
    /// [`Self::with_stopping`]. Then moves the robot at the safe rates and the obstacles at their velocity, and
    /// advances to the next period.
    pub fn advance(&mut self, desired_rates: &BendRates) {
        let default = if self.driven.is_some() {
            DRIVER_STOPPING
        } else {
            IDEAL_STOPPING
        };
        let (valid_periods, deceleration_rad_s2) = self.stopping.unwrap_or(default);
        let lag = self.driven.as_ref().map(|driven| driven.lag());
        let lag = lag.as_ref().map(|(delayed, time_constant_s)| Lag {
            delayed,
            time_constant_s: *time_constant_s,
        });
        let situation = Situation {
            robot: &self.robot,
            at: &self.configuration,
            lag,
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
        self.follow_command();
    }

    /// Moves the robot at `rates` for a period, without any check: what a plan alone does.
    pub fn advance_unchecked(&mut self, rates: &BendRates) {
        self.command.rates = *rates;
        self.follow_command();
    }

    fn follow_command(&mut self) {
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
        self.update_surroundings();
    }

    /// Time since the start (s).
    pub fn time_s(&self) -> f64 {
        self.cycle as f64 * self.period_s
    }

    /// Number of completed periods.
    pub fn cycle(&self) -> u64 {
        self.cycle
    }

    /// The robot of the solver's model; that of [`Self::with_driven`] may deviate from it.
    pub fn robot(&self) -> &Robot {
        &self.robot
    }

    /// Largest acceleration of each bend component (rad/s²).
    pub fn acceleration_rad_s2(&self) -> f64 {
        self.acceleration_rad_s2
    }

    /// Present shape of the ideal robot. For a robot that differs from its model: the estimate of the shape to which
    /// its commands lead.
    pub fn configuration(&self) -> &Configuration {
        &self.configuration
    }

    /// The last command, and its changes by limits and clearance guard.
    pub fn command(&self) -> &SafeCommand {
        &self.command
    }

    /// Distance of the tip from the present reference (m).
    pub fn error_m(&self) -> f64 {
        let goal_m = (self.reference_at)(self.time_s()).position_m;
        (self.tip_m() - goal_m).norm()
    }

    /// Largest difference between a motor and its commanded position (m); 0 for the ideal robot.
    pub fn following_error_m(&self) -> f64 {
        self.driven
            .as_ref()
            .map_or(0.0, |driven| driven.following_error_m())
    }

    /// True position of the tip (m).
    pub fn tip_m(&self) -> Vector3<f64> {
        match &self.driven {
            None => self.robot.tip_position(&self.configuration),
            Some(driven) => driven.plant().tip_m(),
        }
    }

    /// True clearance of the whole body now (m); infinite without obstacles.
    pub fn clearance_m(&self) -> f64 {
        let from_the_start = self.obstacles_at_start.iter();
        let now = from_the_start.map(|obstacle| obstacle.moved(self.time_s()));
        match &self.driven {
            None => (self.robot.body(&self.configuration)).least_clearance_m(now),
            Some(driven) => driven.plant().clearance_m(now),
        }
    }

    /// Measured tip position minus the one from the bends (m).
    fn tip_offset_m(&self) -> Vector3<f64> {
        let driven = self.driven.as_ref();
        driven.map_or_else(Vector3::zeros, |driven| driven.tip_offset_m())
    }

    /// Additional safe distance (m).
    fn margin_m(&self) -> f64 {
        let driven = self.driven.as_ref();
        driven
            .map_or(0.0, |driven| driven.margin_m())
            .max(self.tip_offset_m)
    }

    /// Updates the obstacles and the reference over the horizon, ahead by the lag of the robot.
    fn update_surroundings(&mut self) {
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
