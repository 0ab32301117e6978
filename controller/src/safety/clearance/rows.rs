//! The half-spaces of rates in which clearances that are too small become as large as they must be.

use crate::robot::{BendRates, COORDINATES_MAX};
use crate::safety::projection::Region;

use super::ClearanceGuard;
use super::near::{Near, Place, ROW_LOOKS, Watched, ends_s, sections};

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
    if ends_s(guard, rates).contains(&lack.way_s) {
        for (index, watched) in near.watched().enumerate() {
            for section in sections(watched.sections()) {
                least.insert_if_short(near, &place, index, section, false);
            }
        }
    } else {
        least.insert_if_short(near, &place, lack.index, lack.section, true);
    }
    let shorts = || least.rows.iter().flatten();
    for short in shorts() {
        let is_first = !near.has_row(short.index, short.section);
        short.bound(near, guard, (!is_first).then_some(rates), region);
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
            for section in sections(watched.sections()) {
                let floor_m = watched.floor_most_m(section, place.time_s);
                let is_short = || near.clearance_m(&place, watched, section, floor_m) < floor_m;
                if near.has_row(index, section) || around.is_some() && is_short() {
                    near.note_row(index, section);
                    let short = Short {
                        spare_m: 0.0,
                        place: &place,
                        watched,
                        index,
                        section,
                    };
                    short.bound(near, guard, around, region);
                }
            }
        }
    }
}

/// Those with the least spare, in its order.
struct Least<'a> {
    rows: [Option<Short<'a>>; ROWS_MAX],
    count: usize,
}

impl<'a> Least<'a> {
    /// A clearance that was found between the ends counts as too small.
    fn insert_if_short(
        &mut self,
        near: &'a Near<'_>,
        place: &'a Place,
        index: usize,
        section: usize,
        is_found: bool,
    ) {
        let Some(watched) = near.watched_at(index) else {
            return;
        };
        let floor_m = watched.floor_most_m(section, place.time_s);
        let clearance_m = near.clearance_m(place, watched, section, floor_m);
        let spare_m = clearance_m - floor_m;
        if spare_m < 0.0 || is_found {
            self.insert(Short {
                spare_m,
                place,
                watched,
                index,
                section,
            });
        }
    }

    fn insert(&mut self, short: Short<'a>) {
        let is_before = |row: &Option<Short<'_>>| row.is_some_and(|r| r.spare_m <= short.spare_m);
        let place = self.rows.partition_point(is_before);
        if place < ROWS_MAX {
            self.count = (self.count + 1).min(ROWS_MAX);
            self.rows[place..self.count].rotate_right(1);
            self.rows[place] = Some(short);
        }
    }
}

impl Short<'_> {
    /// To first order around these rates, or around the robot that stands still: there each clearance is as large as it must be, so
    /// that there is a region.
    fn bound(
        &self,
        near: &Near<'_>,
        guard: &ClearanceGuard<'_>,
        around: Option<&BendRates>,
        region: &mut Region,
    ) {
        near.count(ROW_LOOKS + self.watched.looks());
        let obstacle = self.watched.obstacle_at(self.place.time_s);
        let stance = around.map_or(near.still(), |_| &self.place.stance);
        let nearest = stance.body.nearest_of(self.section, &obstacle);
        let mut columns = [[0.0; 3]; COORDINATES_MAX];
        let motion = stance.motion(guard.robot);
        motion.point_jacobian(self.section, nearest.s, &mut columns);
        let d = &nearest.direction;
        let slope = columns.map(|[x, y, z]| self.place.way_s * (d.x * x + d.y * y + d.z * z));
        let least_m = if let Some(rates) = around {
            let rates = rates.as_slice().iter();
            let gained_m: f64 = rates.zip(slope).map(|(rate, slope)| rate * slope).sum();
            let floor_m = near.floor_m(self.watched, self.section, self.place.time_s);
            gained_m + MARGIN_M + floor_m - nearest.clearance_m
        } else {
            // The clearance is what is left to the robot that stands still, and at least the floor.
            self.watched.kept_m.min(nearest.clearance_m) - nearest.clearance_m
        };
        region.bound(&slope, least_m);
    }
}
