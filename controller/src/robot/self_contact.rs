//! Deepest overlap of two parts of the body (§3 of docs/model.md).
//!
//! **What can touch.** Parts nearer along the body than a half circle of its radius cannot, as no arc is narrower than the body. Let two
//! parts be farther apart along it, between them the tangent turn by at most π in all, and no arc be narrower than a radius r. By Schur's
//! theorem their distance is at least that of the plane convex curve of the same curvature. Seen across its middle, that curve spans ∫ cos ds with
//! angles within ±π/2, which is least, 2 r, for the half circle. So with r the thicker one's radius they do not overlap: only parts between which
//! the body turns by more than π are compared, or, where an arc between them is narrower than r, parts farther apart than the half circle.
//!
//! **Search.** Points of one arc are compared with the nearest point of the other, which is exact. The distance falls by at most the
//! way along the backbone, so points that cannot touch are skipped. Where its slope turns from falling to rising between two
//! points, the least distance is found by regula falsi: a thin body is not missed between points.

mod pairs;

use core::f64::consts::{PI, TAU};

use nalgebra::Vector3;

use super::section::position_coefficients;
use super::tube::CENTRE;
use super::{Configuration, Pose, Robot, SECTIONS_MAX, SectionParameters};
pub(crate) use pairs::Pairs;

/// Points of a section are this part of its length apart.
const POINTS: u32 = 16;
/// Most steps of the search between two points.
const STEPS: u32 = 8;
/// The search ends at this slope of the distance along the body: the distance is then right to 10⁻⁶ of a step.
const FLAT: f64 = 1e-6;
/// Below this bend (rad) the nearest point of an arc is that of its chord, up to the square of it times the length.
const STRAIGHT_RAD: f64 = 1e-7;

/// The deepest overlap of two parts of the body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SelfContact {
    /// Their sections, 0 at the base, the first nearer to it.
    pub sections: [usize; 2],
    /// Sum of both radii less the distance of the backbone from itself (m).
    pub overlap_m: f64,
}

/// The backbone of one section.
#[derive(Clone, Copy)]
struct Backbone {
    start: Point,
    end: Point,
    /// Unit vectors towards the bend and normal to the plane of the arc.
    across: Vector3<f64>,
    normal: Vector3<f64>,
    bend_rad: f64,
    curvature_1_m: f64,
    length_m: f64,
    radius_m: f64,
    /// Length of the body up to its start (m), and per length of it.
    lengths: Along,
    /// How far the tangent turns up to its start (rad), and per length of it (rad/m).
    turns: Along,
    /// Centre and radius of a ball around the arc.
    centre_m: Vector3<f64>,
    reach_m: f64,
}

/// What grows along the body: from this value, by so much per length.
#[derive(Clone, Copy)]
struct Along {
    base: f64,
    rate: f64,
}

/// Parts of two sections that are at least so far apart.
#[derive(Clone, Copy)]
struct Apart {
    own: Along,
    other: Along,
    least: f64,
}

impl Apart {
    /// First place of the other section that is far enough from the place `at_m` of the first one; 0: all are (m).
    #[inline]
    fn first_m(&self, at_m: f64) -> f64 {
        let ahead = self.own.base + self.own.rate * at_m + self.least - self.other.base;
        if ahead > 0.0 {
            ahead / self.other.rate
        } else {
            0.0
        }
    }

    /// How far that place moves per way along the first section.
    fn pace(&self) -> f64 {
        self.own.rate / self.other.rate
    }

    /// Last place of the first section from which a place of the other one, of this length, is far enough (m).
    fn end_m(&self, other_length_m: f64) -> f64 {
        let left = self.other.base + self.other.rate * other_length_m - self.least - self.own.base;
        if left >= 0.0 {
            left / self.own.rate
        } else {
            -1.0
        }
    }
}

/// A point of the backbone, with its tangent.
#[derive(Clone, Copy)]
struct Point {
    point_m: Vector3<f64>,
    tangent: Vector3<f64>,
}

/// A point of one section and its distance from another.
#[derive(Clone, Copy)]
struct Sample {
    at_m: f64,
    distance_m: f64,
    /// The distance rises by at most this per length.
    steepest: f64,
    /// Slope of half of its square along the first section (m): nearly linear, also where the distance vanishes.
    slope_m: f64,
}

