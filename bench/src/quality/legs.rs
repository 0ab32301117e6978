//! A curve through points at given times.

use std::f64::consts::PI;

use cdcr_client::Trajectory;
use nalgebra::Vector3;

/// Points that are reached at their times, at rest in each of them; two points at one time are a jump. The
/// last one is held.
pub(super) struct Legs {
    name: &'static str,
    knots: Vec<(f64, Vector3<f64>)>,
}

impl Legs {
    /// Through these points (s, m): at least one, in the order of their times.
    pub(super) fn new(name: &'static str, knots: Vec<(f64, Vector3<f64>)>) -> Self {
        debug_assert!(!knots.is_empty() && knots.is_sorted_by(|a, b| a.0 <= b.0));
        Self { name, knots }
    }
}

impl Trajectory for Legs {
    fn name(&self) -> &str {
        self.name
    }

    fn duration_s(&self) -> f64 {
        self.knots.last().map_or(0.0, |knot| knot.0)
    }

    fn position_m(&self, time_s: f64) -> [f64; 3] {
        let next = self.knots.partition_point(|knot| knot.0 <= time_s);
        let last = next.saturating_sub(1);
        let (from_s, from_m) = self.knots[last];
        let Some(&(to_s, to_m)) = self.knots.get(next).filter(|_| next > 0) else {
            return from_m.into();
        };
        let share = (time_s - from_s) / (to_s - from_s);
        (from_m + (to_m - from_m) * (0.5 - 0.5 * (PI * share).cos())).into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_reached_at_their_times_and_jumps_are_jumps() {
        let (x, y) = (Vector3::x(), Vector3::y());
        let legs = Legs::new(
            "test",
            vec![(0.0, x), (1.0, y), (1.0, x), (2.0, x), (2.0, y)],
        );
        let at = |time_s: f64| Vector3::from(legs.position_m(time_s));
        assert_eq!(at(-1.0), x);
        assert_eq!(at(0.0), x);
        assert!((at(0.5) - (x + y) * 0.5).norm() < 1e-15);
        assert!((at(1.0 - 1e-9) - y).norm() < 1e-9);
        for time_s in [1.0, 1.5, 1.999] {
            assert_eq!(at(time_s), x);
        }
        for time_s in [2.0, 2.5, 100.0] {
            assert_eq!(at(time_s), y);
        }
        assert_eq!(legs.duration_s(), 2.0);
    }
}
