//! The nearest rates of a robot that comes to rest after them: slower rates stop sooner, and so have more
//! room.
//!
//! For a largest component f and the path s = s(f) to rest, the permitted rates are a convex set with one
//! nearest point. Half its squared distance is a convex function of f and 1/s, so the multipliers of the
//! solution give a tangent plane below it. But 1/s(f) is convex, too: as a function of f, the distance can
//! have several minima. The search therefore tries the f at which the highest plane is lowest, until no plane
//! permits a smaller distance (docs/model.md §7).

use super::Limits;
use crate::robot::BendRates;
use crate::safety::projection::Region;
use crate::safety::stopping::{Stopping, fastest};

/// Largest number of tried values of f.
const TRIED_MAX: usize = 16;
/// Permitted relative excess of the squared distance,
const WITHIN: f64 = 1e-6;
/// relative to this value at least \[rad²/s²\].
const SQUARE_MIN: f64 = 1e-9;

/// A lower bound of half the squared distance: `offset - most f - per_inverse_path / s(f)`, exact at f =
/// `fastest_rad_s`.
#[derive(Clone, Copy)]
struct Plane {
    fastest_rad_s: f64,
    offset: f64,
    most: f64,
    per_inverse_path: f64,
}

/// The known planes, ordered by f.
struct Planes {
    stopping: Stopping,
    known: [Plane; TRIED_MAX + 1],
    count: usize,
}

impl Limits<'_> {
    /// The rates of [`Self::nearest`]; `None` if none were found. All candidates are permitted.
    pub(super) fn nearest_that_stops(&self, desired: &BendRates) -> Option<BendRates> {
        let sides =
            (0..desired.as_slice().len()).map(|i| self.upper_rad_s(i).max(-self.lower_rad_s(i)));
        // Not faster than desired: the path to rest was computed for those rates.
        let most_rad_s = sides.fold(0.0_f64, f64::max).min(fastest(desired));
        let mut limits = self.for_fastest(most_rad_s);
        let mut region = Region::EMPTY;
        limits.fill(&mut region, most_rad_s);
        let mut rates = limits.nearest_in(&mut region, desired)?;
        let Some(stopping) = self.stopping else {
            return Some(rates);
        };
        let mut least = square_between(&rates, desired);
        let mut planes = Planes::at_rest(stopping, desired);
        let mut fastest_rad_s = most_rad_s;
        for _ in 0..TRIED_MAX {
            let Some(plane) = Plane::from_region(&region, stopping, fastest_rad_s) else {
                break;
            };
            planes.insert(plane);
            let enough = 0.5 * (least - WITHIN * least.max(SQUARE_MIN));
            let Some(next_rad_s) = planes.lowest_below(enough) else {
                break;
            };
            fastest_rad_s = next_rad_s;
            limits = self.for_fastest(fastest_rad_s);
            region.move_to(fastest_rad_s, limits.path_s);
            let Some(nearest) = limits.nearest_in(&mut region, desired) else {
                break;
            };
            let square = square_between(&nearest, desired);
            if square < least {
                (rates, least) = (nearest, square);
            }
        }
        Some(rates)
    }

    /// The limits of rates whose components do not exceed `fastest_rad_s`.
    pub(super) fn for_fastest(&self, fastest_rad_s: f64) -> Self {
        let path_s = match self.stopping {
            Some(stopping) => stopping.path(fastest_rad_s).path_s,
            None => self.path_s,
        };
        Self { path_s, ..*self }
    }
}

impl Plane {
    /// The plane of the last solution; `None` without a solution.
    fn from_region(region: &Region, stopping: Stopping, fastest_rad_s: f64) -> Option<Self> {
        let sensitivity = region.sensitivity()?;
        let inverse_path_1_s = 1.0 / stopping.path(fastest_rad_s).path_s;
        Some(Self {
            fastest_rad_s,
            offset: sensitivity.half_square
                + sensitivity.most * fastest_rad_s
                + sensitivity.per_inverse_path * inverse_path_1_s,
            most: sensitivity.most,
            per_inverse_path: sensitivity.per_inverse_path,
        })
    }
}

impl Planes {
    /// The plane of rest, where only the largest component is a bound.
    fn at_rest(stopping: Stopping, desired: &BendRates) -> Self {
        let components = desired.as_slice().iter();
        let rest = Plane {
            fastest_rad_s: 0.0,
            offset: 0.5 * components.clone().map(|rate| rate * rate).sum::<f64>(),
            most: components.map(|rate| rate.abs()).sum(),
            per_inverse_path: 0.0,
        };
        Self {
            stopping,
            known: [rest; TRIED_MAX + 1],
            count: 1,
        }
    }

    fn insert(&mut self, plane: Plane) {
        let known = &mut self.known[..=self.count];
        let place = known[..self.count].partition_point(|p| p.fastest_rad_s < plane.fastest_rad_s);
        known[place..].rotate_right(1);
        known[place] = plane;
        self.count += 1;
    }

    /// The f at which the highest plane is lowest, if its value there is below `enough`. Planes are concave
    /// in f, so between two neighbours that is their intersection.
    fn lowest_below(&self, enough: f64) -> Option<f64> {
        let known = &self.known[..self.count];
        let neighbours = known.iter().zip(&known[1..]);
        let crossings = neighbours.map(|(low, high)| self.crossing(low, high));
        let (value, fastest_rad_s) = crossings.min_by(|one, other| one.0.total_cmp(&other.0))?;
        (value < enough).then_some(fastest_rad_s)
    }

    /// The f at which two planes intersect between their points of contact, and their value there.
    fn crossing(&self, low: &Plane, high: &Plane) -> (f64, f64) {
        let (moving_s, slope_s2) = (self.stopping.moving_s, self.stopping.path_slope_s2());
        let offset = low.offset - high.offset;
        let most = low.most - high.most;
        // (offset - most f) (moving + slope f) = per_inverse_path
        let constant = offset * moving_s - (low.per_inverse_path - high.per_inverse_path);
        let linear = offset * slope_s2 - most * moving_s;
        let square = -most * slope_s2;
        let root = (linear * linear - 4.0 * square * constant).sqrt();
        let both = -0.5 * (linear + root.copysign(linear));
        let range = low.fastest_rad_s..high.fastest_rad_s;
        let crossing_rad_s = [both / square, constant / both]
            .into_iter()
            .find(|fastest_rad_s| range.contains(fastest_rad_s))
            .unwrap_or(0.5 * (range.start + range.end));
        let inverse_path_1_s = 1.0 / (moving_s + slope_s2 * crossing_rad_s);
        let [low, high] = [low, high].map(|plane| {
            plane.offset - plane.most * crossing_rad_s - plane.per_inverse_path * inverse_path_1_s
        });
        (low.max(high), crossing_rad_s)
    }
}

fn square_between(one: &BendRates, other: &BendRates) -> f64 {
    let pairs = one.as_slice().iter().zip(other.as_slice());
    pairs.map(|(one, other)| (one - other).powi(2)).sum()
}

#[cfg(test)]
mod tests;
