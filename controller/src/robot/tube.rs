//! Exact distance of one section from a point and from a segment (§3 of docs/model.md), for W configurations side by side.
//!
//! Axes of the section: x towards its bend, y normal to the plane of its arc, z along its start. With curvature κ = θ/l the arc belongs to
//! a circle around (1/κ, 0, 0). In units of its radius, a point is at V = (X, Z) = (1 - κx, κz) from the centre, H = |V|, and
//! ```text
//! q = H/κ - 1/κ = (κ (x² + z²) - 2x) / (H + 1)      signed distance from the circle within the plane
//! d = √(q² + y²)                                    distance from the circle
//! a = atan2(Z, X)                                   angle of the circle's nearest point from the start
//! ```
//! None of these divides by κ or cancels as κ → 0, so the straight section is not a special case. For θ ≤ π, the foot is on the arc if the
//! point lies between the planes across its two ends. Otherwise the nearer end is the nearest point.
//!
//! **Segment.** Along a line with velocity (x', y', z') of square L² = x'² + y'² + z'², G = d²/2 has
//! ```text
//! G'  = q q' + y y',   q' = (Z z' - X x') / H
//! G'' = L² - c²/H³,    c = X z' + Z x'   (constant along a line: twice the area swept about the centre, per time)
//! ```
//! H is the norm of a linear function, least where the line is nearest to the circle's axis; G'' falls up to that point and rises after it.
//! So G is convex, then possibly concave, then convex, and has at most one minimum on either side. Newton's method finds each minimum from
//! its end of the segment. As G'' falls along the search, no step passes the minimum. Where the nearest point of the arc is one of its
//! ends, the segment's nearest point is a projection. No minimum can be missed; nothing is sampled.
//!
//! **Lanes.** There are no branches between lanes: both cases are computed and one is selected. A lane whose search has ended keeps its
//! value until the other searches end. Each lane's bits therefore depend on that lane alone, and W = 1 is the scalar reference.

use core::f64::consts::{PI, TAU};

use nalgebra::Vector3;

use super::SectionParameters;
use super::chord::Chord;
use super::lanes::{Frame, WideVector};
use super::obstacle::Axis;
use crate::wide::{Wide, any, both, either, not};

/// Below this bend (rad) a section is taken as straight: its end then deviates by less than 1e-15 of its length.
const STRAIGHT_RAD: f64 = 1e-15;

/// If the squared share of a segment within the plane of the arc is below this, the segment is taken as normal to that plane. Within the
/// plane, the whole segment then moves by less than 1e-15 of its length.
const NORMAL_SHARE: f64 = 1e-30;

/// Below this distance from the circle's axis, in radii, a point counts as on the axis: squares of smaller numbers underflow.
pub(super) const CENTRE: f64 = 1e-100;

/// Newton's method ends when a step moves the point on the segment by less than this (m), or when the remaining change of the distance is
/// less. Convergence is at least that of a triple root, by a third per step, so the remaining error is at most two such steps.
const STEP_M: f64 = 1e-12;

/// After a step of s (m), the distance d (m) can fall by at most this times s²/d. Along two more steps G = d²/2 falls by at most |G'| · 2s
/// ≤ 2s², and the step itself at most halved d.
const STEP_LEFT: f64 = 8.0;

/// Bound on the steps from each end. Over 300 000 random segments, both ends together took 3.4 steps on average to reach [`STEP_M`], and a
/// single end at most 21. A double root gains 2⁻⁴⁰. At a triple root, where the distance depends on the fourth power of the remaining
/// error, (2/3)⁴⁰ = 9e-8 of the segment remains.
const STEPS_MAX: usize = 40;

/// One section of W bodies: every point within `radius_m` of its arc.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Tube<const W: usize> {
    start_m: WideVector<W>,
    end_m: WideVector<W>,
    /// Unit vectors in the base frame: towards the bend, normal to the plane of the arc, along the start, along the end.
    across: WideVector<W>,
    normal: WideVector<W>,
    along: WideVector<W>,
    end_along: WideVector<W>,
    bend_rad: Wide<W>,
    curvature_1_m: Wide<W>,
    length_m: f64,
    pub(super) radius_m: f64,
}

