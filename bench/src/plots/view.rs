use cdcr_controller::robot::{Configuration, Robot};
use nalgebra::Vector3;

use crate::chart::{Curve, Panel, Point, Scale};
use crate::closed_loop::Sample;

const POINTS: u32 = 24;

/// Two axes of the base frame, across and up: paths and robot shapes in projection.
#[derive(Debug, Clone, Copy)]
pub(super) struct View([usize; 2]);

impl View {
    pub(super) const ABOVE: Self = Self([0, 1]);
    pub(super) const SIDE: Self = Self([0, 2]);
    pub(super) const FRONT: Self = Self([1, 2]);

    fn point(self, p_m: &Vector3<f64>) -> Point {
        (1e3 * p_m[self.0[0]], 1e3 * p_m[self.0[1]])
    }

    pub(super) fn path(self, samples: &[Sample]) -> Vec<Point> {
        samples
            .iter()
            .map(|s| self.point(&s.tip.position_m))
            .collect()
    }

    pub(super) fn reference(self, samples: &[Sample]) -> Vec<Point> {
        samples.iter().map(|s| self.point(&s.reference_m)).collect()
    }

    /// The backbone from the base to the tip.
    pub(super) fn backbone(self, robot: &Robot, at: &Configuration) -> Vec<Point> {
        let sections = 0..robot.section_count();
        let places =
            sections.flat_map(|j| (0..=POINTS).map(move |i| (j, f64::from(i) / f64::from(POINTS))));
        places
            .map(|(j, share)| self.point(&robot.body_point(at, j, share)))
            .collect()
    }

    pub(super) fn ball(self, centre_m: &Vector3<f64>, radius_m: f64) -> Vec<Point> {
        let (x, y) = self.point(centre_m);
        let at = |degrees: u32| {
            let (sin, cos) = f64::from(degrees).to_radians().sin_cos();
            (x + 1e3 * radius_m * cos, y + 1e3 * radius_m * sin)
        };
        (0..=360).step_by(4).map(at).collect()
    }

    pub(super) fn panel(self, title: &str, curves: Vec<Curve>) -> Panel {
        let [x, y] = self.0.map(|axis| ["x [mm]", "y [mm]", "z [mm]"][axis]);
        Panel::new(title, [x, y], Scale::Equal, curves)
    }
}
