//! A body that would touch itself, which neither solver nor guard avoids.

use std::f64::consts::PI;
use std::fmt;

use cdcr_controller::robot::{Configuration, Robot};
use nalgebra::Vector3;

/// Overlap up to this is not a contact \[m\].
const TOLERANCE_M: f64 = 2e-3;
/// Points of the backbone are this part of the body's radius apart: between them the body is less than a sixteenth of its
/// radius nearer to another part that it touches.
const SPACING: f64 = 0.5;
/// Maximum number of points of a section, whose body may be thin.
const POINTS_MAX: f64 = 400.0;

/// The deepest overlap of two parts of the body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SelfContact {
    time_s: f64,
    /// From 1 at the base.
    sections: [usize; 2],
    overlap_m: f64,
}

/// A point of the backbone.
struct BackbonePoint {
    section: usize,
    /// Distance from the base along the backbone \[m\].
    along_m: f64,
    point_m: Vector3<f64>,
    radius_m: f64,
}

/// Points of the backbone, base first.
fn places(robot: &Robot, shape: &Configuration) -> Vec<BackbonePoint> {
    let (mut places, mut base_m) = (Vec::new(), 0.0);
    for (section, geometry) in robot.sections().iter().enumerate() {
        let count = (geometry.length_m / (SPACING * geometry.body_radius_m)).ceil();
        let count = count.clamp(1.0, POINTS_MAX) as usize;
        places.extend((0..=count).map(|k| {
            let share = k as f64 / count as f64;
            BackbonePoint {
                section,
                along_m: base_m + share * geometry.length_m,
                point_m: robot.body_point(shape, section, share),
                radius_m: geometry.body_radius_m,
            }
        }));
        base_m += geometry.length_m;
    }
    places
}

impl SelfContact {
    /// Of a shape at this time. Parts nearer along the body than a half circle of its radius cannot touch: no arc is
    /// narrower than the body.
    pub(super) fn find(robot: &Robot, shape: &Configuration, time_s: f64) -> Option<Self> {
        let places = places(robot, shape);
        let thickest_m = places
            .iter()
            .fold(0.0, |most, place| place.radius_m.max(most));
        let mut deepest: Option<Self> = None;
        for (i, one) in places.iter().enumerate() {
            let mut from_m = one.along_m + PI * one.radius_m;
            for other in &places[i + 1..] {
                if other.along_m < from_m.max(one.along_m + PI * other.radius_m) {
                    continue;
                }
                let distance_m = (one.point_m - other.point_m).norm();
                // No part within this way along the backbone is near enough.
                from_m = other.along_m + distance_m - one.radius_m - thickest_m;
                let overlap_m = one.radius_m + other.radius_m - distance_m;
                if overlap_m > deepest.map_or(TOLERANCE_M, |deepest| deepest.overlap_m) {
                    deepest = Some(Self {
                        time_s,
                        sections: [1 + one.section, 1 + other.section],
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
