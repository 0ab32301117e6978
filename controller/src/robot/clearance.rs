//! Clearance of the body from an obstacle, its place, and its derivative by the bends (§3 of docs/model.md).
//!
//! The body is every point within a section's `body_radius_m` of that section's arc, so its ends and its steps in
//! radius are round. Distances are exact, not sampled: 10 points per section would overestimate them by up to 14.7 mm.
//!
//! A solver makes one [`Body`] per state and evaluates many obstacles with it; [`Robot::reaches`] first excludes those
//! that are too far away to matter. The gradient of a clearance is `direction · J`, with J from [`Robot::body_motion`]
//! at the nearest point. The motion of the nearest point along the body is of second order. Where two points are
//! equally near, the result is the gradient of one of them.

use std::borrow::Cow;

use nalgebra::Vector3;

use super::chord::Chord;
use super::lanes::Frame;
use super::obstacle::{Axis, Obstacle};
use super::tube::{Foot, Tube};
use super::{Configuration, Pose, Robot, SECTIONS_MAX};
use crate::wide::Wide;

/// Below this distance (m) between the backbone and the axis of an obstacle, no direction between them is defined.
const COINCIDENT_M: f64 = 1e-12;

/// Allowance for rounding in a bound on a clearance (m), beside that of the obstacle's coordinates. The longest robot
/// is 60 m, and 60 · 2⁻⁵² m = 1.3e-14 m; [`Body::nearest`] is exact to 1e-12 m for a capsule.
pub(super) const ROUNDING_M: f64 = 2e-12;

/// The place of the body that is nearest to an obstacle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Nearest {
    /// Distance between the surfaces (m): that of backbone and axis, less both radii. Negative inside.
    pub clearance_m: f64,
    /// Section of the body, 0 at the base.
    pub section: usize,
    /// Share of that section's length from its start, in [0, 1]: the argument of [`Robot::body_point`].
    pub s: f64,
    /// The point of the backbone (m, base frame).
    pub point_m: Vector3<f64>,
    /// Unit vector from the obstacle's axis to that point: the direction of increasing clearance. Where backbone and
    /// axis meet, it is normal to both. If they meet in parallel, or the obstacle is a ball, it is normal to the plane
    /// of the arc.
    pub direction: Vector3<f64>,
}

/// The body in one state, prepared for many obstacles. 1.5 kB in fixed arrays, no heap.
///
/// A NaN in the bends makes every clearance NaN, never a large number: `clearance_m >= required_m` is then false.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Body {
    /// The first `section_count` are used; the rest repeat the last.
    tubes: [Tube<1>; SECTIONS_MAX],
    chords: [Chord; SECTIONS_MAX],
    section_count: usize,
}

/// The section and the point of an obstacle's axis between which the clearance is least.
pub(crate) struct Closest {
    /// As [`Nearest::clearance_m`] (m).
    pub(crate) clearance_m: f64,
    section: usize,
    /// Point of the obstacle's axis (m, base frame).
    axis_m: Vector3<f64>,
}

impl Body {
    /// The place of the body nearest to an obstacle; one of several if equally near.
    ///
    /// Exact up to rounding; for a capsule, up to 1e-12 m and rounding. Bounded work: a few square roots for each
    /// section, and at most 80 Newton steps more for a capsule. Sections whose bound exceeds the least clearance found
    /// are skipped.
    pub fn nearest(&self, obstacle: &Obstacle) -> Nearest {
        self.nearest_from(&self.closest(obstacle), obstacle)
    }

    /// As [`Self::nearest`], for one section, from 0.
    pub fn nearest_of(&self, section: usize, obstacle: &Obstacle) -> Nearest {
        self.nearest_from(&self.closest_of(section, obstacle), obstacle)
    }

    /// All fields of the place that [`Self::closest_of`] found.
    pub(crate) fn nearest_from(&self, closest: &Closest, obstacle: &Obstacle) -> Nearest {
        let tube = &self.tubes[closest.section];
        let foot = tube.foot(&closest.axis_m);
        let apart = foot.point_m - closest.axis_m;
        let distance_m = apart.norm();
        Nearest {
            clearance_m: closest.clearance_m,
            section: closest.section,
            s: foot.s,
            point_m: foot.point_m,
            direction: if distance_m > COINCIDENT_M {
                apart / distance_m
            } else {
                direction_where_axes_meet(tube, &foot, &obstacle.axis().span_m)
            },
        }
    }

