use nalgebra::{Matrix3, Vector3};

use crate::estimator::{Actuator, Estimator, Measurement, Slack};
use crate::plant::{Flaws, MisbehavingRobot, MotorOrder};
use crate::robot::{BendRates, CABLES_MAX, Configuration, Jacobian, Robot, RobotError};

/// A robot that is not its model, and what the controller knows of that.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Driven {
    /// What is wrong with it.
    pub flaws: Flaws,
    /// What the controller takes its motors for.
    pub actuator: Actuator,
    /// Time constant with which the estimate follows what is measured (s), 0 or more.
    pub time_constant_s: f64,
    /// Whether its motors obey positions; else speeds.
    pub obeys_positions: bool,
    /// What is measured.
    pub sensor: Sensor,
    /// What the controller does without, to see what that is for.
    pub without: Option<Part>,
    /// Of the noise.
    pub seed: u64,
}

/// A part of the controller that uses the tip.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// The filter of the tip: without it the bends are those nearest to the estimate that bring the tip exactly where it is measured.
    Filter,
    /// How the offset of the tip changes along its way.
    Slope,
    /// The distance that the body keeps in addition where its tip is measured beside its bends.
    Margin,
}

/// What a robot measures, at releases.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sensor {
    /// Every cable, at each release.
    Cables,
    /// The position of the tip, at every `every`-th release, 1 or more.
    Tip {
        /// Periods between two measurements.
        every: u32,
    },
    /// Every cable at each release, and the position of the tip at every `every`-th.
    CablesAndTip {
        /// Periods between two measurements of the tip.
        every: u32,
    },
    /// Nothing: open loop.
    Nothing,
}

/// The robot, its driver, and the estimate of where it is.
#[derive(Debug, Clone)]
pub(super) struct DrivenRobot {
    driven: Driven,
    model: Robot,
    plant: MisbehavingRobot,
    estimator: Estimator,
    /// Where it is commanded to be.
    commanded: Configuration,
    releases: u32,
}

/// Steps of the motors in a period, for each of which a driver has an order.
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
            Some(Part::Slope) => estimator.without_tip_slope(),
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
        // Control begins where the robot is measured.
        robot.commanded = *robot.estimator.motors();
        Ok(robot)
    }

    /// Where the commands up to now lead it, as far as that is known.
    pub(super) fn configuration(&self) -> &Configuration {
        self.estimator.configuration()
    }

    /// Where its motors are led, where the robot is beside that: commanded positions, or motors beside cables that have play.
    pub(super) fn commanded(&self) -> Option<&Configuration> {
        if self.driven.obeys_positions {
            return Some(&self.commanded);
        }
        let motors = self.estimator.motors();
        Some(motors).filter(|motors| *motors != self.configuration())
    }

    /// What of the play of its cables is taken there, as far as that is known.
    pub(super) fn slack(&self) -> Option<&Slack> {
        self.estimator.slack_led()
    }

    /// Of the motor that is farthest from where it is commanded (m).
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

    /// How much more distance its body keeps (m).
    pub(super) fn margin_m(&self) -> f64 {
        match self.driven.without {
            Some(Part::Margin) => 0.0,
            _ => self.estimator.tip_margin_m(),
        }
    }

    pub(super) fn plant(&self) -> &MisbehavingRobot {
        &self.plant
    }

    pub(super) fn lead_s(&self) -> f64 {
        self.driven.actuator.lead_s()
    }

    /// The motors obey `rates` for a period, then it is measured.
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
            if self.driven.without == Some(Part::Filter) {
                let bends = nearest_with_tip(&self.model, self.estimator.present(), &tip_m);
                let bends = Measurement::Configuration(bends);
                self.estimator.correct(&self.model, &bends, 0.0);
            } else if has_cables {
                self.estimator.correct_tip(&self.model, &tip_m, 0.0);
            } else {
                let tip = Measurement::TipPosition(tip_m);
                self.estimator.correct(&self.model, &tip, 0.0);
            }
        }
        self.releases += 1;
    }
}

/// Steps to a tip: each gains about three digits.
const TIP_STEPS: usize = 4;
/// Their damping (m²): against rounding.
const TIP_DAMPING_M2: f64 = 1e-9;

/// The configuration nearest to `start` whose tip is at `position_m`, by least squares that have no noise model.
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
