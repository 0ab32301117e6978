//! How far one section is from a point and from a segment, exactly (§3 of docs/model.md).
//!
//! The section's own axes: x towards its bend, y normal to the plane of its arc, z along its start. With curvature κ = θ/l the
//! arc belongs to a circle around (1/κ, 0, 0). In units of its radius, a point is at V = (X, Z) = (1 - κx, κz) from the centre,
//! H = |V|, and
//! ```text
//! q = H/κ - 1/κ = (κ (x² + z²) - 2x) / (H + 1)      signed distance from the circle within the plane
//! d = √(q² + y²)                                    distance from the circle
//! a = atan2(Z, X)                                   angle of the circle's nearest point from the start
//! ```
//! None of these divides by κ or cancels as κ → 0: the straight section is no special case. The foot is on the arc if the point
//! lies between the planes across its two ends (for θ ≤ π); otherwise the nearer end is nearest.
//!
//! **Segment.** Along a line with velocity (x', y', z') of square L² = x'² + y'² + z'², G = d²/2 has
//! ```text
//! G'  = q q' + y y',   q' = (Z z' - X x') / H
//! G'' = L² - c²/H³,    c = X z' + Z x'   (constant along a line: twice the area swept about the centre, per time)
//! ```
//! H is the norm of a linear function, least where the line is nearest to the circle's axis; G'' falls up to there and rises
//! after. So G is convex, then possibly concave, then convex, and has at most one minimum on either side. Newton's method finds
//! each from its end of the segment: as G'' falls on the way, no step passes the minimum. Where the nearest point of the arc is
//! one of its ends, the segment's nearest point is a projection. No minimum can be missed; nothing is sampled.

use core::f64::consts::{PI, TAU};

use nalgebra::Vector3;

use super::obstacle::projection;
use super::{Pose, SectionParameters};

/// Below this bend (rad) a section is taken as straight: its end is then less than 1e-15 of its length aside.
const STRAIGHT_RAD: f64 = 1e-15;

/// A segment whose share within the plane of the arc is below this square is taken as normal to that plane: within it, the
/// whole segment moves by less than 1e-15 of its length.
const NORMAL_SHARE: f64 = 1e-30;

/// Nearer to the circle's axis than this, in radii, a point counts as on it: squares of smaller numbers underflow.
const CENTRE: f64 = 1e-100;

/// Newton's method ends when a step moves the point on the segment by less than this (m). It converges at least as fast as for a
/// triple root, by a third per step, so what remains is at most two such steps.
const STEP_M: f64 = 1e-12;

/// Bound on the steps from each end. Over 300 000 random segments both ends together took 3.4, a single one 21 at most. A
/// double root gains 2⁻⁴⁰; at a triple root, where the distance depends on the fourth power of what remains, (2/3)⁴⁰ = 9e-8 of
/// the segment is left.
const STEPS_MAX: usize = 40;

/// One section of the body: every point within `radius_m` of its arc.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Tube {
    start_m: Vector3<f64>,
    end_m: Vector3<f64>,
    /// Unit vectors in the base frame: towards the bend, normal to the plane of the arc, along the start, along the end.
    across: Vector3<f64>,
    normal: Vector3<f64>,
    along: Vector3<f64>,
    end_along: Vector3<f64>,
    bend_rad: f64,
    length_m: f64,
    curvature_1_m: f64,
    pub(super) radius_m: f64,
}

/// Where on the backbone a given point is nearest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Foot {
    /// Share of the section's length, in [0, 1].
    pub(super) s: f64,
    /// In the base frame (m).
    pub(super) point_m: Vector3<f64>,
    /// Direction of the backbone there, a unit vector.
    pub(super) tangent: Vector3<f64>,
}

impl Tube {
    /// A section between two frames of the robot, bent by (u, v) (rad).
    pub(super) fn new(
        start: &Pose,
        end: &Pose,
        section: &SectionParameters,
        [u, v]: [f64; 2],
    ) -> Self {
        let theta = (u * u + v * v).sqrt();
        // Not "below": a NaN has to stay one.
        let straight = theta < STRAIGHT_RAD;
        let (bend_rad, cos, sin) = if straight {
            (0.0, 1.0, 0.0)
        } else {
            (theta, u / theta, v / theta)
        };
        let [x, y, z] = [0, 1, 2].map(|axis| Vector3::from(start.rotation.column(axis)));
        Self {
            start_m: start.position_m,
            end_m: end.position_m,
            across: x * cos + y * sin,
            normal: y * cos - x * sin,
            along: z,
            end_along: end.rotation.column(2).into(),
            bend_rad,
            length_m: section.length_m,
            curvature_1_m: bend_rad / section.length_m,
            radius_m: section.body_radius_m,
        }
    }

