use nalgebra::Vector3;

use crate::estimator::{Actuator, Estimator, Measurement, Slack};
use crate::plant::{Flaws, MisbehavingRobot, MotorOrder};
use crate::robot::{BendRates, CABLES_MAX, Configuration, Robot, RobotError};

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
    /// Of the noise.
    pub seed: u64,
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
            if has_cables {
                self.estimator.correct_tip(&self.model, &tip_m, 0.0);
            } else {
                let tip = Measurement::TipPosition(tip_m);
                self.estimator.correct(&self.model, &tip, 0.0);
            }
        }
        self.releases += 1;
    }
}