/// The point of the backbone nearest to a given point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Foot {
    /// Share of the section's length, in [0, 1].
    pub(super) s: f64,
    /// In the base frame (m).
    pub(super) point_m: Vector3<f64>,
    /// Direction of the backbone there, a unit vector.
    pub(super) tangent: Vector3<f64>,
}

/// A ball that contains an arc from `start_m` to `end_m` of `length_m` and squared bend `w` (rad²): centre (m) and radius (m). Up to θ = π
/// the chord is a diameter of a ball that contains the arc. Any curve lies within half its length of the midpoint of its chord.
#[inline(always)]
pub(super) fn ball<const W: usize>(
    start_m: &WideVector<W>,
    end_m: &WideVector<W>,
    length_m: f64,
    w: Wide<W>,
) -> (WideVector<W>, Wide<W>) {
    let half = Wide::splat(0.5);
    let half_chord_m = (*end_m - *start_m).norm_squared().sqrt() * half;
    let up_to_half_a_circle = w.less_or_equal(Wide::splat(PI * PI));
    let radius_m = half_chord_m.select(Wide::splat(0.5 * length_m), up_to_half_a_circle);
    ((*start_m + *end_m) * half, radius_m)
}

impl<const W: usize> Tube<W> {
    /// A section between two frames of the robot, bent by (u, v) (rad).
    #[inline(always)]
    pub(super) fn new(
        start: &Frame<W>,
        end: &Frame<W>,
        section: &SectionParameters,
        [u, v]: [Wide<W>; 2],
    ) -> Self {
        let (zero, one) = (Wide::splat(0.0), Wide::splat(1.0));
        let theta = (u * u + v * v).sqrt();
        // `less`, not its negation, so that a NaN stays a NaN.
        let straight = theta.less(Wide::splat(STRAIGHT_RAD));
        let bend_rad = zero.select(theta, straight);
        let (cos, sin) = (
            one.select(u / theta, straight),
            zero.select(v / theta, straight),
        );
        let [x, y, z] = start.axes;
        Self {
            start_m: start.position_m,
            end_m: end.position_m,
            across: x * cos + y * sin,
            normal: y * cos - x * sin,
            along: z,
            end_along: end.axes[2],
            bend_rad,
            curvature_1_m: bend_rad / Wide::splat(section.length_m),
            length_m: section.length_m,
            radius_m: section.body_radius_m,
        }
    }

    /// The [`ball`] around this section.
    #[inline(always)]
    pub(super) fn ball(&self) -> (WideVector<W>, Wide<W>) {
        let w = self.bend_rad * self.bend_rad;
        ball(&self.start_m, &self.end_m, self.length_m, w)
    }

    /// Nearest point of an axis to the arc, as a share t ∈ [0, 1] of its span, and the distance (m). Exact up to rounding for a point; up
    /// to 1e-12 m and rounding for a segment.
    #[inline(always)]
    pub(super) fn nearest(&self, axis: &Axis) -> (Wide<W>, Wide<W>) {
        let (t, square_m2) = if axis.is_point() {
            let square_m2 = self.square_m2(&WideVector::splat(&axis.start_m));
            (Wide::splat(0.0), square_m2)
        } else {
            self.nearest_on_segment(axis)
        };
        (t, square_m2.sqrt())
    }

    /// Squared distance from a point (base frame, m) to the arc (m²). Bounded work: one root, one division.
    #[inline(always)]
    fn square_m2(&self, point_m: &WideVector<W>) -> Wide<W> {
        let after_start_m = *point_m - self.start_m;
        let after_end_m = *point_m - self.end_m;
        let local = self.local(&after_start_m);
        let [_, y, z] = local.0;
        let (q_h, h) = in_plane(self.curvature_1_m, &local);
        let q = q_h / (h + 1.0);
        let (start, end) = (after_start_m.norm_squared(), after_end_m.norm_squared());
        (q * q + y * y).select(
            start.min_or_nan(end),
            on_arc(self.bend_rad, z, after_end_m.dot(&self.end_along)),
        )
    }

