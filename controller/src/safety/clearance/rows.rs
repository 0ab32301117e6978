//! The half-spaces of rates in which clearances that are too small become as large as they must be.

use crate::robot::{BendRates, COORDINATES_MAX, Nearest};
use crate::safety::projection::Region;

use super::ClearanceGuard;
use super::near::{Near, Place, ROW_LOOKS, ends_s, sections};
use super::watched::Watched;

/// What a correction asks for beyond the allowed clearance \[m\], so that rounding does not undo it.
const MARGIN_M: f64 = 1e-9;
/// Rows that are taken at once, at most.
const ROWS_MAX: usize = 56;

/// A clearance that is too small, or may be.
#[derive(Clone, Copy)]
struct Short<'a> {
    /// What is left, at least \[m\].
    spare_m: f64,
    place: &'a Place,
    watched: &'a Watched<'a>,
    index: usize,
    section: usize,
    /// Where both are nearest there.
    nearest: Nearest,
}

/// Bounds `region` to where the clearances that are too small are as large as they must be, to first order: those at the place where the
/// check of these rates found one. Whether there were some. Of very many the smallest are left out.
pub(super) fn bound(
    near: &Near<'_>,
    guard: &ClearanceGuard<'_>,
    rates: &BendRates,
    region: &mut Region,
) -> bool {
    let Some(lack) = near.lack() else {
        return false;
    };
    let place = near.place(guard, rates, lack.way_s);
    let mut least = Least {
        rows: [None; ROWS_MAX],
        count: 0,
    };
    let is_end = ends_s(guard, rates).contains(&lack.way_s);
    for (index, watched) in near.watched().enumerate() {
        let there = watched.after(place.time_s);
        for section in sections(watched.sections()) {
            let floor_m = watched.floor_most_m(section, place.time_s);
            // Between the ends, the one that was found counts as too small, and no other.
            let enough_m = if is_end {
                floor_m
            } else if (index, section) == (lack.index, lack.section) {
                f64::INFINITY
            } else {
                continue;
            };
            if let Some(nearest) = near.nearest_below(&place, &there, section, enough_m) {
                least.insert(Short {
                    spare_m: nearest.clearance_m - floor_m,
                    place: &place,
                    watched,
                    index,
                    section,
                    nearest,
                });
            }
        }
    }
    let shorts = || least.rows.iter().flatten();
    for short in shorts() {
        if near.has_row(short.index, short.section) {
            short.bound(near, guard, &short.nearest, Some(rates), region);
        } else {
            short.bound(near, guard, &short.standing(near), None, region);
        }
    }
    for short in shorts() {
        near.note_row(short.index, short.section);
    }
    least.count > 0
}

/// Bounds `region` at both ends of the way of `desired_rates` for every clearance that had a row, and for those that are too small: all of
/// them to first order around the same rates, or around the robot that stands still.
pub(super) fn bound_again(
    near: &Near<'_>,
    guard: &ClearanceGuard<'_>,
    desired_rates: &BendRates,
    around: Option<&BendRates>,
    region: &mut Region,
) {
    let rest = BendRates::zero(desired_rates.section_count());
    for way_s in ends_s(guard, desired_rates) {
        let place = near.place(guard, around.unwrap_or(&rest), way_s);
        for (index, watched) in near.watched().enumerate() {
            let there = watched.after(place.time_s);
            for section in sections(watched.sections()) {
                let floor_m = watched.floor_most_m(section, place.time_s);
                let enough_m = match around {
                    _ if near.has_row(index, section) => f64::INFINITY,
                    Some(_) => floor_m,
                    None => continue,
                };
                if let Some(nearest) = near.nearest_below(&place, &there, section, enough_m) {
                    near.note_row(index, section);
                    let short = Short {
                        spare_m: 0.0,
                        place: &place,
                        watched,
                        index,
                        section,
                        nearest,
                    };
                    short.bound(near, guard, &nearest, around, region);
                }
            }
        }
    }
}

/// Those with the least spare.
struct Least<'a> {
    rows: [Option<Short<'a>>; ROWS_MAX],
    count: usize,
}

impl<'a> Least<'a> {
    fn insert(&mut self, short: Short<'a>) {
        if self.count < ROWS_MAX {
            self.rows[self.count] = Some(short);
            self.count += 1;
            return;
        }
        let known = self.rows.iter_mut().flatten();
        if let Some(most) = known.max_by(|one, other| one.spare_m.total_cmp(&other.spare_m))
            && short.spare_m < most.spare_m
        {
            *most = short;
        }
    }
}

impl Short<'_> {
    /// Where both are nearest when the robot stands still.
    fn standing(&self, near: &Near<'_>) -> Nearest {
        near.count(self.watched.looks());
        let there = self.watched.after(self.place.time_s);
        near.still().body.nearest_of(self.section, there.obstacle())
    }

    /// To first order around these rates, or around the robot that stands still: there each clearance is as large as it must be, so
    /// that there is a region.
    fn bound(
        &self,
        near: &Near<'_>,
        guard: &ClearanceGuard<'_>,
        nearest: &Nearest,
        around: Option<&BendRates>,
        region: &mut Region,
    ) {
        near.count(ROW_LOOKS);
        let stance = around.map_or(near.still(), |_| &self.place.stance);
        let mut columns = [[0.0; 3]; COORDINATES_MAX];
        let motion = stance.motion(guard.robot);
        motion.point_jacobian(self.section, nearest.s, &mut columns);
        let d = &nearest.direction;
        let slope = columns.map(|[x, y, z]| self.place.way_s * (d.x * x + d.y * y + d.z * z));
        let least_m = if let Some(rates) = around {
            let rates = rates.as_slice().iter();
            let gained_m: f64 = rates.zip(slope).map(|(rate, slope)| rate * slope).sum();
            let there = self.watched.after(self.place.time_s);
            let floor_m = near.floor_m(&there, self.section);
            gained_m + MARGIN_M + floor_m - nearest.clearance_m
        } else {
            // The clearance is what is left to the robot that stands still, and at least the floor.
            self.watched.kept_m.min(nearest.clearance_m) - nearest.clearance_m
        };
        region.bound(&slope, least_m);
    }
}