    /// A ball that contains the arc: centre (m) and radius (m). Up to θ = π the chord is a diameter of one; any curve stays
    /// within half its length of the middle of its chord.
    #[inline]
    pub(super) fn ball(&self) -> (Vector3<f64>, f64) {
        let radius_m = if self.bend_rad <= PI {
            0.5 * (self.end_m - self.start_m).norm()
        } else {
            0.5 * self.length_m
        };
        ((self.start_m + self.end_m) * 0.5, radius_m)
    }

    /// Normal to the plane of the arc, a unit vector in the base frame; of a straight section, some normal.
    pub(super) fn normal(&self) -> Vector3<f64> {
        self.normal
    }

    /// Distance from a point (base frame, m) to the arc (m). Bounded work: two square roots.
    #[inline]
    pub(super) fn distance_m(&self, point_m: &Vector3<f64>) -> f64 {
        let local = self.local(point_m - self.start_m);
        if self.faces(point_m, local.z) {
            let (q, _) = in_plane(self.curvature_1_m, &local);
            (q * q + local.y * local.y).sqrt()
        } else {
            let [start, end] = self.end_squares(point_m);
            // Not f64::min, which drops a NaN.
            if start < end { start } else { end }.sqrt()
        }
    }

    /// The nearest point of the arc; at the circle's centre, where all are equally near, one of its ends.
    pub(super) fn foot(&self, point_m: &Vector3<f64>) -> Foot {
        let local = self.local(point_m - self.start_m);
        let (_, h) = in_plane(self.curvature_1_m, &local);
        if h < CENTRE || !self.faces(point_m, local.z) {
            return self.nearer_end(point_m);
        }
        let cos = (1.0 - self.curvature_1_m * local.x) / h;
        let sin = self.curvature_1_m * local.z / h;
        let s = if self.bend_rad > 0.0 {
            let a = sin.atan2(cos);
            (if a < 0.0 { a + TAU } else { a }) / self.bend_rad
        } else {
            local.z / self.length_m
        };
        if !(0.0..=1.0).contains(&s) {
            // By rounding: just beyond an end, or so near the centre that its side of a plane does not tell the angle.
            return self.nearer_end(point_m);
        }
        // x = (1 - cos a)/κ, written so that nothing cancels near straight; unlike (q + x)/H it holds near the centre too.
        let z_m = local.z / h;
        let x_m = if cos > 0.0 {
            z_m * sin / (1.0 + cos)
        } else {
            (1.0 - cos) / self.curvature_1_m
        };
        Foot {
            s,
            point_m: self.start_m + self.across * x_m + self.along * z_m,
            tangent: self.across * sin + self.along * cos,
        }
    }

    /// The end of the arc that is nearer to a point; of two equally near, the start.
    fn nearer_end(&self, point_m: &Vector3<f64>) -> Foot {
        let [start, end] = self.end_squares(point_m);
        let (s, point_m, tangent) = if start <= end {
            (0.0, self.start_m, self.along)
        } else {
            (1.0, self.end_m, self.end_along)
        };
        Foot {
            s,
            point_m,
            tangent,
        }
    }

    /// Share t ∈ [0, 1] of the segment start + t span (m, base frame) at which it is nearest to the arc, and that distance (m):
    /// exact to 1e-12 m beside rounding. Bounded work: at most [`STEPS_MAX`] Newton steps from either end.
    pub(super) fn nearest_on_segment(
        &self,
        start_m: &Vector3<f64>,
        span_m: &Vector3<f64>,
    ) -> (f64, f64) {
        let line = Line {
            curvature_1_m: self.curvature_1_m,
            start: self.local(start_m - self.start_m),
            span: self.local(*span_m),
        };
        let middle = line.nearest_to_axis();
        let mut best = (0.0, self.distance_m(start_m));
        for t in [
            1.0,
            projection(&self.start_m, start_m, span_m),
            projection(&self.end_m, start_m, span_m),
            line.descend(0.0, middle),
            line.descend(1.0, middle),
        ] {
            // The start was first: most candidates are one of the segment's ends.
            if t == 0.0 {
                continue;
            }
            let distance_m = self.distance_m(&(start_m + span_m * t));
            // A NaN replaces what was found: it must not be lost.
            if distance_m < best.1 || distance_m.is_nan() {
                best = (t, distance_m);
            }
        }
        best
    }

