use super::{PAPER_SECTION_M, Trajectory, base_and_last_m};

/// The paper's horizontal circle, §4.3, drawn by one section with a bend of 75°.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Circle {
    /// Radius \[m\].
    pub radius_m: f64,
    /// Height above the robot's base \[m\].
    pub height_m: f64,
    /// Angular speed \[rad/s\]; negative: clockwise seen from above.
    pub rate_rad_s: f64,
    /// Duration \[s\].
    pub duration_s: f64,
}

impl Circle {
    /// The paper's radius \[m\].
    pub const RADIUS_M: f64 = 0.169_86;
    /// The paper's height \[m\].
    pub const HEIGHT_M: f64 = 0.221_37;
    /// Duration of the paper's single round at 1 rad/s \[s\].
    pub const DURATION_S: f64 = core::f64::consts::TAU;

    /// The paper's circle, scaled to the workspace of the last of these sections \[m\].
    pub fn for_sections(section_lengths_m: &[f64]) -> Self {
        let (base_height_m, section_length_m) = base_and_last_m(section_lengths_m);
        let scale = section_length_m / PAPER_SECTION_M;
        Self {
            radius_m: Self::RADIUS_M * scale,
            height_m: base_height_m + Self::HEIGHT_M * scale,
            rate_rad_s: 1.0,
            duration_s: Self::DURATION_S,
        }
    }
}

impl Trajectory for Circle {
    fn name(&self) -> &'static str {
        "circle"
    }

    fn duration_s(&self) -> f64 {
        self.duration_s
    }

    fn position_m(&self, time_s: f64) -> [f64; 3] {
        let angle = self.rate_rad_s * time_s.clamp(0.0, self.duration_s);
        let (sin, cos) = angle.sin_cos();
        [self.radius_m * cos, self.radius_m * sin, self.height_m]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_section_reaches_it_with_75_degrees() {
        let circle = Circle::for_sections(&[0.3]);
        let bend = 75.0_f64.to_radians();
        // The printed constants are rounded: 7.2e-3 mm off (docs/model.md).
        assert!((circle.radius_m - 0.3 * (1.0 - bend.cos()) / bend).abs() < 1e-5);
        assert!((circle.height_m - 0.3 * bend.sin() / bend).abs() < 1e-5);
        let quarter = circle.position_m(core::f64::consts::FRAC_PI_2);
        assert!((quarter[1] - 0.169_86).abs() < 1e-12);
    }

    #[test]
    fn it_stands_on_the_sections_below() {
        let circle = Circle::for_sections(&[0.2, 0.2, 0.15]);
        assert!((circle.height_m - (0.4 + 0.5 * Circle::HEIGHT_M)).abs() < 1e-12);
        assert!((circle.radius_m - 0.5 * Circle::RADIUS_M).abs() < 1e-12);
    }
}