    /// [`Self::nearest`] for a segment, with the squared distance (m²). Bounded work: at most [`STEPS_MAX`] Newton steps from either end.
    ///
    /// The nearest point of the arc is one of its ends, or that of its circle. In the second case, the nearest point of the segment is one
    /// of its ends or a minimum of the distance to the circle.
    #[inline(always)]
    fn nearest_on_segment(&self, axis: &Axis) -> (Wide<W>, Wide<W>) {
        let (mut t, mut square_m2) = to_point(axis, &self.start_m);
        let [first, second, third, fourth] = self.line(axis).nearest_to_circle();
        let candidates = [to_point(axis, &self.end_m), first, second, third, fourth];
        for i in 0..candidates.len() {
            let (candidate, found_m2) = candidates[i];
            // A NaN replaces the result, so that it is not lost.
            let nearer = either(found_m2.less(square_m2), found_m2.is_nan());
            t = candidate.select(t, nearer);
            square_m2 = found_m2.select(square_m2, nearer);
        }
        (t, square_m2)
    }

    #[inline(always)]
    fn line(&self, axis: &Axis) -> Segments<W> {
        let start_m = WideVector::splat(&axis.start_m);
        let span_m = WideVector::splat(&axis.span_m);
        Segments {
            bend_rad: self.bend_rad,
            curvature_1_m: self.curvature_1_m,
            start: self.local(&(start_m - self.start_m)),
            span: self.local(&span_m),
            end_rise_m: [
                (start_m - self.end_m).dot(&self.end_along),
                span_m.dot(&self.end_along),
            ],
            length_m: axis.length_m,
        }
    }

    /// Transforms a vector from the base frame to the section's axes.
    #[inline(always)]
    fn local(&self, vector: &WideVector<W>) -> WideVector<W> {
        WideVector([
            vector.dot(&self.across),
            vector.dot(&self.normal),
            vector.dot(&self.along),
        ])
    }
}

impl Tube<1> {
    pub(super) fn chord(&self) -> Chord {
        let ends_m = [self.start_m, self.end_m].map(|end_m| end_m.narrow());
        let axes = [self.along, self.across].map(|axis| axis.narrow());
        let Wide([bend_rad]) = self.bend_rad;
        Chord::new(ends_m, axes, self.length_m, bend_rad)
    }

    /// Least value of direction · point along the arc (m), for up to half a circle; NaN for more, and for a NaN in the bends. Along the
    /// arc, the slope changes sign at most once. If it changes from falling to rising, the minimum is that of the whole circle: R (x - √(x²
    /// + z²)) from the start, for components x across and z along of the direction.
    pub(super) fn least_along_m(&self, direction: &Vector3<f64>) -> f64 {
        let (Wide([bend_rad]), Wide([curvature_1_m])) = (self.bend_rad, self.curvature_1_m);
        if bend_rad > PI || bend_rad.is_nan() {
            return f64::NAN;
        }
        let [start_m, end_m, across, along, end_along] = [
            &self.start_m,
            &self.end_m,
            &self.across,
            &self.along,
            &self.end_along,
        ]
        .map(|vector| direction.dot(&vector.narrow()));
        if along < 0.0 && end_along > 0.0 {
            let root = (across * across + along * along).sqrt();
            let below = if across > 0.0 {
                along * along / (across + root)
            } else {
                root - across
            };
            return start_m - below / curvature_1_m;
        }
        start_m.min(end_m)
    }

    /// Unit normal to the plane of the arc in the base frame; for a straight section, any normal.
    pub(super) fn normal(&self) -> Vector3<f64> {
        self.normal.narrow()
    }