impl Sample {
    /// No distance between this and a later sample is less.
    fn bound_m(&self, later: &Self) -> f64 {
        // Finite: beside a straight section it is not.
        let steepest = later.steepest.min(1e9);
        let way_m = steepest * (later.at_m - self.at_m);
        let fall_m = (self.distance_m - later.distance_m + way_m) / (1.0 + steepest);
        self.distance_m - fall_m.max(0.0)
    }
}

impl Point {
    const NONE: Self = Self {
        point_m: Vector3::new(0.0, 0.0, 0.0),
        tangent: Vector3::new(0.0, 0.0, 0.0),
    };
}

impl Backbone {
    const NONE: Self = Self {
        start: Point::NONE,
        end: Point::NONE,
        across: Vector3::new(0.0, 0.0, 0.0),
        normal: Vector3::new(0.0, 0.0, 0.0),
        bend_rad: 0.0,
        curvature_1_m: 0.0,
        length_m: 0.0,
        radius_m: 0.0,
        lengths: Along {
            base: 0.0,
            rate: 0.0,
        },
        turns: Along {
            base: 0.0,
            rate: 0.0,
        },
        centre_m: Vector3::new(0.0, 0.0, 0.0),
        reach_m: 0.0,
    };

    /// The section between these poses.
    fn new(
        [pose, end]: [&Pose; 2],
        [u, v]: [f64; 2],
        section: &SectionParameters,
        [lengths, turns]: [Along; 2],
    ) -> Self {
        let bend_rad = norm([u, v]);
        let [cos, sin] = if bend_rad > 0.0 {
            [u / bend_rad, v / bend_rad]
        } else {
            [1.0, 0.0]
        };
        let [x, y, z] = [0, 1, 2].map(|axis| pose.rotation.column(axis).into_owned());
        let chord_m = end.position_m - pose.position_m;
        Self {
            start: Point {
                point_m: pose.position_m,
                tangent: z,
            },
            end: Point {
                point_m: end.position_m,
                tangent: end.rotation.column(2).into_owned(),
            },
            across: x * cos + y * sin,
            normal: y * cos - x * sin,
            bend_rad,
            curvature_1_m: bend_rad / section.length_m,
            length_m: section.length_m,
            radius_m: section.body_radius_m,
            lengths,
            turns,
            centre_m: pose.position_m + chord_m * 0.5,
            // Any curve lies within half its length of the middle of its chord.
            reach_m: if bend_rad <= PI {
                0.5 * chord_m.norm()
            } else {
                0.5 * section.length_m
            },
        }
    }

    /// The point `at_m` from its start.
    #[inline]
    fn point(&self, at_m: f64) -> Point {
        let turned_rad = self.curvature_1_m * at_m;
        let w = turned_rad * turned_rad;
        let (f, g) = position_coefficients(w);
        let Point { point_m, tangent } = self.start;
        Point {
            point_m: point_m + self.across * (at_m * turned_rad * g) + tangent * (at_m * f),
            tangent: self.across * (turned_rad * f) + tangent * (1.0 - w * g),
        }
    }

    /// Vector from the nearest point of the arc, of up to half a circle ([`tube`](super::tube) has the formulas).
    #[inline]
    fn between_m(&self, point_m: &Vector3<f64>) -> Vector3<f64> {
        let away_m = point_m - self.start.point_m;
        let beyond_m = point_m - self.end.point_m;
        let z_m = self.start.tangent.dot(&away_m);
        let is_beside = z_m >= 0.0 && self.end.tangent.dot(&beyond_m) <= 0.0;
        let x_m = self.across.dot(&away_m);
        let (inwards, onwards) = (1.0 - self.curvature_1_m * x_m, self.curvature_1_m * z_m);
        let h = (inwards * inwards + onwards * onwards).sqrt();
        if !is_beside || h < CENTRE {
            return if away_m.norm_squared() < beyond_m.norm_squared() {
                away_m
            } else {
                beyond_m
            };
        }
        let outside_m = (self.curvature_1_m * (x_m * x_m + z_m * z_m) - 2.0 * x_m) / (h + 1.0) / h;
        self.start.tangent * (outside_m * onwards) - self.across * (outside_m * inwards)
            + self.normal * self.normal.dot(&away_m)
    }

