//! The ideal robot: it follows every command exactly, within its bend limits.

use crate::robot::{BendRates, Configuration, Robot, SECTIONS_MAX};

/// A robot without mass, slack, noise or delay: it integrates the last commanded rates.
///
/// Like a real driver, it does not continue without commands: it holds the last rates for at most `extrapolate_max_s`
/// after a command, then its shape until the next command.
#[derive(Debug, Clone, PartialEq)]
pub struct KinematicPlant {
    configuration: Configuration,
    rates: BendRates,
    /// Remaining time for which the rates are held (s).
    remaining_s: f64,
    extrapolate_max_s: f64,
    bend_max_rad: [f64; SECTIONS_MAX],
}

impl KinematicPlant {
    /// Default of `extrapolate_max_s` (s): ten periods of 5 ms. A few lost commands have no effect; the loss of the
    /// controller stops the robot.
    pub const EXTRAPOLATE_MAX_S: f64 = 0.05;

    /// A robot at rest in this shape, which has the robot's section count. Bends are limited as in [`Self::advance`].
    pub fn new(robot: &Robot, configuration: Configuration) -> Self {
        debug_assert_eq!(configuration.section_count(), robot.section_count());
        let mut bend_max_rad = [0.0; SECTIONS_MAX];
        for (limit_rad, section) in bend_max_rad.iter_mut().zip(robot.sections()) {
            *limit_rad = section.bend_max_rad;
        }
        let mut plant = Self {
            configuration,
            rates: BendRates::zero(robot.section_count()),
            remaining_s: 0.0,
            extrapolate_max_s: Self::EXTRAPOLATE_MAX_S,
            bend_max_rad,
        };
        plant.limit_bends();
        plant
    }

    /// Sets `extrapolate_max_s` (s) for future commands: 0 or more, infinite for no limit. A NaN or a negative number
    /// is taken as 0.
    #[must_use]
    pub fn with_extrapolate_max_s(mut self, extrapolate_max_s: f64) -> Self {
        self.extrapolate_max_s = extrapolate_max_s.max(0.0);
        self
    }

    /// Replaces the rates (rad/s). Like a driver, it rejects numbers that are not finite: rates with a NaN or an
    /// infinity stop it.
    pub fn command(&mut self, rates: &BendRates) {
        self.rates = if rates.is_finite() {
            *rates
        } else {
            BendRates::zero(self.configuration.section_count())
        };
        self.remaining_s = self.extrapolate_max_s;
    }

    /// Advances the simulation by `dt_s` (s), if positive. Exact for any step in which no limit is reached, because the
    /// bend vector is linear in time at constant rates.
    ///
    /// The bend of each section is limited to its `bend_max_rad`; the direction φ is kept.
    pub fn advance(&mut self, dt_s: f64) {
        if dt_s > 0.0 {
            let moving_s = dt_s.min(self.remaining_s);
            self.configuration = self.configuration.advanced(&self.rates, moving_s);
            self.remaining_s -= moving_s;
            self.limit_bends();
        }
    }

    /// The present shape.
    pub fn configuration(&self) -> &Configuration {
        &self.configuration
    }

