use super::{FigurePlane, Orientation, Trajectory};

/// A trajectory changed in speed, size or plane, or repeated. Its first point is unchanged.
pub struct Changed {
    inner: Box<dyn Trajectory>,
    speed: f64,
    scale: f64,
    plane: FigurePlane,
    rounds: u32,
    is_closed: bool,
    knots_s: Option<Vec<f64>>,
}

impl Changed {
    /// Multiplies the speed by `speed` (above 0) and the distances from the first point by `scale` (above 0).
    /// Maps x and y to the axes of `plane`. Repeats the trajectory `rounds` times (1 or more): a closed curve
    /// from its start each time, any other curve back and forth.
    pub fn new(
        inner: Box<dyn Trajectory>,
        speed: f64,
        scale: f64,
        plane: FigurePlane,
        rounds: u32,
    ) -> Self {
        let one_s = inner.duration_s();
        let is_closed = inner.is_closed();
        let knots_s = inner.knots_s().map(|knots_s| {
            let mut all_s = vec![0.0];
            for round in 0..rounds {
                let goes_back = !is_closed && round % 2 == 1;
                let in_round = (1..knots_s.len()).map(|k| {
                    if goes_back {
                        one_s - knots_s[knots_s.len() - 1 - k]
                    } else {
                        knots_s[k]
                    }
                });
                all_s.extend(in_round.map(|time_s| (f64::from(round) * one_s + time_s) / speed));
            }
            all_s
        });
        Self {
            inner,
            speed,
            scale,
            plane,
            rounds,
            is_closed,
            knots_s,
        }
    }

    /// Time in the inner trajectory \[s\].
    fn inner_s(&self, time_s: f64) -> f64 {
        let one_s = self.inner.duration_s();
        if one_s <= 0.0 {
            return 0.0;
        }
        let gone_s = self.speed * time_s.clamp(0.0, self.duration_s());
        let round = (gone_s / one_s)
            .floor()
            .clamp(0.0, f64::from(self.rounds) - 1.0);
        let in_round_s = gone_s - round * one_s;
        if !self.is_closed && round % 2.0 == 1.0 {
            one_s - in_round_s
        } else {
            in_round_s
        }
    }
}

impl Trajectory for Changed {
    fn name(&self) -> &str {
        self.inner.name()
    }

    fn duration_s(&self) -> f64 {
        f64::from(self.rounds) * self.inner.duration_s() / self.speed
    }

    fn position_m(&self, time_s: f64) -> [f64; 3] {
        let first_m = self.inner.position_m(0.0);
        let here_m = self.inner.position_m(self.inner_s(time_s));
        let [x, y, z] = core::array::from_fn(|i| self.scale * (here_m[i] - first_m[i]));
        let placed_m = self.plane.placed([x, y, z]);
        core::array::from_fn(|i| first_m[i] + placed_m[i])
    }

    fn orientation(&self, time_s: f64) -> Orientation {
        self.inner.orientation(self.inner_s(time_s))
    }

    fn knots_s(&self) -> Option<&[f64]> {
        self.knots_s.as_deref()
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::assert_near;
    use super::super::{Circle, Line};
    use super::*;

    #[test]
    fn an_open_curve_is_gone_there_and_back_and_its_first_point_stays() {
        let line = Line::for_sections(&[0.3; 3]);
        let changed = Changed::new(Box::new(line), 2.0, 0.5, FigurePlane::Xy, 3);
        let one_s = line.duration_s() / 2.0;
        assert!((changed.duration_s() - 3.0 * one_s).abs() < 1e-12);
        let start_m = line.start_m;
        let end_m = core::array::from_fn(|i| {
            start_m[i] + 0.5 * (line.position_m(line.duration_s)[i] - start_m[i])
        });
        for (round, expected_m) in [(0.0, start_m), (1.0, end_m), (2.0, start_m), (3.0, end_m)] {
            let found_m = changed.position_m(round * one_s);
            for (found, expected) in found_m.iter().zip(expected_m) {
                assert!((found - expected).abs() < 1e-12, "{round}");
            }
        }
    }

    #[test]
    fn a_closed_curve_goes_on_and_a_plane_turns_it_about_its_first_point() {
        let circle = Circle::for_sections(&[0.3]);
        let [x, y, z] = circle.position_m(0.0);
        let changed = Changed::new(Box::new(circle), 1.0, 1.0, FigurePlane::Xz, 2);
        let quarter_s = circle.duration_s / 4.0;
        for begin_s in [0.0, circle.duration_s] {
            let found_m = changed.position_m(begin_s + quarter_s);
            let expected_m = [x - circle.radius_m, y, z + circle.radius_m];
            for (found, expected) in found_m.iter().zip(expected_m) {
                assert!((found - expected).abs() < 1e-6, "{begin_s}");
            }
        }
    }

    /// A trajectory with unevenly spaced knots.
    struct Rows;

    impl Trajectory for Rows {
        fn name(&self) -> &'static str {
            "rows"
        }
        fn duration_s(&self) -> f64 {
            4.0
        }
        fn position_m(&self, time_s: f64) -> [f64; 3] {
            [time_s, 0.0, 0.0]
        }
        fn knots_s(&self) -> Option<&[f64]> {
            Some(&[0.0, 1.0, 4.0])
        }
    }

    #[test]
    fn rows_are_sent_exactly_in_every_round() {
        let changed = Changed::new(Box::new(Rows), 2.0, 1.0, FigurePlane::Xy, 2);
        let knots_s = changed.knots_s().expect("rows").to_vec();
        assert_eq!(knots_s, [0.0, 0.5, 2.0, 3.5, 4.0]);
        let reached_m = core::array::from_fn(|k| changed.position_m(knots_s[k])[0]);
        assert_near(reached_m, [0.0, 1.0, 4.0, 1.0, 0.0]);
    }
}
