//! A body that would touch itself, which neither solver nor guard avoids.

use std::f64::consts::PI;
use std::fmt;

use cdcr_controller::robot::{Configuration, Robot};
use nalgebra::Vector3;

use crate::backbone::{POINTS_PER_SECTION, backbone};

/// Overlap up to this is no contact \[m\]: the points of the backbone have distances of a few millimetres.
const TOLERANCE_M: f64 = 2e-3;

/// The deepest overlap of two parts of the body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SelfContact {
    time_s: f64,
    /// From 1 at the base.
    sections: [usize; 2],
    overlap_m: f64,
}

impl SelfContact {
    /// Of a shape at this time. Parts nearer along the body than a half circle of its radius cannot touch: no arc is
    /// narrower than the body.
    pub(super) fn find(robot: &Robot, shape: &Configuration, time_s: f64) -> Option<Self> {
        let points: Vec<Vector3<f64>> = (backbone(robot, shape.as_slice()).into_iter())
            .map(Vector3::from)
            .collect();
        let section_of = |k: usize| (k / POINTS_PER_SECTION).min(robot.section_count() - 1);
        let radius_m = |k: usize| robot.sections()[section_of(k)].body_radius_m;
        let part_m =
            |k: usize| robot.sections()[section_of(k)].length_m / POINTS_PER_SECTION as f64;
        let mut deepest: Option<Self> = None;
        for i in 0..points.len() {
            let mut along_m = 0.0;
            for j in i + 1..points.len() {
                along_m += part_m(j - 1);
                if along_m < PI * radius_m(i).max(radius_m(j)) {
                    continue;
                }
                let overlap_m = radius_m(i) + radius_m(j) - (points[i] - points[j]).norm();
                if overlap_m > deepest.map_or(TOLERANCE_M, |deepest| deepest.overlap_m) {
                    let sections = [i, j].map(|k| 1 + section_of(k));
                    deepest = Some(Self {
                        time_s,
                        sections,
                        overlap_m,
                    });
                }
            }
        }
        deepest
    }

    /// The deeper one.
    pub(super) fn deeper(one: Option<Self>, other: Option<Self>) -> Option<Self> {
        [one, other]
            .into_iter()
            .flatten()
            .max_by(|a, b| a.overlap_m.total_cmp(&b.overlap_m))
    }

    /// Whether it is deeper than in the shape at the start, which a motion may have to leave.
    pub(super) fn is_deeper_than(&self, start: Option<Self>) -> bool {
        self.overlap_m > start.map_or(0.0, |start| start.overlap_m) + TOLERANCE_M
    }
}

impl fmt::Display for SelfContact {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            time_s,
            sections: [one, other],
            overlap_m,
        } = self;
        let which = if one == other {
            format!("section {one} would touch itself")
        } else {
            format!("sections {one} and {other} would touch")
        };
        write!(
            f,
            "{which} at {time_s:.2} s, {:.0} mm deep by their body_radius_m",
            1e3 * overlap_m
        )
    }
}

#[cfg(test)]
mod tests {
    use cdcr_client::model::robot_of;

    use super::*;
    use crate::dry_run::tests::robot;

    fn find(bends_rad: &[f64]) -> Option<SelfContact> {
        let shape = Configuration::from_slice(bends_rad).expect("within the maximum");
        SelfContact::find(&robot_of(&robot(3)).expect("a robot"), &shape, 1.0)
    }

    #[test]
    fn a_body_touches_itself_where_it_closes_a_ring() {
        assert_eq!(find(&[0.0; 6]), None);
        // Three quarters of a circle.
        assert_eq!(find(&[PI / 2.0, 0.0, PI / 2.0, 0.0, PI / 2.0, 0.0]), None);
        let ring = 2.0 * PI / 3.0;
        let found = find(&[ring, 0.0, ring, 0.0, ring, 0.0]).expect("a ring");
        assert_eq!(found.sections, [1, 3]);
        let thick_m = 2.0 * robot(3).section[0].body_radius_m;
        assert!((found.overlap_m - thick_m).abs() < 1e-9, "{found}");
        assert!(found.is_deeper_than(None) && !found.is_deeper_than(Some(found)));
        assert!(find(&[ring; 6]).is_none_or(|spiral| spiral.overlap_m < thick_m));
    }
}
