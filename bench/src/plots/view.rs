//! Projections of samples and robots.

use cdcr_controller::robot::{Configuration, Robot};
use nalgebra::Vector3;

use crate::chart::{Point, View};
use crate::closed_loop::Sample;

const POINTS: u32 = 24;

pub(super) fn path(view: View, samples: &[Sample]) -> Vec<Point> {
    view.line(samples.iter().map(|sample| sample.tip.position_m.into()))
}

pub(super) fn reference(view: View, samples: &[Sample]) -> Vec<Point> {
    view.line(samples.iter().map(|sample| sample.reference_m.into()))
}

/// The backbone from the base to the tip.
pub(super) fn backbone(view: View, robot: &Robot, at: &Configuration) -> Vec<Point> {
    let sections = 0..robot.section_count();
    let places =
        sections.flat_map(|j| (0..=POINTS).map(move |i| (j, f64::from(i) / f64::from(POINTS))));
    view.line(places.map(|(j, share)| robot.body_point(at, j, share).into()))
}

pub(super) fn ball(view: View, centre_m: &Vector3<f64>, radius_m: f64) -> Vec<Point> {
    let (x, y) = view.point((*centre_m).into());
    let at = |degrees: u32| {
        let (sin, cos) = f64::from(degrees).to_radians().sin_cos();
        (x + 1e3 * radius_m * cos, y + 1e3 * radius_m * sin)
    };
    (0..=360).step_by(4).map(at).collect()
}