    /// A vector of the base frame in the section's own axes.
    #[inline]
    fn local(&self, vector: Vector3<f64>) -> Vector3<f64> {
        Vector3::new(
            vector.dot(&self.across),
            vector.dot(&self.normal),
            vector.dot(&self.along),
        )
    }

    /// Whether the circle's nearest point belongs to the arc: its angle is in [0, θ]. `z` is the point's height over the
    /// start.
    #[inline]
    fn faces(&self, point_m: &Vector3<f64>, z: f64) -> bool {
        let after_start = z >= 0.0;
        let before_end = (point_m - self.end_m).dot(&self.end_along) <= 0.0;
        if self.bend_rad <= PI {
            after_start && before_end
        } else {
            after_start || before_end || self.bend_rad >= TAU
        }
    }

    /// Squares of the distances to start and end (m²).
    #[inline]
    fn end_squares(&self, point_m: &Vector3<f64>) -> [f64; 2] {
        [self.start_m, self.end_m].map(|end_m| (point_m - end_m).norm_squared())
    }
}

/// (q, H) of a point in the axes of a section of this curvature (1/m).
#[inline]
fn in_plane(curvature_1_m: f64, local: &Vector3<f64>) -> (f64, f64) {
    let (x, z) = (local.x, local.z);
    let (big_x, big_z) = (1.0 - curvature_1_m * x, curvature_1_m * z);
    let h = (big_x * big_x + big_z * big_z).sqrt();
    let q = (curvature_1_m * (x * x + z * z) - 2.0 * x) / (h + 1.0);
    (q, h)
}

/// A segment start + t span, 0 ≤ t ≤ 1, in the axes of a section (m).
struct Line {
    curvature_1_m: f64,
    start: Vector3<f64>,
    span: Vector3<f64>,
}

impl Line {
    /// G' and G'' at t (m²). G'' as q'² + q q'' + y'², which does not cancel where the section is straight.
    fn derivatives(&self, t: f64) -> (f64, f64) {
        let (local, span) = (self.start + self.span * t, &self.span);
        let (q, h) = in_plane(self.curvature_1_m, &local);
        // On the circle's axis G has a kink, a local maximum within the plane: any finite slope will do there.
        let h = h.max(f64::EPSILON);
        let (big_x, big_z) = (
            1.0 - self.curvature_1_m * local.x,
            self.curvature_1_m * local.z,
        );
        let q_slope = (big_z * span.z - big_x * span.x) / h;
        let c = big_x * span.z + big_z * span.x;
        let q_curvature = self.curvature_1_m * c * c / (h * h * h);
        (
            q * q_slope + local.y * span.y,
            q_slope * q_slope + q * q_curvature + span.y * span.y,
        )
    }

    /// The t in [0, 1] nearest to the circle's axis, where G'' is least; any where G'' is constant.
    fn nearest_to_axis(&self) -> f64 {
        let (kappa, span) = (self.curvature_1_m, &self.span);
        let in_plane_square = span.x * span.x + span.z * span.z;
        if kappa == 0.0 || in_plane_square <= NORMAL_SHARE * span.norm_squared() {
            return 1.0;
        }
        let (big_x, big_z) = (1.0 - kappa * self.start.x, kappa * self.start.z);
        ((big_x * span.x - big_z * span.z) / (kappa * in_plane_square)).clamp(0.0, 1.0)
    }

    /// The minimum of G between `from`, an end of the segment, and `middle`, the t nearest to the circle's axis, if there is one;
    /// else some t between. G'' falls on the way, so Newton's steps stay short of the minimum: it lies where G is convex, and
    /// where G is not, there is none to be found.
    fn descend(&self, from: f64, middle: f64) -> f64 {
        let length_m = self.span.norm();
        let mut t = from;
        for _ in 0..STEPS_MAX {
            let (slope, curvature) = self.derivatives(t);
            let step = -slope / curvature;
            let forward = step * (middle - from) > 0.0;
            if !forward {
                break;
            }
            if step.abs() >= (middle - t).abs() {
                return middle;
            }
            t += step;
            if step.abs() * length_m < STEP_M {
                break;
            }
        }
        t
    }
}