    /// The nearest point of the arc; at the circle's centre, where all are equally near, one of its ends.
    pub(super) fn foot(&self, point_m: &Vector3<f64>) -> Foot {
        let point = WideVector::splat(point_m);
        let local = self.local(&(point - self.start_m));
        let (_, Wide([h])) = in_plane(self.curvature_1_m, &local);
        let end_z_m = (point - self.end_m).dot(&self.end_along);
        let [on_arc] = on_arc(self.bend_rad, local.0[2], end_z_m);
        if h < CENTRE || !on_arc {
            return self.nearer_end(&point);
        }
        let (Wide([curvature_1_m]), Wide([bend_rad])) = (self.curvature_1_m, self.bend_rad);
        let local = local.narrow();
        let cos = (1.0 - curvature_1_m * local.x) / h;
        let sin = curvature_1_m * local.z / h;
        let s = if bend_rad > 0.0 {
            let a = sin.atan2(cos);
            (if a < 0.0 { a + TAU } else { a }) / bend_rad
        } else {
            local.z / self.length_m
        };
        if !(0.0..=1.0).contains(&s) {
            // Rounding: just beyond an end, or so near the centre that the side of a plane does not determine the angle.
            return self.nearer_end(&point);
        }
        // x = (1 - cos a)/κ, in a form that does not cancel near straight; unlike (q + x)/H it also holds near the centre.
        let z_m = local.z / h;
        let x_m = if cos > 0.0 {
            z_m * sin / (1.0 + cos)
        } else {
            (1.0 - cos) / curvature_1_m
        };
        let (across, along) = (self.across.narrow(), self.along.narrow());
        Foot {
            s,
            point_m: self.start_m.narrow() + across * x_m + along * z_m,
            tangent: across * sin + along * cos,
        }
    }

    /// Vector from a point to the nearest point of the arc (m): that of [`Self::foot`], without the angle.
    pub(super) fn vector_from_m(&self, point_m: &Vector3<f64>) -> Vector3<f64> {
        let point = WideVector::splat(point_m);
        let local = self.local(&(point - self.start_m));
        let (Wide([q_h]), Wide([h])) = in_plane(self.curvature_1_m, &local);
        let [on_arc] = on_arc(
            self.bend_rad,
            local.0[2],
            (point - self.end_m).dot(&self.end_along),
        );
        if h < CENTRE || !on_arc {
            return self.nearer_end(&point).point_m - point_m;
        }
        let (Wide([curvature_1_m]), local) = (self.curvature_1_m, local.narrow());
        // Away from the centre of the circle: (-X, Z)/H.
        let outwards = q_h / (h * (h + 1.0));
        let across_m = outwards * (1.0 - curvature_1_m * local.x);
        let along_m = -outwards * curvature_1_m * local.z;
        self.across.narrow() * across_m + self.along.narrow() * along_m
            - self.normal.narrow() * local.y
    }

    /// The end of the arc nearer to a point; the start if both are equally near.
    fn nearer_end(&self, point_m: &WideVector<1>) -> Foot {
        let [start, end] = [self.start_m, self.end_m].map(|end| (*point_m - end).norm_squared());
        let [start_nearer] = start.less_or_equal(end);
        let (s, point_m, tangent) = if start_nearer {
            (0.0, self.start_m, self.along)
        } else {
            (1.0, self.end_m, self.end_along)
        };
        Foot {
            s,
            point_m: point_m.narrow(),
            tangent: tangent.narrow(),
        }
    }
}

/// (q (H + 1), H) of a point in the axes of a section of this curvature (1/m).
#[inline(always)]
fn in_plane<const W: usize>(kappa: Wide<W>, local: &WideVector<W>) -> (Wide<W>, Wide<W>) {
    let [x, _, z] = local.0;
    let (big_x, big_z) = (Wide::splat(1.0) - kappa * x, kappa * z);
    let h = (big_x * big_x + big_z * big_z).sqrt();
    (kappa * (x * x + z * z) - (x + x), h)
}

