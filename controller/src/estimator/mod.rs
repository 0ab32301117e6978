//! The configuration at the release, from what was measured before it.
//!
//! Invariant: nothing here commands or decides. A measurement and its age come in, a configuration
//! goes out.

use nalgebra::{Matrix3, Vector3};

use crate::robot::{BendRates, CABLES_MAX, Configuration, Jacobian, Robot};

/// What a driver measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Measurement {
    /// The bend vector of every section.
    Configuration(Configuration),
    /// The length of every cable \[m\], section by section.
    CableLengths([f64; CABLES_MAX]),
    /// Position of the tip in the base frame \[m\]. It does not determine the configuration of two or
    /// more sections; the estimate is then the nearest one to the prediction.
    TipPosition(Vector3<f64>),
}

/// Keeps the estimate of the configuration.
#[derive(Debug, Clone)]
pub struct Estimator {
    estimate: Configuration,
}

/// Steps of the correction from a tip position: each gains about three digits.
const TIP_STEPS: usize = 4;
/// Damping of that correction \[m²\].
const TIP_DAMPING_M2: f64 = 1e-9;

impl Estimator {
    /// Begins with a configuration that is known or assumed.
    pub fn new(configuration: Configuration) -> Self {
        Self {
            estimate: configuration,
        }
    }

    /// The last estimate.
    pub fn configuration(&self) -> &Configuration {
        &self.estimate
    }

    /// No measurement: the last estimate moved on with the rates commanded since.
    pub fn predict(&mut self, rates: &BendRates, elapsed_s: f64) -> &Configuration {
        self.estimate = self.estimate.advanced(rates, elapsed_s);
        &self.estimate
    }

    /// Takes a measurement that is `age_s` old at the release, during which `rates` were commanded.
    /// A tip position corrects the prediction, so [`Estimator::predict`] comes first.
    pub fn correct(
        &mut self,
        robot: &Robot,
        measurement: &Measurement,
        rates: &BendRates,
        age_s: f64,
    ) -> &Configuration {
        self.estimate = match measurement {
            Measurement::Configuration(measured) => measured.advanced(rates, age_s),
            Measurement::CableLengths(lengths) => robot
                .bend_from_cable_lengths(lengths)
                .advanced(rates, age_s),
            Measurement::TipPosition(position_m) => {
                let then = self.estimate.advanced(rates, -age_s);
                nearest_with_tip(robot, then, *position_m).advanced(rates, age_s)
            }
        };
        &self.estimate
    }
}

/// The configuration nearest to `start` whose tip is at `position_m`, by damped least squares.
fn nearest_with_tip(
    robot: &Robot,
    start: Configuration,
    position_m: Vector3<f64>,
) -> Configuration {
    let mut estimate = start;
    let mut jacobian = Jacobian::default();
    for _ in 0..TIP_STEPS {
        let tip = robot.tip_jacobian(estimate.as_slice(), &mut jacobian);
        let missing = position_m - tip.position_m;
        let mut gram = Matrix3::identity() * TIP_DAMPING_M2;
        for i in 0..robot.coordinate_count() {
            let column = Vector3::from_column_slice(&jacobian.column(i)[..3]);
            gram += column * column.transpose();
        }
        let Some(cholesky) = gram.cholesky() else {
            return estimate;
        };
        let weights = cholesky.solve(&missing);
        for (i, bend) in estimate.as_mut_slice().iter_mut().enumerate() {
            *bend += Vector3::from_column_slice(&jacobian.column(i)[..3]).dot(&weights);
        }
    }
    estimate
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::RobotParameters;

    fn robot(sections: usize) -> Robot {
        Robot::new(&RobotParameters::paper(sections)).expect("the paper's robot")
    }

    #[test]
    fn age_is_made_up_with_the_commanded_rates() {
        let robot = robot(1);
        let rates = BendRates::from_slice(&[1.0, -2.0]).expect("one section");
        let measured = Configuration::from_slice(&[0.1, 0.2]).expect("one section");
        let mut estimator = Estimator::new(Configuration::straight(1));
        let estimate =
            estimator.correct(&robot, &Measurement::Configuration(measured), &rates, 0.01);
        assert!((estimate.as_slice()[0] - 0.11).abs() < 1e-15);
        let lengths = robot.cable_lengths(measured.as_slice());
        let estimate = estimator.correct(&robot, &Measurement::CableLengths(lengths), &rates, 0.0);
        assert!((estimate.as_slice()[1] - 0.2).abs() < 1e-13);
    }

    #[test]
    fn a_tip_position_determines_one_section_and_corrects_several() {
        for sections in 1..=3 {
            let robot = robot(sections);
            let values: Vec<f64> = (0..2 * sections).map(|i| 0.4 - 0.1 * i as f64).collect();
            let truth = Configuration::from_slice(&values).expect("even");
            let off: Vec<f64> = values.iter().map(|value| value + 0.02).collect();
            let mut estimator = Estimator::new(Configuration::from_slice(&off).expect("even"));
            let tip = robot.tip_position(truth.as_slice());
            let still = BendRates::zero(sections);
            let estimate = *estimator.correct(&robot, &Measurement::TipPosition(tip), &still, 0.0);
            assert!((robot.tip_position(estimate.as_slice()) - tip).norm() < 1e-9);
        }
    }
}