    /// [`Nearest::clearance_m`] (m) alone, at a slightly lower cost.
    pub fn clearance_m(&self, obstacle: &Obstacle) -> f64 {
        self.closest(obstacle).clearance_m
    }

    /// Least clearance from several obstacles (m): infinite for none, NaN for a NaN in the bends. Obstacles farther
    /// away than the least clearance found cost very little.
    pub fn least_clearance_m(&self, obstacles: impl IntoIterator<Item = Obstacle>) -> f64 {
        let mut least_m = f64::INFINITY;
        for obstacle in obstacles {
            if self.reaches(&obstacle, least_m) {
                let clearance_m = self.clearance_m(&obstacle);
                if clearance_m.is_nan() {
                    return clearance_m;
                }
                least_m = least_m.min(clearance_m);
            }
        }
        least_m
    }

    /// True if the body may be within `travel_m` (m) of the obstacle: a cheap, conservative test by balls around the
    /// sections. If false, the clearance is above `travel_m`; if true, it may be above, too. Pass the safe distance
    /// plus the motion of body and obstacle over the horizon. True for a NaN.
    pub fn reaches(&self, obstacle: &Obstacle, travel_m: f64) -> bool {
        let axis = obstacle.axis();
        let radius_m = obstacle.radius_m();
        self.tubes()
            .iter()
            .any(|tube| !is_beyond(clearance_min_m(tube, axis, radius_m), axis, travel_m))
    }

    /// Sections that may be within `travel_m[j]` (m) of the obstacle: bit j is clear only if the clearance of section j
    /// is certainly above that. Tested by balls, then by the exact distance; a NaN sets the bit. Pass the safe distance
    /// plus the motion of the section ([`Robot::travel_m`]) and of the obstacle.
    pub fn sections_in_reach(&self, obstacle: &Obstacle, travel_m: &[f64; SECTIONS_MAX]) -> u8 {
        let clearances_m = self.clearances_in_reach(obstacle, travel_m);
        let bit = |j: usize| u8::from(clearances_m[j] != f64::INFINITY) << j;
        (0..self.section_count).map(bit).sum()
    }

    /// Clearance of each section (m); infinite for sections that [`Self::sections_in_reach`] excludes and beyond the
    /// last.
    pub fn clearances_in_reach(
        &self,
        obstacle: &Obstacle,
        travel_m: &[f64; SECTIONS_MAX],
    ) -> [f64; SECTIONS_MAX] {
        self.clearances_below(obstacle, travel_m, f64::INFINITY)
    }

    /// As [`Self::clearances_in_reach`], exact where the clearance is below `cutoff_m` (m). Elsewhere it may be a lower
    /// bound of at least `cutoff_m`, which is cheaper for a capsule.
    pub fn clearances_below(
        &self,
        obstacle: &Obstacle,
        travel_m: &[f64; SECTIONS_MAX],
        cutoff_m: f64,
    ) -> [f64; SECTIONS_MAX] {
        let axis = obstacle.axis();
        let mut clearances_m = [f64::INFINITY; SECTIONS_MAX];
        for (j, tube) in self.tubes().iter().enumerate() {
            let least_m = clearance_min_m(tube, axis, obstacle.radius_m());
            if is_beyond(least_m, axis, travel_m[j]) {
                continue;
            }
            if !axis.is_point() {
                let least_m = self.clearance_min_of(j, obstacle);
                if least_m > travel_m[j] {
                    continue;
                }
                if least_m >= cutoff_m {
                    clearances_m[j] = least_m;
                    continue;
                }
            }
            let clearance_m = self.clearance_of(j, obstacle);
            if !is_beyond(clearance_m, axis, travel_m[j]) {
                clearances_m[j] = clearance_m;
            }
        }
        clearances_m
    }

    /// Clearance of one section, from 0 (m).
    pub fn clearance_of(&self, section: usize, obstacle: &Obstacle) -> f64 {
        #[cfg(test)]
        EXACT.set(EXACT.get() + 1);
        self.closest_of(section, obstacle).clearance_m
    }

    /// The direction of [`Nearest`] alone, at a lower cost; not finite where backbone and axis meet.
    pub(crate) fn direction(&self, closest: &Closest) -> Vector3<f64> {
        let tube = &self.tubes[closest.section];
        tube.vector_from_m(&closest.axis_m).normalize()
    }