/// Nearest point of the axis to a point, as a share t, and the squared distance (m²).
#[inline(always)]
fn to_point<const W: usize>(axis: &Axis, point_m: &WideVector<W>) -> (Wide<W>, Wide<W>) {
    let t = axis.share(point_m);
    (t, (axis.point(t) - *point_m).norm_squared())
}

/// True if the circle's nearest point belongs to the arc: its angle is in [0, θ]. `z_m` is the point's height over the plane across the
/// start, `end_z_m` over that across the end.
#[inline(always)]
fn on_arc<const W: usize>(bend_rad: Wide<W>, z_m: Wide<W>, end_z_m: Wide<W>) -> [bool; W] {
    let zero = Wide::splat(0.0);
    let after_start = zero.less_or_equal(z_m);
    let before_end = end_z_m.less_or_equal(zero);
    // Up to half a circle both conditions must hold, beyond it one of them; for a full circle none.
    let more_than_half = not(bend_rad.less_or_equal(Wide::splat(PI)));
    let full = Wide::splat(TAU).less_or_equal(bend_rad);
    let one_holds = either(either(after_start, before_end), full);
    either(
        both(after_start, before_end),
        both(more_than_half, one_holds),
    )
}

/// A segment start + t span, 0 ≤ t ≤ 1, in the axes of W sections (m).
struct Segments<const W: usize> {
    bend_rad: Wide<W>,
    curvature_1_m: Wide<W>,
    start: WideVector<W>,
    span: WideVector<W>,
    /// Height of the segment's start over the section's end, and the height difference along the span.
    end_rise_m: [Wide<W>; 2],
    length_m: f64,
}

impl<const W: usize> Segments<W> {
    /// The ends of the segment and the minimum of the circle's distance found from each. Each has the squared distance (m²) if the circle's
    /// nearest point is on the arc, else infinity. For W = 1 both searches run side by side in two lanes, with the same bits.
    #[inline(always)]
    fn nearest_to_circle(&self) -> [(Wide<W>, Wide<W>); 4] {
        let (zero, one) = (Wide::splat(0.0), Wide::splat(1.0));
        let middle = self.nearest_to_axis();
        if W > 1 {
            let (from_start, from_end) = (
                self.find_minimum(zero, middle),
                self.find_minimum(one, middle),
            );
            return [
                (zero, self.circle_m2(zero)),
                (one, self.circle_m2(one)),
                (from_start, self.circle_m2(from_start)),
                (from_end, self.circle_m2(from_end)),
            ];
        }
        let line = self.duplicated();
        let ends = Wide([0.0, 1.0]);
        let found = line.find_minimum(ends, Wide::splat(middle.0[0]));
        let (Wide(at_ends), Wide(at_found)) = (line.circle_m2(ends), line.circle_m2(found));
        let Wide([from_start, from_end]) = found;
        [
            (zero, Wide::splat(at_ends[0])),
            (one, Wide::splat(at_ends[1])),
            (Wide::splat(from_start), Wide::splat(at_found[0])),
            (Wide::splat(from_end), Wide::splat(at_found[1])),
        ]
    }

    /// The first lane, in both of two lanes.
    #[inline(always)]
    fn duplicated(&self) -> Segments<2> {
        let wide = |x: Wide<W>| Wide::<2>::splat(x.0[0]);
        let vector = |vector: &WideVector<W>| WideVector(vector.0.map(wide));
        Segments {
            bend_rad: wide(self.bend_rad),
            curvature_1_m: wide(self.curvature_1_m),
            start: vector(&self.start),
            span: vector(&self.span),
            end_rise_m: self.end_rise_m.map(wide),
            length_m: self.length_m,
        }
    }

