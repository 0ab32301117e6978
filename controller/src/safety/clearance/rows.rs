//! The half-spaces of rates in which clearances that are too small become as large as they must be.

use crate::robot::{BendRates, COORDINATES_MAX, SECTIONS_MAX};
use crate::safety::projection::Region;

use super::Guard;
use super::near::{NEAR_MAX, Near, Place, Watched, ends_s, sections};

/// What a correction asks for beyond the allowed clearance \[m\], so that rounding does not undo it.
const MARGIN_M: f64 = 1e-9;
/// Every section of every watched obstacle at both ends.
const ROWS_MAX: usize = 2 * NEAR_MAX * SECTIONS_MAX;

/// A clearance that is too small.
#[derive(Clone, Copy)]
struct Short<'a> {
    spare_m: f64,
    place: &'a Place,
    watched: &'a Watched,
    section: usize,
}

/// Bounds `region` to where the clearances that are too small at these rates are as large as they must be, to first order.
/// Whether there were some. Where `region` has no room for all of them, the smallest are left out.
pub(super) fn bound(
    near: &Near,
    guard: &Guard<'_>,
    rates: &BendRates,
    region: &mut Region,
) -> bool {
    let places = ends_s(guard).map(|way_s| near.place(guard, rates, way_s));
    let mut short: [Option<Short<'_>>; ROWS_MAX] = [None; ROWS_MAX];
    let mut count = 0;
    for place in &places {
        for watched in near.watched() {
            for section in sections(watched.sections()) {
                let spare_m = near.spare_m(guard, place, watched, section, false);
                if spare_m < 0.0 {
                    short[count] = Some(Short {
                        spare_m,
                        place,
                        watched,
                        section,
                    });
                    count += 1;
                }
            }
        }
    }
    let short = &mut short[..count];
    let spare_m = |short: &Option<Short<'_>>| short.map_or(0.0, |short| short.spare_m);
    short.sort_unstable_by(|a, b| spare_m(a).total_cmp(&spare_m(b)));
    for short in short.iter().flatten() {
        if !region.has_room() {
            break;
        }
        short.bound(guard, rates, region);
    }
    count > 0
}

impl Short<'_> {
    fn bound(&self, guard: &Guard<'_>, rates: &BendRates, region: &mut Region) {
        let (stance, way_s) = (&self.place.stance, self.place.way_s);
        let obstacle = self.watched.at(self.place);
        let nearest = stance.body.nearest_of(self.section, &obstacle);
        let mut columns = [[0.0; 3]; COORDINATES_MAX];
        guard
            .robot
            .body_point_jacobian(&stance.at, self.section, nearest.s, &mut columns);
        let d = &nearest.direction;
        let slope = columns.map(|[x, y, z]| way_s * (d.x * x + d.y * y + d.z * z));
        let rates = rates.as_slice().iter();
        let gained_m: f64 = rates.zip(slope).map(|(rate, slope)| rate * slope).sum();
        region.bound(&slope, gained_m + MARGIN_M - self.spare_m);
    }
}
