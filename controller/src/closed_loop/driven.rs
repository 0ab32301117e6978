use nalgebra::{Matrix3, Vector3};

use crate::estimator::{Actuator, Estimator, Measurement, Slack};
use crate::plant::{Flaws, MisbehavingRobot, MotorOrder};
use crate::robot::{BendRates, CABLES_MAX, Configuration, Jacobian, Robot, RobotError};

/// A robot that differs from its model, and the controller's knowledge of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Driven {
    /// Flaws of the robot.
    pub flaws: Flaws,
    /// Dynamics of the motors that the controller assumes.
    pub actuator: Actuator,
    /// Time constant with which the estimate follows the measurements (s), 0 or more.
    pub time_constant_s: f64,
    /// True if the motors are position-controlled, false if speed-controlled.
    pub obeys_positions: bool,
    /// Sensors of the robot.
    pub sensor: Sensor,
    /// Part of the controller to omit, to show its effect.
    pub without: Option<TipPart>,
    /// Seed of the noise.
    pub seed: u64,
}

/// A part of the controller that uses the tip.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TipPart {
    /// The Kalman filter of the tip. Without it, the bends are those nearest to the estimate that place the tip exactly
    /// where it is measured.
    Filter,
    /// The slope of the tip offset along the path of the tip.
    Slope,
    /// The additional safe distance for the tip offset.
    Margin,
}

/// Measurements at releases.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sensor {
    /// Every cable, at each release.
    Cables,
    /// The tip position, at every `every`-th release, 1 or more.
    Tip {
        /// Periods between two measurements.
        every: u32,
    },
    /// Every cable at each release, and the tip position at every `every`-th.
    CablesAndTip {
        /// Periods between two measurements of the tip.
        every: u32,
    },
    /// None: open loop.
    Nothing,
}

/// The robot, its driver, and the estimate of its configuration.
#[derive(Debug, Clone)]
pub(super) struct DrivenRobot {
    driven: Driven,
    model: Robot,
    plant: MisbehavingRobot,
    estimator: Estimator,
    /// Commanded configuration.
    commanded: Configuration,
    releases: u32,
}

/// Steps of the motors in a period. A driver orders one motion for each.
const STEPS: u32 = 5;

impl DrivenRobot {
    pub(super) fn new(
        model: &Robot,
        start: &Configuration,
        driven: &Driven,
    ) -> Result<Self, RobotError> {
        let plant = MisbehavingRobot::new(model, start, driven.flaws, driven.seed)?;
        let estimator = Estimator::new(*start)
            .with_actuator(model, driven.actuator)
            .with_time_constant(driven.time_constant_s);
        let estimator = match driven.without {
            Some(TipPart::Slope) => estimator.without_tip_slope(),
            _ => estimator,
        };
        let mut robot = Self {
            driven: *driven,
            model: model.clone(),
            plant,
            estimator,
            commanded: *start,
            releases: 0,
        };
        robot.measure();
        // Control begins at the measured configuration.
        robot.commanded = *robot.estimator.motors();
        Ok(robot)
    }

    /// Estimated configuration to which the commands so far lead the robot.
    pub(super) fn configuration(&self) -> &Configuration {
        self.estimator.configuration()
    }

    /// Estimated configuration at the end of the motors' delay, and their time constant \[s\].
    pub(super) fn lag(&self) -> (Configuration, f64) {
        let time_constant_s = self.driven.actuator.time_constant_s;
        (self.estimator.delayed(), time_constant_s)
    }

    /// Configuration to which the motors are led, if it differs from that of the robot: commanded positions, or motors
    /// of cables with play.
    pub(super) fn commanded(&self) -> Option<&Configuration> {
        if self.driven.obeys_positions {
            return Some(&self.commanded);
        }
        let motors = self.estimator.motors();
        Some(motors).filter(|motors| *motors != self.configuration())
    }

    /// Estimated state of the cables' play at the configuration to which the commands lead.
    pub(super) fn slack(&self) -> Option<&Slack> {
        self.estimator.commanded_slack()
    }