    /// Limits each bend vector to the largest bend of its section.
    fn limit_bends(&mut self) {
        let (bends, _) = self.configuration.as_mut_slice().as_chunks_mut::<2>();
        for (bend, limit_rad) in bends.iter_mut().zip(&self.bend_max_rad) {
            let bend_rad = bend[0].hypot(bend[1]);
            if bend_rad > *limit_rad {
                *bend = bend.map(|component| component * (limit_rad / bend_rad));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::RobotParameters;

    fn robot(n: usize) -> Robot {
        Robot::new(&RobotParameters::paper(n)).unwrap()
    }

    /// The shape of the paper's spiral (Eq. 8) at `t`: the last section bends by 2t/15 towards t, the others are
    /// straight.
    fn spiral(n: usize, t: f64) -> Configuration {
        let mut angles = vec![[0.0, 0.0]; n];
        angles[n - 1] = [2.0 * t / 15.0, t];
        Configuration::from_bend_angles(&angles)
    }

    #[test]
    fn exact_rates_of_the_spiral_reproduce_its_curve() {
        const PERIOD_S: f64 = 0.005;
        let start = 5.0_f64.to_radians();
        for n in 1..=3 {
            let robot = robot(n);
            let mut plant = KinematicPlant::new(&robot, spiral(n, start));
            for k in 1..=994 {
                let next = spiral(n, start + f64::from(k) * PERIOD_S);
                let mut rates = BendRates::zero(n);
                let moves = next.as_slice().iter().zip(plant.configuration().as_slice());
                for (rate, (to, from)) in rates.as_mut_slice().iter_mut().zip(moves) {
                    *rate = (to - from) / PERIOD_S;
                }
                plant.command(&rates);
                plant.advance(PERIOD_S);

                // Eq. 8 from the arc's geometry, independent of the code under test.
                let t = start + f64::from(k) * PERIOD_S;
                let (theta, radius_m) = (2.0 * t / 15.0, 0.3 / (2.0 * t / 15.0));
                let across_m = radius_m * 2.0 * (theta / 2.0).sin().powi(2);
                let along_m = 0.3 * (n as f64 - 1.0) + radius_m * theta.sin();
                let tip = robot.tip_position(plant.configuration());
                let reference = [across_m * t.cos(), across_m * t.sin(), along_m];
                for axis in 0..3 {
                    assert!(
                        (tip[axis] - reference[axis]).abs() < 1e-15,
                        "n {n}, step {k}, axis {axis}"
                    );
                }
            }
        }
    }

    #[test]
    fn rates_are_held_across_steps_but_not_beyond_the_limit() {
        let mut plant =
            KinematicPlant::new(&robot(1), Configuration::straight(1)).with_extrapolate_max_s(0.25);
        plant.advance(1.0);
        assert_eq!(
            *plant.configuration(),
            Configuration::straight(1),
            "no command yet: at rest"
        );
        plant.command(&BendRates::from_slice(&[1.0, -0.5]).unwrap());
        plant.advance(0.125);
        assert_eq!(
            *plant.configuration(),
            Configuration::from_slice(&[0.125, -0.0625]).unwrap()
        );
        plant.advance(10.0);
        plant.advance(10.0);
        assert_eq!(
            *plant.configuration(),
            Configuration::from_slice(&[0.25, -0.125]).unwrap(),
            "held after 0.25 s"
        );
        plant.command(&BendRates::from_slice(&[1.0, 0.0]).unwrap());
        plant.advance(0.25);
        assert_eq!(
            *plant.configuration(),
            Configuration::from_slice(&[0.5, -0.125]).unwrap(),
            "a command moves it again"
        );
    }

    #[test]
    fn the_default_holds_rates_for_fifty_milliseconds() {
        let mut plant = KinematicPlant::new(&robot(1), Configuration::straight(1));
        plant.command(&BendRates::from_slice(&[1.0, 0.0]).unwrap());
        plant.advance(1.0);
        assert!((plant.configuration().bend_rad(0) - 0.05).abs() < 1e-17);
    }

    #[test]
    fn no_section_bends_beyond_its_limit_nor_changes_direction_there() {
        let mut parameters = RobotParameters::paper(2);
        parameters.sections[1].bend_max_rad = 1.0;
        let robot = Robot::new(&parameters).unwrap();
        let beyond = Configuration::from_bend_angles(&[[3.0, 0.4], [0.5, -2.0]]);
        let mut plant = KinematicPlant::new(&robot, beyond).with_extrapolate_max_s(f64::INFINITY);
        assert!(
            (plant.configuration().bend_rad(0) - 2.8).abs() < 1e-15,
            "the first shape is limited too"
        );
        let outwards = Configuration::from_bend_angles(&[[1.0, 0.4], [1.0, -2.0]]);
        plant.command(&BendRates::from_slice(outwards.as_slice()).unwrap());
        for _ in 0..1000 {
            plant.advance(0.005);
            assert!(
                plant.configuration().bend_rad(0) <= 2.8 + 1e-15
                    && plant.configuration().bend_rad(1) <= 1.0 + 1e-15
            );
        }
        assert!((plant.configuration().bend_rad(1) - 1.0).abs() < 1e-15);
        assert!((plant.configuration().direction_rad(0) - 0.4).abs() < 1e-13);
        assert!((plant.configuration().direction_rad(1) + 2.0).abs() < 1e-13);
    }

    #[test]
    fn non_finite_commands_stop_the_robot() {
        let shape = Configuration::from_bend_angles(&[[0.5, 0.4]]);
        let mut plant = KinematicPlant::new(&robot(1), shape).with_extrapolate_max_s(f64::NAN);
        plant.command(&BendRates::from_slice(&[1.0, 1.0]).unwrap());
        plant.advance(0.01);
        assert_eq!(
            *plant.configuration(),
            shape,
            "NaN seconds of extrapolation are none"
        );

        let mut plant = KinematicPlant::new(&robot(1), shape);
        plant.command(&BendRates::from_slice(&[1.0, 1.0]).unwrap());
        for dt_s in [f64::NAN, -1.0, 0.0] {
            plant.advance(dt_s);
        }
        plant.command(&BendRates::from_slice(&[f64::NAN, 1.0]).unwrap());
        plant.advance(0.01);
        assert_eq!(*plant.configuration(), shape);
    }
}
