//! The nearest rates of a robot that comes to rest after them: slower ones stop sooner, and have more room.
//!
//! With no component faster than f, and the way to rest of f, the rates inside the limits are convex, and their nearest has a distance d(f). The
//! multipliers of what holds it tell the slope of d²/2: it grows with f where the way limits, and falls where f does. So f is looked for where the
//! slope changes its sign, from above, by the method of Newton and by secants, in a bounded number of steps.

use super::Limits;
use crate::robot::BendRates;
use crate::safety::clearance::{Stopping, fastest};
use crate::safety::projection::{Region, Slopes};

/// Fastest components that are tried.
const TRIED_MAX: usize = 6;
/// What the square of the distance may be too large by, as a share.
const WITHIN: f64 = 1e-6;
/// Fastest components that differ by less than this share are the same.
const SAME: f64 = 1e-6;
/// A share by which fastest components are near to each other.
const NEAR: f64 = 0.01;
/// The share of what is between that a step of Newton's method leaves on either side.
const MARGIN: f64 = 0.1;
/// The share of a fastest component that is tried next where nothing tells more.
const LESS: f64 = 0.7;

/// A fastest component on one side of the one that is looked for.
#[derive(Clone, Copy)]
struct Side {
    fastest_rad_s: f64,
    /// Of half the squared distance; 0: not known.
    slope: f64,
    /// Where Newton's method leads from there \[rad/s\].
    newton_rad_s: f64,
}

/// What is known of the fastest component that is looked for.
struct Search {
    low: Side,
    high: Side,
    last_slope: f64,
    /// Where the component that is fastest at `high` begins to be bounded by that \[rad/s\]; `None`: it is there.
    bounded_rad_s: Option<f64>,
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
        let mut found = limits.nearest_in(&mut region, desired)?;
        let Some(stopping) = self.stopping else {
            return Some(found);
        };
        let (mut rates, mut least) = (found, square_between(&found, desired));
        let mut search = Search::new(most_rad_s);
        let mut fastest_rad_s = most_rad_s;
        for _ in 0..TRIED_MAX {
            let Some(slopes) = region.slopes(stopping.way_slope_s2()) else {
                break;
            };
            let bounded_rad_s = bounded_rad_s(stopping, fastest_rad_s, &found, &slopes);
            search.narrow(fastest_rad_s, &slopes, bounded_rad_s);
            let Some(next_rad_s) = search.next_rad_s() else {
                break;
            };
            let gain = slopes.half_square * (next_rad_s - fastest_rad_s);
            if search.low.slope < 0.0 && gain.abs() <= WITHIN * least {
                break;
            }
            fastest_rad_s = next_rad_s;
            limits = self.of_way(fastest_rad_s);
            region.move_to(fastest_rad_s, limits.way_s);
            let Some(nearest) = limits.nearest_in(&mut region, desired) else {
                break;
            };
            found = nearest;
            let square = square_between(&found, desired);
            if square < least {
                (rates, least) = (found, square);
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

impl Search {
    fn new(most_rad_s: f64) -> Self {
        let unknown = |fastest_rad_s| Side {
            fastest_rad_s,
            slope: 0.0,
            newton_rad_s: 0.0,
        };
        Self {
            low: unknown(0.0),
            high: unknown(most_rad_s),
            last_slope: 0.0,
            bounded_rad_s: None,
        }
    }

    fn narrow(&mut self, fastest_rad_s: f64, slopes: &Slopes, bounded_rad_s: Option<f64>) {
        let slope = slopes.half_square;
        let newton_rad_s = if slopes.curvature > 0.0 {
            fastest_rad_s - slope / slopes.curvature
        } else {
            f64::NAN
        };
        let here = Side {
            fastest_rad_s,
            slope,
            newton_rad_s,
        };
        // Secants that lead to the same side twice begin at less of the other's slope (the Illinois method).
        let share = if self.last_slope * slope > 0.0 {
            0.5
        } else {
            1.0
        };
        if slope > 0.0 {
            self.low.slope *= share;
            self.high = here;
            self.bounded_rad_s = bounded_rad_s;
        } else {
            self.high.slope *= share;
            self.low = here;
        }
        self.last_slope = slope;
    }

    /// What is tried next; `None` where nothing is left to be gained.
    fn next_rad_s(&self) -> Option<f64> {
        let [low, high] = [&self.low, &self.high];
        let width = high.fastest_rad_s - low.fastest_rad_s;
        if width <= SAME * high.fastest_rad_s {
            return None;
        }
        if let Some(bounded_rad_s) = self.bounded_rad_s {
            let beyond = bounded_rad_s - low.fastest_rad_s;
            if beyond.abs() <= SAME * low.fastest_rad_s {
                // From far away that is what was expected, from near it is so.
                let near_rad_s = (1.0 + NEAR) * low.fastest_rad_s;
                return (near_rad_s < high.fastest_rad_s).then_some(near_rad_s);
            }
            if beyond > 0.0 && bounded_rad_s < high.fastest_rad_s {
                return Some(bounded_rad_s);
            }
        }
        let last = if self.last_slope > 0.0 { high } else { low };
        let share = (last.newton_rad_s - low.fastest_rad_s) / width;
        if share > MARGIN && share < 1.0 - MARGIN {
            return Some(last.newton_rad_s);
        }
        if low.slope == 0.0 {
            return Some(LESS * high.fastest_rad_s);
        }
        let is_inside = |side: &Side| {
            let inside = low.fastest_rad_s..high.fastest_rad_s;
            inside.contains(&side.newton_rad_s)
        };
        let leaps = !is_inside(low) && !is_inside(high);
        let share = if leaps {
            0.5
        } else {
            low.slope / (low.slope - high.slope)
        };
        Some(low.fastest_rad_s + share * width)
    }
}

/// At which fastest component (rad/s) the fastest one of these rates is bounded by that, when it changes with one over the way; `None`: it is bounded.
fn bounded_rad_s(
    stopping: Stopping,
    fastest_rad_s: f64,
    rates: &BendRates,
    slopes: &Slopes,
) -> Option<f64> {
    let components = rates.as_slice().iter().zip(&slopes.at);
    let most = components.max_by(|(one, _), (other, _)| one.abs().total_cmp(&other.abs()));
    let (rate, slope) = most.map(|(rate, slope)| (rate.abs(), slope * rate.signum()))?;
    if rate >= (1.0 - SAME) * fastest_rad_s {
        return None;
    }
    // rate(f) = a + b / way(f) = f, with way(f) = moving + f · way_slope.
    let (way_s, way_slope) = (stopping.way(fastest_rad_s).way_s, stopping.way_slope_s2());
    let b = -slope * way_s * way_s / way_slope;
    let a = rate - b / way_s;
    let p = stopping.moving_s - a * way_slope;
    let q = a * stopping.moving_s + b;
    Some(((p * p + 4.0 * way_slope * q).sqrt() - p) / (2.0 * way_slope))
}

fn square_between(one: &BendRates, other: &BendRates) -> f64 {
    let pairs = one.as_slice().iter().zip(other.as_slice());
    pairs.map(|(one, other)| (one - other).powi(2)).sum()
}

#[cfg(test)]
mod tests;
