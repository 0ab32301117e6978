//! Clearance of W bodies side by side, for the rollouts of the swarm.

use super::clearance::ROUNDING_M;
use super::lanes::{Frame, WideVector};
use super::obstacle::{Axis, Obstacle};
use super::tube::{Tube, ball};
use super::{Robot, SECTIONS_MAX, SectionParameters};
use crate::wide::{Wide, all, either};
use core::f64::consts::PI;

/// The bodies of W configurations, prepared for many obstacles. Fixed arrays, no heap.
///
/// Each lane has the same bits as W = 1, whatever the other lanes contain.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BodyWide<const W: usize> {
    /// Base first. The rest are `None`, which costs no time to write.
    sections: [Option<SectionWide<W>>; SECTIONS_MAX],
}

/// One section, its end frames and a bounding ball.
#[derive(Debug, Clone, Copy)]
struct SectionWide<const W: usize> {
    parameters: SectionParameters,
    bend_rad: [Wide<W>; 2],
    start: Frame<W>,
    end: Frame<W>,
    centre_m: WideVector<W>,
    radius_m: Wide<W>,
    /// From start to end of the arc.
    chord_m: WideVector<W>,
    /// One over the squared chord length; 0 for a chord of no length.
    per_chord_1_m2: Wide<W>,
    /// Bound on the distance between a point of the arc and the chord (m).
    bulge_m: Wide<W>,
}

/// Below this squared length (m²), a chord is treated as a point.
const POINT_M2: f64 = 1e-30;

impl<const W: usize> SectionWide<W> {
    #[inline(always)]
    fn new(parameters: &SectionParameters, start: Frame<W>, bend_rad: [Wide<W>; 2]) -> Self {
        let [u, v] = bend_rad;
        let end = start.then(parameters.length_m, bend_rad);
        let w = u * u + v * v;
        let (start_m, end_m) = (&start.position_m, &end.position_m);
        let (centre_m, radius_m) = ball(start_m, end_m, parameters.length_m, w);
        let chord_m = *end_m - *start_m;
        let (square_m2, zero) = (chord_m.norm_squared(), Wide::splat(0.0));
        let is_point = square_m2.less(Wide::splat(POINT_M2));
        let per_chord_1_m2 = zero.select(Wide::splat(1.0) / square_m2, is_point);
        // ℓ (1 - cos(θ/2))/θ ≤ ℓ θ/8 up to θ = π; any curve stays within half its length of one of its ends.
        let up_to_half_a_circle = w.less_or_equal(Wide::splat(PI * PI));
        let bulge_m = (w.sqrt() * (0.125 * parameters.length_m))
            .select(Wide::splat(0.5 * parameters.length_m), up_to_half_a_circle);
        Self {
            parameters: *parameters,
            bend_rad,
            start,
            end,
            centre_m,
            radius_m,
            chord_m,
            per_chord_1_m2,
            bulge_m,
        }
    }

    /// Squared distance from a point to the chord (m²).
    #[inline(always)]
    fn chord_square_m2(&self, point_m: &WideVector<W>) -> Wide<W> {
        let after_start = *point_m - self.start.position_m;
        let share = (after_start.dot(&self.chord_m) * self.per_chord_1_m2).clamp(0.0, 1.0);
        (after_start - self.chord_m * share).norm_squared()
    }

    /// Distance between chord and segment along one direction, about the one that joins their nearest points. Returned
    /// as the distance times the length of the direction vector (m²), and that length (m).
    #[inline(always)]
    fn chord_apart(&self, axis: &Axis) -> (Wide<W>, Wide<W>) {
        let zero = Wide::splat(0.0);
        let from_m = self.start.position_m - WideVector::splat(&axis.start_m);
        let span_m = WideVector::splat(&axis.span_m);
        let to_middle_m = span_m * Wide::splat(0.5) - from_m;
        let share = (to_middle_m.dot(&self.chord_m) * self.per_chord_1_m2).clamp(0.0, 1.0);
        let point_m = self.start.position_m + self.chord_m * share;
        let between_m = point_m - axis.point(axis.share(&point_m));
        let nearer_end = (zero - between_m.dot(&self.chord_m)).max(zero);
        let nearer_end = nearer_end + between_m.dot(&span_m).max(zero);
        let apart_m2 = between_m.dot(&from_m) - nearer_end;
        (apart_m2, between_m.norm_squared().sqrt())
    }
}

