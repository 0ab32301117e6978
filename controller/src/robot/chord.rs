//! Lower bound on the distance between one section and a segment, cheaper than the exact distance (§3 of
//! docs/model.md).
//!
//! Up to half a circle, an arc leaves its chord to one side only, by at most its bulge. Along any direction n, no point
//! of the arc lies lower than the lower end of the chord, less the part of the bulge that points against n. A direction
//! along which arc and segment are separated therefore bounds their distance. The direction used joins the nearest
//! points of chord and segment. It affects how tight the bound is, not its validity.

use core::f64::consts::PI;

use nalgebra::Vector3;

use super::lanes::WideVector;
use super::obstacle::Axis;
use crate::wide::Wide;

/// Below this squared distance (m²), no direction between chord and segment is defined.
const TOUCHING_M2: f64 = 1e-20;

/// The chord of an arc, and bounds on the arc's deviation from it.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(
    clippy::struct_field_names,
    reason = "the unit ends the name, and all are lengths"
)]
pub(super) struct Chord {
    start_m: Vector3<f64>,
    span_m: Vector3<f64>,
    /// Bound on the vector from the chord to the middle of the arc.
    bulge_m: Vector3<f64>,
    /// Bound on the deviation in every direction. Positive only for more than half a circle, where the chord is
    /// replaced by its midpoint.
    slack_m: f64,
}

impl Chord {
    /// Chord of an arc from start to end, of `length_m` and bent by `bend_rad`. The unit vectors point along its start
    /// and towards its bend.
    pub(super) fn new(
        [start_m, end_m]: [Vector3<f64>; 2],
        [along, across]: [Vector3<f64>; 2],
        length_m: f64,
        bend_rad: f64,
    ) -> Self {
        let span_m = end_m - start_m;
        let (rise_m, aside_m) = (span_m.dot(&along), span_m.dot(&across));
        let chord_m = (rise_m * rise_m + aside_m * aside_m).sqrt();
        // ℓ (1 - cos(θ/2))/θ ≤ ℓ θ/8.
        let bulge_m = 0.125 * length_m * bend_rad;
        if bend_rad <= PI {
            return Self {
                start_m,
                span_m,
                bulge_m: (along * aside_m - across * rise_m) * (bulge_m / chord_m),
                slack_m: 0.0,
            };
        }
        Self {
            start_m: (start_m + end_m) * 0.5,
            span_m: Vector3::zeros(),
            bulge_m: Vector3::zeros(),
            slack_m: 0.5 * length_m,
        }
    }

    /// Lower bound on the distance between arc and segment, up to rounding (m); minus infinity where no bound is found.
    #[inline]
    pub(super) fn distance_min_m(&self, axis: &Axis) -> f64 {
        let between_m = self.nearest_between_m(axis);
        let square_m2 = between_m.norm_squared();
        // False for a NaN, too.
        let is_apart = square_m2 > TOUCHING_M2;
        if !is_apart {
            return f64::NEG_INFINITY;
        }
        let arc = between_m.dot(&self.span_m).min(0.0) + between_m.dot(&self.bulge_m).min(0.0);
        let apart = between_m.dot(&(self.start_m - axis.start_m)) + arc
            - between_m.dot(&axis.span_m).max(0.0);
        apart / square_m2.sqrt() - self.slack_m
    }

    /// Vector from the nearest point of the segment to the nearest point of the chord, approximately.
    #[inline]
    fn nearest_between_m(&self, axis: &Axis) -> Vector3<f64> {
        let from_m = self.start_m - axis.start_m;
        let (square, axis_square) = (self.span_m.norm_squared(), axis.length_m * axis.length_m);
        let both = self.span_m.dot(&axis.span_m);
        let (back, axis_along) = (self.span_m.dot(&from_m), axis.span_m.dot(&from_m));
        let area = square * axis_square - both * both;
        let share = if area > 0.0 {
            ((both * axis_along - back * axis_square) / area).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let point_m = self.start_m + self.span_m * share;
        let Wide([t]) = axis.share(&WideVector::splat(&point_m));
        let share = if square > 0.0 {
            ((both * t - back) / square).clamp(0.0, 1.0)
        } else {
            0.0
        };
        from_m + self.span_m * share - axis.span_m * t
    }
}
