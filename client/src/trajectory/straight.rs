use cdcr_controller::reference::{QUINTIC_ACCELERATION_PEAK, QUINTIC_SPEED_PEAK};

use super::Trajectory;

/// Time for which the end point is kept, so that the tip comes to rest there \[s\].
const KEPT_S: f64 = 1.0;

/// A straight line from rest to rest with continuous acceleration: the quintic 10 s³ - 15 s⁴ + 6 s⁵.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Straight {
    start_m: [f64; 3],
    end_m: [f64; 3],
    moving_s: f64,
}

impl Straight {
    /// From `start_m` to `end_m` (m), within `speed_m_s` (m/s, above 0) and `acceleration_m_s2` (m/s², above
    /// 0). The end point is kept for a second.
    pub fn new(start_m: [f64; 3], end_m: [f64; 3], speed_m_s: f64, acceleration_m_s2: f64) -> Self {
        let squares = start_m
            .iter()
            .zip(end_m)
            .map(|(from, to)| (to - from).powi(2));
        let distance_m = squares.sum::<f64>().sqrt();
        let by_speed_s = QUINTIC_SPEED_PEAK * distance_m / speed_m_s;
        let by_acceleration_s = (QUINTIC_ACCELERATION_PEAK * distance_m / acceleration_m_s2).sqrt();
        Self {
            start_m,
            end_m,
            moving_s: by_speed_s.max(by_acceleration_s),
        }
    }

    /// Share of the distance that is gone at `time_s`.
    pub fn share(&self, time_s: f64) -> f64 {
        if time_s >= self.moving_s {
            return 1.0;
        }
        let s = time_s.max(0.0) / self.moving_s;
        s * s * s * (10.0 - s * (15.0 - 6.0 * s))
    }
}

impl Trajectory for Straight {
    fn name(&self) -> &'static str {
        "straight way"
    }

    fn duration_s(&self) -> f64 {
        self.moving_s + KEPT_S
    }

    fn position_m(&self, time_s: f64) -> [f64; 3] {
        if time_s >= self.moving_s {
            return self.end_m;
        }
        let gone = self.share(time_s);
        core::array::from_fn(|i| self.start_m[i] + gone * (self.end_m[i] - self.start_m[i]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_keeps_its_limits_and_reaches_the_larger_of_them() {
        for (speed_m_s, acceleration_m_s2) in [(0.05, 10.0), (10.0, 0.2)] {
            let (start_m, end_m) = ([0.0, 0.1, 0.9], [0.3, -0.1, 0.7]);
            let way = Straight::new(start_m, end_m, speed_m_s, acceleration_m_s2);
            assert_eq!(way.position_m(-1.0), start_m);
            assert_eq!(way.position_m(way.duration_s()), end_m);
            let step_s = way.moving_s / 1e4;
            let at = |k: i32| way.position_m(f64::from(k) * step_s);
            let norm = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
            let (mut speed, mut acceleration) = (0.0_f64, 0.0_f64);
            for k in 1..10_000 {
                let [before, here, after] = [k - 1, k, k + 1].map(at);
                let moved = core::array::from_fn(|i| after[i] - before[i]);
                let changed = core::array::from_fn(|i| after[i] - 2.0 * here[i] + before[i]);
                speed = speed.max(norm(moved) / (2.0 * step_s));
                acceleration = acceleration.max(norm(changed) / (step_s * step_s));
            }
            assert!(speed <= 1.001 * speed_m_s && acceleration <= 1.001 * acceleration_m_s2);
            assert!(speed > 0.99 * speed_m_s || acceleration > 0.99 * acceleration_m_s2);
        }
    }

    #[test]
    fn nowhere_to_go_is_a_way_too() {
        let here_m = [0.1, 0.2, 0.3];
        let way = Straight::new(here_m, here_m, 0.1, 0.5);
        assert_eq!(way.position_m(0.0), here_m);
        assert!((way.duration_s() - KEPT_S).abs() < 1e-12);
    }
}
