//! Rates of a robot that goes to rest, or home.

use crate::robot::{BendRates, Configuration};

/// The next rates on the way to rest: every component shrinks by the same factor, so the direction is
/// kept, and the fastest one loses at most `deceleration_rad_s2 · period_s`.
pub fn ramp_to_zero(previous: &BendRates, deceleration_rad_s2: f64, period_s: f64) -> BendRates {
    let mut rates = *previous;
    let fastest = rates
        .as_slice()
        .iter()
        .fold(0.0_f64, |fastest, rate| fastest.max(rate.abs()));
    let left = fastest - deceleration_rad_s2 * period_s;
    // What rounding leaves of the last step is rest, too.
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

/// Rates on the straight line to the straight robot, the fastest component at `rate_rad_s`; zero on
/// arrival.
pub fn homing_rates(at: &Configuration, rate_rad_s: f64, period_s: f64) -> BendRates {
    let mut rates = BendRates::zero(at.section_count());
    let farthest = at
        .as_slice()
        .iter()
        .fold(0.0_f64, |farthest, bend| farthest.max(bend.abs()));
    if farthest > 0.0 {
        let duration_s = (farthest / rate_rad_s).max(period_s);
        for (rate, bend) in rates.as_mut_slice().iter_mut().zip(at.as_slice()) {
            *rate = -bend / duration_s;
        }
    }
    rates
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_S: f64 = 0.005;

    fn rates(values: [f64; 4]) -> BendRates {
        BendRates::from_slice(&values).expect("two sections")
    }

    fn at(values: [f64; 4]) -> Configuration {
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

    #[test]
    fn homing_arrives_exactly_once_near() {
        let mut bend = at([1.0, -0.5, 0.0, 0.25]);
        for _ in 0..1001 {
            bend = bend.advanced(&homing_rates(&bend, 0.5, PERIOD_S), PERIOD_S);
        }
        assert!(bend.as_slice().iter().all(|b| b.abs() < 1e-12), "{bend:?}");
        let end = homing_rates(&at([0.0; 4]), 0.5, PERIOD_S);
        assert_eq!(end, BendRates::zero(2));
    }
}
