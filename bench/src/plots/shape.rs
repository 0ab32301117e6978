//! Paths and robot shapes in projection.

use cdcr_controller::robot::{Configuration, Robot};
use nalgebra::Vector3;

use crate::chart::{Curve, Panel, Point, Scale};
use crate::closed_loop::Sample;

const POINTS: u32 = 24;

/// Two axes of the base frame, across and up.
#[derive(Debug, Clone, Copy)]
pub(super) struct View {
    axes: [usize; 2],
}

const NAMES: [&str; 3] = ["x [mm]", "y [mm]", "z [mm]"];

impl View {
    pub(super) const ABOVE: Self = Self { axes: [0, 1] };
    pub(super) const SIDE: Self = Self { axes: [0, 2] };
    pub(super) const FRONT: Self = Self { axes: [1, 2] };

    pub(super) fn point(self, p_m: &Vector3<f64>) -> Point {
        (1e3 * p_m[self.axes[0]], 1e3 * p_m[self.axes[1]])
    }

    pub(super) fn path(self, samples: &[Sample]) -> Vec<Point> {
        let tips = samples.iter().map(|s| &s.tip.position_m);
        tips.map(|p_m| self.point(p_m)).collect()
    }

    pub(super) fn reference(self, samples: &[Sample]) -> Vec<Point> {
        let points = samples.iter().map(|s| &s.reference_m);
        points.map(|p_m| self.point(p_m)).collect()
    }

    /// The backbone from the base to the tip.
    pub(super) fn backbone(self, robot: &Robot, at: &Configuration) -> Vec<Point> {
        let sections = 0..robot.section_count();
        let places = sections.flat_map(|j| (0..=POINTS).map(move |i| (j, i)));
        places
            .map(|(j, i)| {
                let share = f64::from(i) / f64::from(POINTS);
                self.point(&robot.body_point(at, j, share))
            })
            .collect()
    }

    pub(super) fn ball(self, centre_m: &Vector3<f64>, radius_m: f64) -> Vec<Point> {
        let (x, y) = self.point(centre_m);
        let angle = |i: u32| f64::from(i).to_radians();
        (0..=360)
            .step_by(4)
            .map(|i| {
                let (sin, cos) = angle(i).sin_cos();
                (x + 1e3 * radius_m * cos, y + 1e3 * radius_m * sin)
            })
            .collect()
    }

    pub(super) fn panel(self, title: impl Into<String>, curves: Vec<Curve>) -> Panel {
        Panel {
            title: title.into(),
            x: NAMES[self.axes[0]],
            y: NAMES[self.axes[1]],
            scale: Scale::Equal,
            curves,
        }
    }
}