    /// Place of the point nearest to `point_m`, not before `from_m` (m).
    fn nearest_m(&self, point_m: &Vector3<f64>, from_m: f64) -> f64 {
        let away_m = point_m - self.start.point_m;
        let (x_m, z_m) = (self.across.dot(&away_m), self.start.tangent.dot(&away_m));
        if self.bend_rad < STRAIGHT_RAD {
            return z_m.clamp(from_m, self.length_m);
        }
        let turned_rad = (self.curvature_1_m * z_m).atan2(1.0 - self.curvature_1_m * x_m);
        // Behind the start: on the part of the circle that is not the body's, unless it closes.
        let turned_rad = if turned_rad < 0.0 {
            turned_rad + TAU
        } else {
            turned_rad
        };
        let at_m = turned_rad / self.curvature_1_m;
        if (from_m..=self.length_m).contains(&at_m) {
            return at_m;
        }
        let square = |at_m: f64| (self.point(at_m).point_m - point_m).norm_squared();
        if square(from_m) < square(self.length_m) {
            from_m
        } else {
            self.length_m
        }
    }

    /// Distance of the point `at_m` from the part of `other` that it can touch.
    #[inline]
    fn sample(&self, at_m: f64, other: &Self, apart: &Apart) -> Sample {
        let own = self.point(at_m);
        let from_m = apart.first_m(at_m);
        let (mut steepest, mut motion) = (1.0, own.tangent);
        let between_m = if from_m <= 0.0 && other.bend_rad <= PI {
            other.between_m(&own.point_m)
        } else {
            let first_m = from_m.max(0.0).min(other.length_m);
            let nearest_m = other.nearest_m(&own.point_m, first_m);
            let its = other.point(nearest_m);
            if from_m > 0.0 {
                steepest += apart.pace();
                if nearest_m <= from_m {
                    // The first point of the other that counts moves along with this one.
                    motion -= its.tangent * apart.pace();
                }
            }
            own.point_m - its.point_m
        };
        Sample {
            at_m,
            distance_m: between_m.norm(),
            steepest,
            slope_m: between_m.dot(&motion),
        }
    }

    /// Least distance from `other`, farther from the base, if it is below `below_m` (m): of parts that are far enough `apart` along the body.
    /// With `bound_m`, what is not above it, without a search between the points: of what is below that, any.
    fn distance_below(
        &self,
        other: &Self,
        apart: &Apart,
        below_m: f64,
        bound_m: Option<f64>,
    ) -> Option<f64> {
        let reach_m = self.reach_m + other.reach_m + below_m;
        if below_m <= 0.0 || (self.centre_m - other.centre_m).norm_squared() >= reach_m * reach_m {
            return None;
        }
        // The last point that has a part of the other far enough along the body.
        let end_m = apart.end_m(other.length_m).min(self.length_m);
        let step_m = self.length_m / f64::from(POINTS);
        let last = end_m / step_m;
        let mut least_m = below_m;
        let mut before: Option<Sample> = None;
        let mut note = |before: Option<Sample>, here: Sample| {
            least_m = least_m.min(here.distance_m);
            match before {
                Some(before) if bound_m.is_some() => least_m = least_m.min(before.bound_m(&here)),
                Some(before) => self.search(before, here, other, apart, &mut least_m),
                None => {}
            }
            least_m
        };
        let mut k = 0;
        while k <= POINTS && f64::from(k) <= last {
            let here = self.sample(f64::from(k) * step_m, other, apart);
            let least_m = note(before, here);
            if bound_m.is_some_and(|bound_m| least_m < bound_m) {
                break;
            }
            // Nothing is nearer on the way that the distance allows.
            let skipped = ((here.distance_m - least_m) / step_m).min(f64::from(POINTS));
            let is_near = skipped < 1.0;
            before = is_near.then_some(here);
            k += if is_near { 1 } else { skipped as u32 };
        }
        if let Some(before) = before.filter(|before| end_m > before.at_m) {
            note(Some(before), self.sample(end_m, other, apart));
        }
        (least_m < below_m).then_some(least_m)
    }

    /// Finds the least distance between two points where its slope turns from falling to rising.
    fn search(
        &self,
        mut low: Sample,
        mut high: Sample,
        other: &Self,
        apart: &Apart,
        least_m: &mut f64,
    ) {
        let mut slopes_m = [low.slope_m, high.slope_m];
        let mut moved: Option<usize> = None;
        for _ in 0..STEPS {
            let is_dip = low.slope_m < 0.0 && high.slope_m > 0.0;
            if !is_dip || low.bound_m(&high) >= *least_m {
                return;
            }
            let share = slopes_m[0] / (slopes_m[0] - slopes_m[1]);
            let at_m = low.at_m + share * (high.at_m - low.at_m);
            let here = self.sample(at_m, other, apart);
            *least_m = least_m.min(here.distance_m);
            if here.slope_m.abs() <= FLAT * here.distance_m {
                return;
            }
            // Illinois: an end that stays twice counts half.
            let end = usize::from(here.slope_m > 0.0);
            if moved == Some(end) {
                slopes_m[1 - end] *= 0.5;
            }
            (moved, slopes_m[end]) = (Some(end), here.slope_m);
            if end == 0 {
                low = here;
            } else {
                high = here;
            }
        }
    }
}