    /// Lower bound on the clearance of one section, from 0 (m), by its chord. It takes about a fifth of the time of the
    /// exact clearance from a capsule. Minus infinity where no bound is found, and for a NaN in the bends.
    pub fn clearance_min_of(&self, section: usize, obstacle: &Obstacle) -> f64 {
        let axis = obstacle.axis();
        let distance_m = self.chords[section].distance_min_m(axis);
        let radii_m = self.tubes[section].radius_m + obstacle.radius_m();
        distance_m - radii_m - (ROUNDING_M + axis.rounding_m())
    }

    /// Lower bound on the clearance of one section (m) along a unit vector that points away from the obstacle. Tight if
    /// the vector is close to the direction of [`Nearest`], unless the section bends around the obstacle. NaN for more
    /// than half a circle.
    pub fn clearance_min_along(
        &self,
        section: usize,
        obstacle: &Obstacle,
        direction: &Vector3<f64>,
    ) -> f64 {
        let (axis, tube) = (obstacle.axis(), &self.tubes[section]);
        let axis_m = direction.dot(&axis.start_m) + direction.dot(&axis.span_m).max(0.0);
        let radii_m = tube.radius_m + obstacle.radius_m();
        let rounding_m = ROUNDING_M + axis.rounding_m();
        tube.least_along_m(direction) - axis_m - radii_m - rounding_m
    }

    fn tubes(&self) -> &[Tube<1>] {
        &self.tubes[..self.section_count]
    }

    /// The section and the point of the obstacle's axis between which clearance is least.
    fn closest(&self, obstacle: &Obstacle) -> Closest {
        // Starts with the section of the lowest bound, so that most of the others need no search.
        let axis = obstacle.axis();
        let mut bounds_m = [f64::INFINITY; SECTIONS_MAX];
        let mut first = 0;
        for (section, tube) in self.tubes().iter().enumerate() {
            bounds_m[section] = clearance_min_m(tube, axis, obstacle.radius_m());
            if bounds_m[section] < bounds_m[first] {
                first = section;
            }
        }
        let mut best = self.closest_of(first, obstacle);
        for section in 0..self.section_count {
            if section == first || bounds_m[section] >= best.clearance_m {
                continue;
            }
            let other = self.closest_of(section, obstacle);
            // A NaN replaces the result and stays.
            if other.clearance_m < best.clearance_m || other.clearance_m.is_nan() {
                best = other;
            }
        }
        best
    }

    /// As [`Self::closest`], for one section.
    pub(crate) fn closest_of(&self, section: usize, obstacle: &Obstacle) -> Closest {
        let (axis, tube) = (obstacle.axis(), &self.tubes[section]);
        let (t, Wide([distance_m])) = tube.nearest(axis);
        Closest {
            clearance_m: distance_m - tube.radius_m - obstacle.radius_m(),
            section,
            axis_m: axis.point(t).narrow(),
        }
    }
}

/// Lower bound on the clearance of a section from an obstacle of `radius_m` (m): the clearance of the ball around it
/// (m).
#[inline]
fn clearance_min_m(tube: &Tube<1>, axis: &Axis, radius_m: f64) -> f64 {
    let (centre_m, Wide([ball_radius_m])) = tube.ball();
    let Wide([square_m2]) = axis.square_m2(&centre_m);
    square_m2.sqrt() - ball_radius_m - tube.radius_m - radius_m
}

/// True if a clearance (m) is certainly above `travel_m` (m), including rounding. False for a NaN.
#[inline]
fn is_beyond(clearance_m: f64, axis: &Axis, travel_m: f64) -> bool {
    clearance_m - (ROUNDING_M + axis.rounding_m()) > travel_m
}

/// Direction away from an obstacle whose axis meets the backbone at `foot`, as documented at [`Nearest::direction`].
#[cold]
fn direction_where_axes_meet(tube: &Tube<1>, foot: &Foot, span_m: &Vector3<f64>) -> Vector3<f64> {
    let both = foot.tangent.cross(span_m);
    let area = both.norm();
    // Within a microradian of parallel, the common normal is dominated by rounding.
    if area > 1e-6 * span_m.norm() {
        both / area
    } else {
        tube.normal()
    }
}

