use super::{Orientation, Trajectory};

/// The paper's line, Eq. 9: from the straight robot's tip, 30 mm/s sideways and 10 mm/s down.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// First point \[m\].
    pub start_m: [f64; 3],
    /// Velocity \[m/s\].
    pub velocity_m_s: [f64; 3],
    /// Duration \[s\].
    pub duration_s: f64,
    /// Constant direction of the tip axis (unit vector); `None`: free.
    pub tip_axis: Option<[f64; 3]>,
}

impl Line {
    /// The paper's velocity \[m/s\].
    pub const VELOCITY_M_S: [f64; 3] = [0.03, 0.0, -0.01];
    /// Duration of the paper's 510 samples of 5 ms \[s\].
    pub const DURATION_S: f64 = 510.0 * 0.005;

    /// The paper's line for a robot with these sections \[m\], position only.
    pub fn for_sections(section_lengths_m: &[f64]) -> Self {
        Self {
            start_m: [0.0, 0.0, section_lengths_m.iter().sum()],
            velocity_m_s: Self::VELOCITY_M_S,
            duration_s: Self::DURATION_S,
            tip_axis: None,
        }
    }
}

impl Trajectory for Line {
    fn name(&self) -> &'static str {
        "line"
    }

    fn duration_s(&self) -> f64 {
        self.duration_s
    }

    fn position_m(&self, time_s: f64) -> [f64; 3] {
        // Eq. 9
        let t = time_s.clamp(0.0, self.duration_s);
        core::array::from_fn(|i| self.start_m[i] + self.velocity_m_s[i] * t)
    }

    fn orientation(&self, _time_s: f64) -> Orientation {
        self.tip_axis.map_or(Orientation::Free, Orientation::Axis)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::assert_near;
    use super::*;

    #[test]
    fn it_is_equation_9() {
        let line = Line::for_sections(&[0.3; 3]);
        // {30 t, 0, 900 - 10 t} mm, 510 samples of 5 ms.
        for t in [0.0, 1.0, 2.55] {
            let [x, y, z] = line.position_m(t);
            assert!((1e3 * x - 30.0 * t).abs() < 1e-10);
            assert!(y.abs() < 1e-15);
            assert!((1e3 * z - (900.0 - 10.0 * t)).abs() < 1e-10);
        }
        assert!((line.duration_s() - 2.55).abs() < 1e-12);
    }

    #[test]
    fn the_axis_travels_with_the_point() {
        let line = Line {
            tip_axis: Some([0.0, 0.0, 1.0]),
            ..Line::for_sections(&[0.3])
        };
        let point = line.point(0.0, 77);
        assert_near(point.orientation, [0.0, 0.0, 1.0, 0.0]);
        assert_eq!(point.orientation_kind, 1);
        assert_eq!(point.time_ns, 77);
    }
}
