use super::{Trajectory, base_and_last_m};

/// The paper's spiral, Eq. 8: the tip of the last section with θ = 2t/15, φ = t, above straight sections. The
/// parameter t advances with real time and begins at `start_rad`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spiral {
    /// Length ℓ of the drawing section \[m\].
    pub section_length_m: f64,
    /// Height `P_z` of that section's base \[m\].
    pub base_height_m: f64,
    /// First value of the parameter t \[rad\].
    pub start_rad: f64,
    /// Duration \[s\].
    pub duration_s: f64,
}

impl Spiral {
    /// The paper's first parameter: t = 5°.
    pub const START_RAD: f64 = 5.0 * core::f64::consts::PI / 180.0;
    /// Duration of the paper's 994 steps of 5 ms \[s\].
    pub const DURATION_S: f64 = 994.0 * 0.005;

    /// The paper's spiral for a robot with these sections, base first \[m\].
    pub fn for_sections(section_lengths_m: &[f64]) -> Self {
        let (base_height_m, section_length_m) = base_and_last_m(section_lengths_m);
        Self {
            section_length_m,
            base_height_m,
            start_rad: Self::START_RAD,
            duration_s: Self::DURATION_S,
        }
    }

    /// Bend vector (u, v) of the last section at the start of the curve \[rad\].
    pub fn start_bend_rad(&self) -> [f64; 2] {
        let bend_rad = 2.0 * self.start_rad / 15.0;
        let (sin, cos) = self.start_rad.sin_cos();
        [bend_rad * cos, bend_rad * sin]
    }
}

impl Trajectory for Spiral {
    fn name(&self) -> &'static str {
        "spiral"
    }

    fn duration_s(&self) -> f64 {
        self.duration_s
    }

    fn position_m(&self, time_s: f64) -> [f64; 3] {
        // Eq. 8
        let t = self.start_rad + time_s.clamp(0.0, self.duration_s);
        let (sin_part, cos_part) = (t / 15.0).sin_cos();
        // sin(t/15)/t tends to 1/15.
        let h = if t == 0.0 {
            self.section_length_m
        } else {
            15.0 * self.section_length_m * sin_part / t
        };
        let (sin, cos) = t.sin_cos();
        [
            h * sin_part * cos,
            h * sin_part * sin,
            self.base_height_m + h * cos_part,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::assert_near;
    use super::*;

    #[test]
    fn it_starts_where_the_paper_does() {
        for sections in 1..=3 {
            let [x, y, z] = Spiral::for_sections(&vec![0.3; sections]).position_m(0.0);
            let base_mm = 300.0 * (sections - 1) as f64;
            // Printed with four decimals: (1.7387, 0.1521, P_z + 299.9932) mm.
            assert!((1e3 * x - 1.7387).abs() < 5e-5, "{x}");
            assert!((1e3 * y - 0.1521).abs() < 5e-5, "{y}");
            assert!((1e3 * z - base_mm - 299.9932).abs() < 5e-5, "{z}");
        }
    }

    #[test]
    fn it_is_the_workspace_of_one_section() {
        let spiral = Spiral::for_sections(&[0.3]);
        for step in 0..=994 {
            let time_s = 0.005 * f64::from(step);
            let t = spiral.start_rad + time_s;
            let bend = 2.0 * t / 15.0;
            let radius = 0.3 * (1.0 - bend.cos()) / bend;
            let expected = [radius * t.cos(), radius * t.sin(), 0.3 * bend.sin() / bend];
            for (value, expected) in spiral.position_m(time_s).iter().zip(expected) {
                assert!((value - expected).abs() < 1e-14);
            }
        }
    }

    #[test]
    fn the_start_bend_belongs_to_the_start() {
        let spiral = Spiral::for_sections(&[0.3]);
        let [u, v] = spiral.start_bend_rad();
        let bend = u.hypot(v);
        let g = (1.0 - bend.cos()) / (bend * bend);
        let [x, y, _] = spiral.position_m(0.0);
        assert!((0.3 * u * g - x).abs() < 1e-14);
        assert!((0.3 * v * g - y).abs() < 1e-14);
    }

    #[test]
    fn it_can_start_straight() {
        let spiral = Spiral {
            start_rad: 0.0,
            ..Spiral::for_sections(&[0.3])
        };
        assert_near(spiral.position_m(0.0), [0.0, 0.0, 0.3]);
    }
}