impl Robot {
    /// The body of the robot in this shape.
    pub fn body(&self, configuration: &Configuration) -> Body {
        let mut frames = [Pose::identity(); SECTIONS_MAX + 1];
        let mut pose = Pose::identity();
        for (frame, arc) in frames[1..].iter_mut().zip(self.arcs(configuration)) {
            pose = pose.then(&arc);
            *frame = pose;
        }
        self.body_from_frames(configuration, &frames)
    }

    /// This robot with a thicker body, for a robot whose tip is measured `tip_offset_m` (m) beside the tip of the
    /// model. A section of the thicker body that keeps a distance ensures that the true section keeps it, too.
    ///
    /// The radius of section j grows by `|offset| · min(1, s_j / |p|)`: `s_j` is the body length up to its end,
    /// p the tip from the base in the shape `at`. Derivation: §3 of docs/model.md. The fingerprint stays; a body radius
    /// may leave its range. An offset of 0 or less changes nothing; a NaN makes every radius NaN.
    #[must_use]
    pub fn enlarged(&self, at: &Configuration, tip_offset_m: f64) -> Cow<'_, Self> {
        if tip_offset_m <= 0.0 {
            return Cow::Borrowed(self);
        }
        let away_m = self.tip_position(at).norm();
        let mut enlarged = self.clone();
        let mut length_m = 0.0;
        for section in enlarged.sections_mut() {
            length_m += section.length_m;
            section.body_radius_m += tip_offset_m * (length_m / away_m).min(1.0);
        }
        Cow::Owned(enlarged)
    }

    /// The body, for a caller that already has the [`Self::section_frames`] of this shape.
    pub fn body_from_frames(
        &self,
        configuration: &Configuration,
        frames: &[Pose; SECTIONS_MAX + 1],
    ) -> Body {
        let last = self.section_count() - 1;
        let tube = |j: usize| {
            let [u, v] = configuration.section(j);
            let (start, end) = (Frame::from(&frames[j]), Frame::from(&frames[j + 1]));
            Tube::new(&start, &end, &self.sections()[j], [Wide([u]), Wide([v])])
        };
        let mut tubes = [tube(last); SECTIONS_MAX];
        for (j, target) in tubes[..last].iter_mut().enumerate() {
            *target = tube(j);
        }
        Body {
            tubes,
            chords: tubes.map(|tube| tube.chord()),
            section_count: self.section_count(),
        }
    }

    /// [`Body::nearest`] for a single obstacle.
    pub fn nearest(&self, configuration: &Configuration, obstacle: &Obstacle) -> Nearest {
        self.body(configuration).nearest(obstacle)
    }

    /// [`Body::clearance_m`] (m) for a single obstacle.
    pub fn clearance_m(&self, configuration: &Configuration, obstacle: &Obstacle) -> f64 {
        self.body(configuration).clearance_m(obstacle)
    }

    /// [`Body::reaches`] for a single obstacle.
    pub fn reaches(
        &self,
        configuration: &Configuration,
        obstacle: &Obstacle,
        travel_m: f64,
    ) -> bool {
        self.body(configuration).reaches(obstacle, travel_m)
    }

    /// Largest motion of any point of each section (m) when the bend vector of section k changes by at most
    /// `max_bend_change_rad[k]` (rad, Euclidean norm); 0 after the last section.
    ///
    /// An arc's end moves by at most ℓ/2 per radian and turns by at most a radian per radian, and so does each part of
    /// it. Hence Δⱼ ℓⱼ/2 + Σ_{k<j} Δₖ (ℓₖ/2 + Σ_{k<i≤j} ℓᵢ).
    pub fn travel_m(&self, max_bend_change_rad: &[f64; SECTIONS_MAX]) -> [f64; SECTIONS_MAX] {
        let mut travel_m = [0.0; SECTIONS_MAX];
        // Motion of the section's start, and its turn.
        let (mut start_m, mut turn_rad) = (0.0, 0.0);
        for (j, section) in self.sections().iter().enumerate() {
            let own_m = 0.5 * section.length_m * max_bend_change_rad[j];
            travel_m[j] = start_m + turn_rad * section.length_m + own_m;
            start_m = travel_m[j];
            turn_rad += max_bend_change_rad[j];
        }
        travel_m
    }

    /// Upper bound on the acceleration of any point of each section (m/s²) when the bend vectors change at constant
    /// rates of these norms (rad/s); 0 after the last section.
    ///
    /// The tangent at a share σ of section k turns at a rate of at most a = Σ_{i<k} rᵢ + σ rₖ, and its second
    /// derivative is at most a². Hence Σ ℓₖ ∫ a² dσ = Σ ℓₖ (S² + S rₖ + rₖ²/3), with S = Σ_{i<k} rᵢ.
    pub fn acceleration_m_s2(&self, rates_rad_s: &[f64; SECTIONS_MAX]) -> [f64; SECTIONS_MAX] {
        let mut acceleration_m_s2 = [0.0; SECTIONS_MAX];
        let (mut sum_m_s2, mut turn_rad_s) = (0.0, 0.0);
        for (j, section) in self.sections().iter().enumerate() {
            let rate = rates_rad_s[j];
            sum_m_s2 += section.length_m
                * (turn_rad_s * turn_rad_s + turn_rad_s * rate + rate * rate / 3.0);
            acceleration_m_s2[j] = sum_m_s2;
            turn_rad_s += rate;
        }
        acceleration_m_s2
    }

    /// Upper bound on the distance of any point of each section (m) between two shapes; 0 after the last section. Each
    /// shape comes with its [`Self::section_frames`].
    ///
    /// A point of a section is o + R a, in the other shape o' + R' a'. Their distance is at most
    /// |o' - o| + ‖R' - R‖ ℓ + Δ ℓ/2. Here ‖R' - R‖ is the largest singular value of a difference of rotations, which is its Frobenius norm
    /// over √2. A second bound is the larger displacement of the section's two ends, plus the difference of the arcs'
    /// deviations from their chords: (‖R' - R‖ θ + Δ (1 + θ)) ℓ/8.
    pub fn displacement_m(
        &self,
        (from, from_frames): (&Configuration, &[Pose; SECTIONS_MAX + 1]),
        (to, to_frames): (&Configuration, &[Pose; SECTIONS_MAX + 1]),
    ) -> [f64; SECTIONS_MAX] {
        let mut displacement_m = [0.0; SECTIONS_MAX];
        let moved_m = |i: usize| (to_frames[i].position_m - from_frames[i].position_m).norm();
        let mut start_m = moved_m(0);
        for (j, section) in self.sections().iter().enumerate() {
            let turn = to_frames[j].rotation - from_frames[j].rotation;
            let ([u, v], [to_u, to_v]) = (from.section(j), to.section(j));
            let turn = turn.norm() * core::f64::consts::FRAC_1_SQRT_2;
            let change_rad = ((to_u - u).powi(2) + (to_v - v).powi(2)).sqrt();
            let bend_rad = (u * u + v * v).max(to_u * to_u + to_v * to_v).sqrt();
            let end_m = moved_m(j + 1);
            let by_start_m = start_m + (turn + 0.5 * change_rad) * section.length_m;
            let bent = 0.125 * (turn * bend_rad + change_rad * (1.0 + bend_rad));
            displacement_m[j] = by_start_m.min(start_m.max(end_m) + bent * section.length_m);
            start_m = end_m;
        }
        displacement_m
    }
}