    /// Squared distance from the circle at t (m²); infinite if its nearest point is not on the arc.
    #[inline(always)]
    fn circle_m2(&self, t: Wide<W>) -> Wide<W> {
        let local = self.start + self.span * t;
        let [_, y, z] = local.0;
        let (q_h, h) = in_plane(self.curvature_1_m, &local);
        let q = q_h / (h + 1.0);
        let [end_z, end_slope] = self.end_rise_m;
        let on_arc = on_arc(self.bend_rad, z, end_z + end_slope * t);
        (q * q + y * y).select(Wide::splat(f64::INFINITY), on_arc)
    }

    /// d², G' and G'' at t (m²). G'' is computed as q'² + q q'' + y'², which does not cancel for a straight section.
    #[inline(always)]
    fn derivatives(&self, t: Wide<W>) -> [Wide<W>; 3] {
        let (kappa, local) = (self.curvature_1_m, self.start + self.span * t);
        let ([x, y, z], [x_slope, y_slope, z_slope]) = (local.0, self.span.0);
        let (q_h, h) = in_plane(kappa, &local);
        // On the circle's axis G has a kink, a local maximum within the plane, where any finite slope is valid.
        let h = h.max(Wide::splat(f64::EPSILON));
        // One division for both 1/H and 1/(H + 1).
        let per_both = Wide::splat(1.0) / (h * (h + 1.0));
        let (per_h, q) = (per_both * (h + 1.0), q_h * (per_both * h));
        let (big_x, big_z) = (Wide::splat(1.0) - kappa * x, kappa * z);
        let q_slope = (big_z * z_slope - big_x * x_slope) * per_h;
        let c = (big_x * z_slope + big_z * x_slope) * per_h;
        let q_curvature = kappa * (c * c) * per_h;
        [
            q * q + y * y,
            q * q_slope + y * y_slope,
            q_slope * q_slope + q * q_curvature + y_slope * y_slope,
        ]
    }

    /// The t in [0, 1] nearest to the circle's axis, where G'' is least; 1 if G'' is constant.
    #[inline(always)]
    fn nearest_to_axis(&self) -> Wide<W> {
        let (zero, one, kappa) = (Wide::splat(0.0), Wide::splat(1.0), self.curvature_1_m);
        let ([x, _, z], [x_slope, _, z_slope]) = (self.start.0, self.span.0);
        let in_plane_square = x_slope * x_slope + z_slope * z_slope;
        let normal = in_plane_square.less_or_equal(self.span.norm_squared() * NORMAL_SHARE);
        let constant = either(kappa.less_or_equal(zero), normal);
        let (big_x, big_z) = (one - kappa * x, kappa * z);
        let t = (big_x * x_slope - big_z * z_slope) / (kappa * in_plane_square);
        one.select(t.clamp(0.0, 1.0), constant)
    }

    /// The minimum of G between `from`, an end of the segment, and `middle`, the t nearest to the circle's axis. If there is none, some t
    /// between. G'' falls along the search, so Newton's steps stay short of the minimum. A minimum lies where G is convex; where G is
    /// concave, there is none.
    #[inline(always)]
    fn find_minimum(&self, from: Wide<W>, middle: Wide<W>) -> Wide<W> {
        let (mut t, mut searching) = (from, [true; W]);
        for _ in 0..STEPS_MAX {
            let [square_m2, slope, curvature] = self.derivatives(t);
            let step = -slope / curvature;
            let forward = Wide::splat(0.0).less(step * (middle - from));
            let moving = both(searching, forward);
            let passes = (middle - t).abs().less_or_equal(step.abs());
            t = middle.select(t + step, passes).select(t, moving);
            let step_m = step * self.length_m;
            let left_m2 = step_m * step_m * STEP_LEFT;
            let is_near = (left_m2 * left_m2).less(square_m2 * (STEP_M * STEP_M));
            let small = either(step_m.abs().less(Wide::splat(STEP_M)), is_near);
            searching = both(moving, not(either(passes, small)));
            if !any(searching) {
                break;
            }
        }
        t
    }
}