impl<const W: usize> BodyWide<W> {
    /// Lanes in which section `j`, from 0, is farther than `cutoff_m` (m, finite) from an obstacle. A cheap test by
    /// bounding balls and the chord. `None` if all lanes are, or if there is no such section.
    #[inline(always)]
    pub(crate) fn section_is_beyond(
        &self,
        j: usize,
        obstacle: &Obstacle,
        cutoff_m: f64,
    ) -> Option<[bool; W]> {
        /// Relative rounding error of a squared distance.
        const ROUNDING: f64 = 1.0 + 1e-14;
        let section = self.sections[j].as_ref()?;
        let (axis, zero) = (obstacle.axis(), Wide::splat(0.0));
        let radii_m = section.parameters.body_radius_m + obstacle.radius_m();
        let kept_m = radii_m + cutoff_m + ROUNDING_M + axis.rounding_m();
        let reach_m = (section.radius_m + kept_m).max(zero);
        let far = (reach_m * reach_m * ROUNDING).less(axis.square_m2(&section.centre_m));
        if all(far) {
            return None;
        }
        // The chord gives a tighter bound than the ball.
        let reach_m = (section.bulge_m + kept_m).max(zero);
        let off_chord = if axis.is_point() {
            let square_m2 = section.chord_square_m2(&WideVector::splat(&axis.start_m));
            (reach_m * reach_m * ROUNDING).less(square_m2)
        } else {
            let (apart_m2, between_m) = section.chord_apart(axis);
            (reach_m * between_m * ROUNDING).less(apart_m2)
        };
        let far = either(far, off_chord);
        (!all(far)).then_some(far)
    }

    /// Clearance (m) of section `j`, from 0, of each body from an obstacle, limited to `cutoff_m`. `beyond` is the
    /// result of [`Self::section_is_beyond`]; those lanes return exactly `cutoff_m`.
    ///
    /// As exact as [`Body::clearance_of`]. A lane with a NaN or an infinity in its bends may give any number.
    ///
    /// [`Body::clearance_of`]: super::Body::clearance_of
    #[inline(always)]
    pub(crate) fn section_clearance_below(
        &self,
        j: usize,
        obstacle: &Obstacle,
        cutoff_m: f64,
        beyond: [bool; W],
    ) -> Wide<W> {
        let enough = Wide::splat(cutoff_m);
        let Some(section) = &self.sections[j] else {
            return enough;
        };
        let (_, distance_m) = section.tube().nearest(obstacle.axis());
        let clearance_m = distance_m - section.parameters.body_radius_m - obstacle.radius_m();
        // Lanes beyond return `cutoff_m` whatever their rounding, as they would alone.
        enough.select(enough.min_or_nan(clearance_m), beyond)
    }
}

impl<const W: usize> SectionWide<W> {
    /// The section prepared for exact distances.
    #[inline(always)]
    fn tube(&self) -> Tube<W> {
        Tube::new(&self.start, &self.end, &self.parameters, self.bend_rad)
    }
}

impl Robot {
    /// The bodies of W configurations: a [`Body`] in every lane. `bend_rad(i)` is the i-th bend-vector component of
    /// each (rad).
    ///
    /// No branches and no trigonometry: the coefficients come from the power series, accurate to 5e-16 for θ ≤ π and to
    /// 1e-12 for θ ≤ 2π.
    ///
    /// [`Body`]: super::Body
    #[inline(always)]
    pub(crate) fn body_wide<const W: usize>(
        &self,
        bend_rad: impl Fn(usize) -> Wide<W>,
    ) -> BodyWide<W> {
        // Filled in place, because a copy would cost as much as the arithmetic.
        let mut body = BodyWide {
            sections: [None; SECTIONS_MAX],
        };
        let mut end = Frame::base();
        for (j, parameters) in self.sections().iter().enumerate() {
            let bend_rad = [bend_rad(2 * j), bend_rad(2 * j + 1)];
            let section = SectionWide::new(parameters, end, bend_rad);
            end = section.end;
            body.sections[j] = Some(section);
        }
        body
    }
}

#[cfg(test)]
mod tests;