impl Robot {
    /// The deepest overlap of two parts of the body that is deeper than `above_m` (m), by each section's `body_radius_m`; `None` if there is
    /// none, and for bends that are no numbers. Below 0 it is the least distance of parts that the bends let touch.
    ///
    /// Bounded work: at most 18 points of each section beside each other one, and eight more where a distance is least. Without bends of
    /// more than π in all, a few comparisons. A section is not compared with itself: bent by up to π, it does not touch itself.
    pub fn self_contact(&self, at: &Configuration, above_m: f64) -> Option<SelfContact> {
        let turned = self.turned_pairs(at, &[0.0; SECTIONS_MAX]);
        self.self_contact_of(turned, at, above_m)
    }

    /// The same of some pairs of sections.
    pub(crate) fn self_contact_of(
        &self,
        pairs: Pairs,
        at: &Configuration,
        above_m: f64,
    ) -> Option<SelfContact> {
        if pairs.is_empty() || !at.is_finite() {
            return None;
        }
        let backbones = self.backbones(pairs, at, &[0.0; SECTIONS_MAX]);
        let mut deepest: Option<SelfContact> = None;
        for sections in pairs.iter() {
            let above_m = deepest.map_or(above_m, |deepest| deepest.overlap_m);
            let is_narrow = pairs.is_narrow(sections);
            if let Some(overlap_m) = overlap_m(&backbones, sections, is_narrow, above_m, None) {
                deepest = Some(SelfContact {
                    sections,
                    overlap_m,
                });
            }
        }
        deepest
    }

    /// The sections of these pairs; the others are not filled in. They turn by up to `change_rad` more.
    fn backbones(
        &self,
        pairs: Pairs,
        at: &Configuration,
        change_rad: &[f64; SECTIONS_MAX],
    ) -> [Backbone; SECTIONS_MAX] {
        let mut backbones = [Backbone::NONE; SECTIONS_MAX];
        let (mut pose, mut base_m, mut turned_rad) = (Pose::identity(), 0.0, 0.0);
        for (j, (section, arc)) in self.sections().iter().zip(self.arcs(at)).enumerate() {
            let end = pose.then(&arc);
            let bend_rad = norm(at.section(j)) + change_rad[j];
            let lengths = Along {
                base: base_m,
                rate: 1.0,
            };
            let turns = Along {
                base: turned_rad,
                rate: bend_rad / section.length_m,
            };
            if pairs.have(j) {
                backbones[j] =
                    Backbone::new([&pose, &end], at.section(j), section, [lengths, turns]);
            }
            pose = end;
            base_m += section.length_m;
            turned_rad += bend_rad;
        }
        backbones
    }
}

/// Overlap of two sections, if it is above `above_m` (m). With `bound_m`, what is not below it: of what is above that, any.
fn overlap_m(
    backbones: &[Backbone; SECTIONS_MAX],
    [one, other]: [usize; 2],
    is_narrow: bool,
    above_m: f64,
    bound_m: Option<f64>,
) -> Option<f64> {
    let [own, its] = [&backbones[one], &backbones[other]];
    let radii_m = own.radius_m + its.radius_m;
    let apart = if is_narrow {
        Apart {
            own: own.lengths,
            other: its.lengths,
            least: PI * own.radius_m.max(its.radius_m),
        }
    } else {
        Apart {
            own: own.turns,
            other: its.turns,
            least: PI,
        }
    };
    let bound_m = bound_m.map(|bound_m| radii_m - bound_m);
    let distance_m = own.distance_below(its, &apart, radii_m - above_m, bound_m);
    // Rounding must not find once more what was found.
    (distance_m.map(|distance_m| radii_m - distance_m)).filter(|overlap_m| *overlap_m > above_m)
}

/// Length of a bend vector, or of how it changes.
pub(crate) fn norm([u, v]: [f64; 2]) -> f64 {
    (u * u + v * v).sqrt()
}

#[cfg(test)]
mod tests;
