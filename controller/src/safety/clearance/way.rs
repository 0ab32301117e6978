//! Whether a command keeps clear along its whole way: at its ends exactly, and between by what can be travelled.

use crate::robot::{BendRates, SECTIONS_MAX};

use super::Guard;
use super::near::{NEAR_MAX, Near, Place, Sections, Spare, ends_s, sections};

/// How often a part of the way is halved before it counts as not clear.
const DEPTH: u32 = 6;

/// The way of the robot at some rates.
struct Way<'a> {
    near: &'a Near,
    guard: &'a Guard<'a>,
    rates: &'a BendRates,
    /// What no point of each section moves faster than \[m/s\].
    travel_m_s: [f64; SECTIONS_MAX],
}

/// What is left at s = `way_s`.
#[derive(Clone, Copy)]
struct Left<'a> {
    way_s: f64,
    spare_m: &'a Spare,
}

/// The rule of [`Guard::keep_clear`], from where `near` was found.
pub(super) fn holds(near: &Near, guard: &Guard<'_>, rates: &BendRates) -> bool {
    if near.is_empty() {
        return true;
    }
    let way = Way {
        near,
        guard,
        rates,
        travel_m_s: travel_m_s(guard, rates),
    };
    let open = near.open(guard, &way.travel_m_s);
    if open == [0; NEAR_MAX] {
        return true;
    }
    // What is not clear mostly is not at the end of the way.
    let [period_s, end_s] = ends_s(guard);
    let spare_m = |way_s| {
        let place = near.place(guard, rates, way_s);
        near.spare_at(guard, &place, &open, false, |_| 0.0)
    };
    let (Some(end_spare_m), Some(period_spare_m)) = (spare_m(end_s), spare_m(period_s)) else {
        return false;
    };
    let start_spare_m = near.spare_at_start(&open);
    let [start, period, end] = [
        (0.0, &start_spare_m),
        (period_s, &period_spare_m),
        (end_s, &end_spare_m),
    ]
    .map(|(way_s, spare_m)| Left { way_s, spare_m });
    way.is_clear_between(start, period, &open, DEPTH)
        && way.is_clear_between(period, end, &open, DEPTH)
}

impl Way<'_> {
    /// Whether no spare falls below -[`Watched::dip_m`] between two places: by what can be travelled between them, and where that does
    /// not tell, by their middle. Where a moving obstacle is, is looked at once a period.
    ///
    /// [`Watched::dip_m`]: super::near::Watched::dip_m
    fn is_clear_between(&self, from: Left, to: Left, which: &Sections, depth: u32) -> bool {
        let open = self.unsettled(from, to, which);
        if open == [0; NEAR_MAX] {
            return true;
        }
        if depth == 0 || self.near.is_out_of_looks() {
            return false;
        }
        let way_s = 0.5 * (from.way_s + to.way_s);
        let place: Place = self.near.place(self.guard, self.rates, way_s);
        let (near, guard) = (self.near, self.guard);
        let Some(spare_m) = near.spare_at(guard, &place, &open, true, |watched| watched.dip_m)
        else {
            return false;
        };
        let middle = Left {
            way_s,
            spare_m: &spare_m,
        };
        self.is_clear_between(from, middle, &open, depth - 1)
            && self.is_clear_between(middle, to, &open, depth - 1)
    }

    /// Those that can have come nearer between.
    fn unsettled(&self, from: Left, to: Left, which: &Sections) -> Sections {
        let stopping = &self.guard.stopping;
        let time_s = stopping.time_s(to.way_s) - stopping.time_s(from.way_s);
        let obstacles = if time_s > self.guard.period_s {
            2.0
        } else {
            0.0
        };
        let mut open = [0; NEAR_MAX];
        for (index, watched) in self.near.watched().enumerate() {
            for j in sections(which[index]) {
                // Both the clearance of the robot, and that of the one that stands still, change by its motion.
                let travel_m = self.travel_m_s[j] * (to.way_s - from.way_s)
                    + obstacles * watched.moves_m(time_s);
                let spare_m = from.spare_m[index][j] + to.spare_m[index][j];
                let is_settled = 0.5 * (spare_m - travel_m) >= -watched.dip_m;
                open[index] |= u8::from(!is_settled) << j;
            }
        }
        open
    }
}

/// What no point of each section moves faster than at these rates \[m/s\].
fn travel_m_s(guard: &Guard<'_>, rates: &BendRates) -> [f64; SECTIONS_MAX] {
    let change = core::array::from_fn(|j| {
        let [u, v] = rates.section(j);
        u.hypot(v)
    });
    guard.robot.travel_m(&change)
}
