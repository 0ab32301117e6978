//! Rates of a robot that comes to rest, or homes.

use crate::robot::{BendRates, Configuration, Robot};

use super::Limits;

/// The next rates of a ramp to rest: all components shrink by the same factor, so the direction stays, and
/// the fastest one decreases by at most `deceleration_rad_s2 · period_s`.
pub fn ramp_to_zero(previous: &BendRates, deceleration_rad_s2: f64, period_s: f64) -> BendRates {
    let mut rates = *previous;
    let fastest = rates
        .as_slice()
        .iter()
        .fold(0.0_f64, |fastest, rate| fastest.max(rate.abs()));
    let left = fastest - deceleration_rad_s2 * period_s;
    // A remainder by rounding counts as rest.
    let share = if left > 1e-9 * fastest {
        left / fastest
    } else {
        0.0
    };
    for rate in rates.as_mut_slice() {
        *rate *= share;
    }
    rates
}

/// Rates on the straight line to the straight robot, with the fastest component at `rate_rad_s`; zero on
/// arrival. If a section's rate, the speed of a cable or of a section end, or the acceleration (`change_rad_s` from the `previous`
/// command) does not permit that, all components are slower, so the limits do not bend the line.
pub fn homing_rates(
    robot: &Robot,
    at: &Configuration,
    previous: &BendRates,
    rate_rad_s: f64,
    change_rad_s: f64,
    period_s: f64,
) -> BendRates {
    let mut rates = BendRates::zero(at.section_count());
    let bends = at.as_slice().iter();
    let farthest_rad = bends.fold(0.0_f64, |farthest, bend| farthest.max(bend.abs()));
    let duration_s = (farthest_rad / rate_rad_s).max(period_s);
    for (rate, bend) in rates.as_mut_slice().iter_mut().zip(at.as_slice()) {
        *rate = -bend / duration_s;
    }
    let limits = Limits::new(robot, at, period_s).with_acceleration(previous, change_rad_s);
    limits.straight(&rates)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::RobotParameters;

    const PERIOD_S: f64 = 0.005;

    fn rates(values: [f64; 4]) -> BendRates {
        BendRates::from_slice(&values).expect("two sections")
    }

    fn configuration(values: [f64; 4]) -> Configuration {
        Configuration::from_slice(&values).expect("two sections")
    }

    #[test]
    fn ramps_end_at_zero_and_keep_the_direction() {
        let mut now = rates([1.0, -0.5, 0.0, 0.25]);
        let mut cycles = 0;
        while now.as_slice().iter().any(|rate| *rate != 0.0) {
            now = ramp_to_zero(&now, 40.0, PERIOD_S);
            cycles += 1;
            let [a, b, _, d] = [0, 1, 2, 3].map(|i| now.as_slice()[i]);
            assert!((b + 0.5 * a).abs() < 1e-12 && (d - 0.25 * a).abs() < 1e-12);
        }
        assert_eq!(cycles, 5);
    }

    fn robot() -> Robot {
        Robot::new(&RobotParameters::paper(2)).expect("the paper's robot")
    }

    #[test]
    fn homing_arrives_exactly_once_near() {
        let (robot, rest, free) = (robot(), BendRates::zero(2), f64::INFINITY);
        let mut bend = configuration([1.0, -0.5, 0.0, 0.25]);
        for _ in 0..1001 {
            let rates = homing_rates(&robot, &bend, &rest, 0.5, free, PERIOD_S);
            bend = bend.advanced(&rates, PERIOD_S);
        }
        assert!(bend.as_slice().iter().all(|b| b.abs() < 1e-12), "{bend:?}");
        let end = homing_rates(&robot, &configuration([0.0; 4]), &rest, 0.5, free, PERIOD_S);
        assert_eq!(end, rest);
    }

    #[test]
    fn no_limit_bends_the_straight_line_home() {
        let mut parameters = RobotParameters::paper(2);
        parameters.sections[1].rate_max_rad_s = 0.3;
        let slow_section = Robot::new(&parameters).expect("a slow section");
        parameters.cable_speed_max_m_s = 0.004;
        let slow_cables = Robot::new(&parameters).expect("slow cables");
        let slow_tip = RobotParameters {
            tip_speed_max_m_s: 0.1,
            ..RobotParameters::paper(2)
        };
        let slow_tip = Robot::new(&slow_tip).expect("a slow tip");
        let begin = configuration([1.0, -0.5, 0.8, 0.25]);
        for (robot, acceleration_rad_s2) in [
            (&slow_section, 1e9),
            (&slow_cables, 1e9),
            (&slow_tip, 1e9),
            (&robot(), 3.0),
        ] {
            let change = acceleration_rad_s2 * PERIOD_S;
            let (mut bend, mut rates) = (begin, BendRates::zero(2));
            for _ in 0..2000 {
                let desired_rates = homing_rates(robot, &bend, &rates, 2.0, change, PERIOD_S);
                let limits = Limits::new(robot, &bend, PERIOD_S).with_acceleration(&rates, change);
                rates = limits.nearest(&desired_rates).rates;
                bend = bend.advanced(&rates, PERIOD_S);
                let left = bend.as_slice()[0];
                for (bend, begin) in bend.as_slice().iter().zip(begin.as_slice()) {
                    let beside_rad = (bend - begin * left).abs();
                    assert!(beside_rad < 1e-12, "{beside_rad} rad beside the line");
                }
            }
            assert!(bend.as_slice().iter().all(|b| b.abs() < 1e-12), "{bend:?}");
        }
    }
}