#[cfg(test)]
thread_local! {
    /// Number of exact clearances of a section, for tests of budgets.
    pub(crate) static EXACT: core::cell::Cell<u32> = const { core::cell::Cell::new(0) };
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::robot::{RobotParameters, Shape};

    proptest! {
        #[test]
        fn direction_equals_that_of_the_nearest_place(
            bends in prop::array::uniform4(-3.0..3.0_f64),
            [start, end] in prop::array::uniform2(prop::array::uniform3(-0.6..0.6_f64)),
            straight: bool,
        ) {
            let robot = Robot::new(&RobotParameters::paper(2)).unwrap();
            let bends = if straight { [0.0; 4] } else { bends };
            let body = robot.body(&Configuration::from_slice(&bends).unwrap());
            let [start_m, end_m] = [start, end].map(Vector3::from);
            let shapes = [Shape::Capsule { start_m, end_m }, Shape::Sphere { centre_m: start_m }];
            for shape in shapes {
                let obstacle = Obstacle::new(shape, 0.01, Vector3::zeros()).unwrap();
                for section in 0..2 {
                    let nearest = body.nearest_of(section, &obstacle);
                    let direction = body.direction(&body.closest_of(section, &obstacle));
                    let off = (direction - nearest.direction).norm();
                    let distance_m = nearest.clearance_m + 0.01 + robot.sections()[section].body_radius_m;
                    prop_assert!(off * distance_m < 1e-12, "{off} at {distance_m} m");
                }
            }
        }
    }
}