    /// Largest difference between a motor and its commanded position (m).
    pub(super) fn following_error_m(&self) -> f64 {
        let commanded_m = self.model.cable_strokes(&self.commanded);
        let pairs = commanded_m.iter().zip(self.plant.motor_strokes_m());
        pairs
            .map(|(commanded_m, motor_m)| (commanded_m - motor_m).abs())
            .fold(0.0, f64::max)
    }

    pub(super) fn tip_offset_m(&self) -> Vector3<f64> {
        self.estimator.tip_offset_m()
    }

    /// Additional safe distance of the body (m).
    pub(super) fn margin_m(&self) -> f64 {
        match self.driven.without {
            Some(TipPart::Margin) => 0.0,
            _ => self.estimator.tip_margin_m(),
        }
    }

    pub(super) fn plant(&self) -> &MisbehavingRobot {
        &self.plant
    }

    pub(super) fn lead_s(&self) -> f64 {
        self.driven.actuator.lead_s()
    }

    /// Runs the motors at `rates` for a period, then takes the measurements.
    pub(super) fn advance(&mut self, rates: &BendRates, period_s: f64) {
        let step_s = period_s / f64::from(STEPS);
        let speeds_m_s = self.model.cable_speeds(rates);
        let before_m = self.model.cable_lengths(&self.commanded);
        for step in 1..=STEPS {
            let moved_s = f64::from(step) * step_s;
            self.plant.order(if self.driven.obeys_positions {
                let length_m = |cable: usize| before_m[cable] + speeds_m_s[cable] * moved_s;
                MotorOrder::Lengths(core::array::from_fn::<f64, CABLES_MAX, _>(length_m))
            } else {
                MotorOrder::Speeds(speeds_m_s)
            });
            self.plant.advance(step_s);
        }
        self.commanded = self.commanded.advanced(rates, period_s);
        self.estimator.predict(rates, period_s);
        self.measure();
    }

    fn measure(&mut self) {
        let (has_cables, tip_every) = match self.driven.sensor {
            Sensor::Cables => (true, None),
            Sensor::Tip { every } => (false, Some(every)),
            Sensor::CablesAndTip { every } => (true, Some(every)),
            Sensor::Nothing => (false, None),
        };
        let cables = has_cables.then(|| self.plant.measure_cables()).flatten();
        if let Some(lengths_m) = cables {
            let cables = Measurement::CableLengths(lengths_m);
            self.estimator.correct(&self.model, &cables, 0.0);
        }
        if tip_every.is_some_and(|every| self.releases.is_multiple_of(every.max(1)))
            && let Some(tip_m) = self.plant.measure_tip()
        {
            if self.driven.without == Some(TipPart::Filter) {
                let bends = nearest_with_tip(&self.model, self.estimator.present(), &tip_m);
                let bends = Measurement::Configuration(bends);
                self.estimator.correct(&self.model, &bends, 0.0);
            } else if has_cables {
                let _ = self.estimator.correct_tip(&self.model, &tip_m, 0.0);
            } else {
                let tip = Measurement::TipPosition(tip_m);
                self.estimator.correct(&self.model, &tip, 0.0);
            }
        }
        self.releases += 1;
    }
}

/// Number of steps to a tip position: each gains about three digits.
const TIP_STEPS: usize = 4;
/// Damping of the steps (m²), against rounding.
const TIP_DAMPING_M2: f64 = 1e-9;

/// The configuration nearest to `start` whose tip is at `position_m`, by least squares without a noise model.
fn nearest_with_tip(
    robot: &Robot,
    start: Configuration,
    position_m: &Vector3<f64>,
) -> Configuration {
    let mut nearest = start;
    let mut jacobian = Jacobian::default();
    for _ in 0..TIP_STEPS {
        let missing_m = position_m - robot.tip_jacobian(&nearest, &mut jacobian).position_m;
        let column = |i| Vector3::from_column_slice(&jacobian.column(i)[..3]);
        let mut gram = Matrix3::identity() * TIP_DAMPING_M2;
        for i in 0..robot.coordinate_count() {
            gram += column(i) * column(i).transpose();
        }
        let Some(cholesky) = gram.cholesky() else {
            break;
        };
        let weights = cholesky.solve(&missing_m);
        for (i, bend) in nearest.as_mut_slice().iter_mut().enumerate() {
            *bend += column(i).dot(&weights);
        }
    }
    nearest
}
