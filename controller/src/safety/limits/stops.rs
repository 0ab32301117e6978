//! The nearest rates of a robot that comes to rest after them: slower ones stop sooner, and have more room.
//!
//! With no component faster than f, and s = s(f) to rest, the rates inside the limits are convex, and the nearest of them has a distance. Half
//! its square is a convex function of f and 1/s, so the multipliers of what holds those rates give a plane below it. But 1/s(f) is convex, too: over f the
//! distance can have several minima. So the f that is tried next is the one at which the highest plane is lowest, until no plane leaves room for less (docs/model.md §7).

use super::Limits;
use crate::robot::BendRates;
use crate::safety::clearance::{Stopping, fastest};
use crate::safety::projection::Region;

/// Fastest components that are tried.
const TRIED_MAX: usize = 16;
/// What the square of the distance may be too large by, as a share,
const WITHIN: f64 = 1e-6;
/// of this square at least \[rad²/s²\].
const SQUARE_MIN: f64 = 1e-9;

/// A plane below half the squared distance: `offset - most f - per_way / s(f)`, which touches it at f = `fastest_rad_s`.
#[derive(Clone, Copy)]
struct Plane {
    fastest_rad_s: f64,
    offset: f64,
    most: f64,
    per_way: f64,
}

/// Those that are known, by their fastest component.
struct Planes {
    stopping: Stopping,
    known: [Plane; TRIED_MAX + 1],
    count: usize,
}

impl Limits<'_> {
    /// The rates of [`Self::nearest`]; `None` where none were found. All that are looked at are inside the limits.
    pub(super) fn nearest_that_stops(&self, desired: &BendRates) -> Option<BendRates> {
        let sides =
            (0..desired.as_slice().len()).map(|i| self.upper_rad_s(i).max(-self.lower_rad_s(i)));
        // Not faster than asked for: until the robot rests was counted with that.
        let most_rad_s = sides.fold(0.0_f64, f64::max).min(fastest(desired));
        let mut limits = self.of_way(most_rad_s);
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
            let Some(plane) = Plane::of(&region, stopping, fastest_rad_s) else {
                break;
            };
            planes.insert(plane);
            let enough = 0.5 * (least - WITHIN * least.max(SQUARE_MIN));
            let Some(next_rad_s) = planes.lowest_below(enough) else {
                break;
            };
            fastest_rad_s = next_rad_s;
            limits = self.of_way(fastest_rad_s);
            region.move_to(fastest_rad_s, limits.way_s);
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

    /// The limits of rates of which no component is faster.
    pub(super) fn of_way(&self, fastest_rad_s: f64) -> Self {
        let way_s = match self.stopping {
            Some(stopping) => stopping.way(fastest_rad_s).way_s,
            None => self.way_s,
        };
        Self { way_s, ..*self }
    }
}

impl Plane {
    /// The one that touches at what was found last; `None` where nothing was.
    fn of(region: &Region, stopping: Stopping, fastest_rad_s: f64) -> Option<Self> {
        let pulls = region.pulls()?;
        let per_way_1_s = 1.0 / stopping.way(fastest_rad_s).way_s;
        Some(Self {
            fastest_rad_s,
            offset: pulls.half_square + pulls.most * fastest_rad_s + pulls.per_way * per_way_1_s,
            most: pulls.most,
            per_way: pulls.per_way,
        })
    }
}

impl Planes {
    /// The one of rest, where only the fastest component bounds.
    fn at_rest(stopping: Stopping, desired: &BendRates) -> Self {
        let components = desired.as_slice().iter();
        let rest = Plane {
            fastest_rad_s: 0.0,
            offset: 0.5 * components.clone().map(|rate| rate * rate).sum::<f64>(),
            most: components.map(|rate| rate.abs()).sum(),
            per_way: 0.0,
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

    /// The fastest component at which the highest of the planes is lowest, if it is below `enough` there. Between two neighbours that is where they cross: planes are concave
    /// over f.
    fn lowest_below(&self, enough: f64) -> Option<f64> {
        let known = &self.known[..self.count];
        let neighbours = known.iter().zip(&known[1..]);
        let crossings = neighbours.map(|(low, high)| self.crossing(low, high));
        let (value, fastest_rad_s) = crossings.min_by(|one, other| one.0.total_cmp(&other.0))?;
        (value < enough).then_some(fastest_rad_s)
    }

    /// Where two planes cross between the places at which they touch, and their value there.
    fn crossing(&self, low: &Plane, high: &Plane) -> (f64, f64) {
        let (moving_s, slope_s2) = (self.stopping.moving_s, self.stopping.way_slope_s2());
        let offset = low.offset - high.offset;
        let most = low.most - high.most;
        // (offset - most f) (moving + slope f) = per_way
        let constant = offset * moving_s - (low.per_way - high.per_way);
        let linear = offset * slope_s2 - most * moving_s;
        let square = -most * slope_s2;
        let root = (linear * linear - 4.0 * square * constant).sqrt();
        let both = -0.5 * (linear + root.copysign(linear));
        let range = low.fastest_rad_s..high.fastest_rad_s;
        let crossing_rad_s = [both / square, constant / both]
            .into_iter()
            .find(|fastest_rad_s| range.contains(fastest_rad_s))
            .unwrap_or(0.5 * (range.start + range.end));
        let per_way_1_s = 1.0 / (moving_s + slope_s2 * crossing_rad_s);
        let [low, high] = [low, high]
            .map(|plane| plane.offset - plane.most * crossing_rad_s - plane.per_way * per_way_1_s);
        (low.max(high), crossing_rad_s)
    }
}

fn square_between(one: &BendRates, other: &BendRates) -> f64 {
    let pairs = one.as_slice().iter().zip(other.as_slice());
    pairs.map(|(one, other)| (one - other).powi(2)).sum()
}

#[cfg(test)]
mod tests;
