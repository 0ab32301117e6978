//! The half-spaces of rates in which clearances that are too small become as large as they must be.

use crate::robot::{BendRates, COORDINATES_MAX, Nearest};
use crate::safety::projection::Region;

use super::near::{Near, Place, ROUNDING_M, ROW_LOOKS, SOLVED_LOOKS, ends_s, sections};
use super::watched::Watched;
use super::{Beginning, ClearanceGuard, fastest};

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

/// What a half-space is to first order around.
#[derive(Clone, Copy)]
enum Around<'a> {
    /// The robot that stands still; wider by what these rates gain.
    Rest { wider_rad_s: f64 },
    /// Rates, with what is asked for beyond the allowed clearance.
    Rates { rates: &'a BendRates, margin_m: f64 },
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
            let margin_m = MARGIN_M;
            short.bound(
                near,
                guard,
                &short.nearest,
                Around::Rates { rates, margin_m },
                region,
            );
        } else {
            let wider_rad_s = 0.0;
            short.bound(
                near,
                guard,
                &short.standing(near),
                Around::Rest { wider_rad_s },
                region,
            );
        }
    }
    for short in shorts() {
        near.note_row(short.index, short.section);
    }
    least.count > 0
}

/// Bounds `region` at both ends of the way for every clearance that can bound it: to first order around the robot that stands still, where half-spaces are wider by the
/// slack of `beginning`; or around other rates, there for those alone that had a row or are too small, and where something lacked between the ends.
pub(super) fn bound_again(
    near: &Near<'_>,
    guard: &ClearanceGuard<'_>,
    desired_rates: &BendRates,
    around: Option<&BendRates>,
    beginning: &Beginning,
    region: &mut Region,
) {
    let row_around = match around {
        None => Around::Rest {
            wider_rad_s: beginning.slack * fastest(desired_rates),
        },
        Some(rates) => Around::Rates {
            rates,
            margin_m: beginning.margin_m,
        },
    };
    let rest = BendRates::zero(desired_rates.section_count());
    let farthest_m = guard.farthest_m(desired_rates);
    let longest_s = guard.stopping.way(fastest(desired_rates)).way_s;
    let [period_s, end_s] = ends_s(guard, around.unwrap_or(desired_rates));
    let between = near.between().filter(|_| around.is_some());
    for way_s in [Some(period_s), Some(end_s), between.map(|lack| lack.way_s)] {
        let Some(way_s) = way_s else { break };
        let place = near.place(guard, around.unwrap_or(&rest), way_s);
        let is_end = way_s == period_s || way_s == end_s;
        // From rest to any rates; from rates to any others it is twice as far.
        let changes = if around.is_some() { 2.0 } else { 1.0 } * way_s / longest_s;
        for (index, watched) in near.watched().enumerate() {
            if near.is_out_of_looks() {
                // What is missing then is caught by the check, which has none either.
                return;
            }
            if around.is_none() && watched.stands() && way_s < end_s {
                // The end tells more.
                continue;
            }
            let there = watched.after(place.time_s);
            for section in sections(watched.sections()) {
                let lacks =
                    between.is_some_and(|lack| (lack.index, lack.section) == (index, section));
                let enough_m = if !is_end && !lacks {
                    continue;
                } else if lacks || around.is_none() || near.has_row(index, section) {
                    // No rates that are not faster lead from farther away to what is kept.
                    watched.kept_m + changes * farthest_m[section] + ROUNDING_M
                } else {
                    watched.floor_most_m(section, place.time_s)
                };
                if let Some(nearest) = near.nearest_below(&place, &there, section, enough_m) {
                    let short = Short {
                        spare_m: 0.0,
                        place: &place,
                        watched,
                        index,
                        section,
                        nearest,
                    };
                    if short.bound(near, guard, &nearest, row_around, region) {
                        near.note_row(index, section);
                    }
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
    /// that there is a region. Whether that bounds it.
    fn bound(
        &self,
        near: &Near<'_>,
        guard: &ClearanceGuard<'_>,
        nearest: &Nearest,
        around: Around<'_>,
        region: &mut Region,
    ) -> bool {
        near.count(ROW_LOOKS);
        let stance = match around {
            Around::Rest { .. } => near.still(),
            Around::Rates { .. } => &self.place.stance,
        };
        let mut columns = [[0.0; 3]; COORDINATES_MAX];
        let motion = stance.motion(guard.robot);
        motion.point_jacobian(self.section, nearest.s, &mut columns);
        let d = &nearest.direction;
        let slope = columns.map(|[x, y, z]| self.place.way_s * (d.x * x + d.y * y + d.z * z));
        let least_m = match around {
            Around::Rates { rates, margin_m } => {
                let rates = rates.as_slice().iter();
                let gained_m: f64 = rates.zip(slope).map(|(rate, slope)| rate * slope).sum();
                let there = self.watched.after(self.place.time_s);
                let floor_m = near.floor_m(&there, self.section);
                gained_m + margin_m + floor_m - nearest.clearance_m
            }
            Around::Rest { wider_rad_s } => {
                // The clearance is what is left to the robot that stands still, and at least the floor.
                let left_m = (nearest.clearance_m - self.watched.kept_m).max(0.0);
                let slope_m_s = slope.iter().map(|slope| slope * slope).sum::<f64>().sqrt();
                -left_m - wider_rad_s * slope_m_s
            }
        };
        let is_bound = region.bound(&slope, least_m);
        if is_bound {
            near.count(SOLVED_LOOKS);
        }
        is_bound
    }
}
