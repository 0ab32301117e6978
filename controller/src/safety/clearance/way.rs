//! Whether a command keeps clear along its whole way: at its ends exactly, and between by what can be travelled.

use crate::robot::{BendRates, SECTIONS_MAX};

use super::near::{NEAR_MAX, Near, Place, Sections, Spare, Stance, ends_s, sections};
use super::watched::{There, Watched};
use super::{ClearanceGuard, StoppingWay, fastest};

/// How often a part of the way is halved before it counts as not clear.
const DEPTH: u32 = 9;
/// The share of rates that is tried next where no clearance tells one.
const HALF: f64 = 0.5;

/// The way of the robot at some rates.
struct Way<'a> {
    near: &'a Near<'a>,
    guard: &'a ClearanceGuard<'a>,
    rates: &'a BendRates,
    stopping: StoppingWay,
    /// What no point of each section moves faster than \[m/s\].
    travel_m_s: [f64; SECTIONS_MAX],
    /// What none of them is accelerated by more \[m/s²\].
    acceleration_m_s2: [f64; SECTIONS_MAX],
}

/// What is left at s = `way_s`.
#[derive(Clone, Copy)]
struct Left<'a> {
    way_s: f64,
    stance: &'a Stance,
    spare_m: &'a Spare,
}

/// Whether the rule of [`ClearanceGuard::apply`] holds from where `near` was found.
///
/// # Errors
/// The share of the rates for which the first clearance that is too small is as large as it must be, were it linear.
pub(super) fn check(
    near: &Near<'_>,
    guard: &ClearanceGuard<'_>,
    rates: &BendRates,
) -> Result<(), f64> {
    if near.is_empty() {
        return Ok(());
    }
    let turn_rad_s = guard.bent_most(core::array::from_fn(|j| {
        let [u, v] = rates.section(j);
        (u * u + v * v).sqrt()
    }));
    let way = Way {
        near,
        guard,
        rates,
        stopping: guard.stopping.way(fastest(rates)),
        travel_m_s: guard.robot.travel_m(&turn_rad_s),
        acceleration_m_s2: guard.robot.acceleration_m_s2(&turn_rad_s),
    };
    let open = near.open(&way.stopping, &way.travel_m_s);
    if open == [0; NEAR_MAX] {
        return Ok(());
    }
    // What is not clear mostly is not at the end of the way.
    let [period_s, end_s] = ends_s(guard, rates);
    let mut spare_m = [[[0.0; SECTIONS_MAX]; NEAR_MAX]; 3];
    let [start_m, period_m, end_m] = &mut spare_m;
    let lack_m = |_: &Watched<'_>| guard.rounding_m();
    let end = near.place(guard, rates, end_s);
    near.spare_at(&end, &open, lack_m, end_m)?;
    let period = near.place(guard, rates, period_s);
    near.spare_at(&period, &open, lack_m, period_m)?;
    near.spare_at_start(&open, start_m);
    let start = Left {
        way_s: 0.0,
        stance: near.still(),
        spare_m: start_m,
    };
    let (period, end) = (Left::new(&period, period_m), Left::new(&end, end_m));
    way.is_clear_between(start, period, &open, DEPTH)?;
    way.is_clear_between(period, end, &open, DEPTH)
}

impl<'a> Left<'a> {
    fn new(place: &'a Place, spare_m: &'a Spare) -> Self {
        Self {
            way_s: place.way_s,
            stance: &place.stance,
            spare_m,
        }
    }
}

impl Way<'_> {
    /// Whether no spare falls below -[`Watched::dip_m`] between two places: by what can be travelled between them, and where that does
    /// not tell, by their middle. Where a moving obstacle is, is looked at once a period.
    fn is_clear_between(
        &self,
        from: Left<'_>,
        to: Left<'_>,
        which: &Sections,
        depth: u32,
    ) -> Result<(), f64> {
        let open = self.unsettled(from, to, which);
        if open == [0; NEAR_MAX] {
            return Ok(());
        }
        let way_s = self.middle_s(from.way_s, to.way_s, &open);
        if depth == 0 || self.near.is_out_of_looks() {
            if let Some(index) = open.iter().position(|bits| *bits != 0) {
                let section = open[index].trailing_zeros() as usize;
                self.near.set_lack(index, section, way_s);
            }
            return Err(HALF);
        }
        let place: Place = self.near.place(self.guard, self.rates, way_s);
        let dip_m = |watched: &Watched<'_>| watched.dip_m;
        let mut spare_m = [[0.0; SECTIONS_MAX]; NEAR_MAX];
        self.near.spare_at(&place, &open, dip_m, &mut spare_m)?;
        let middle = Left::new(&place, &spare_m);
        self.is_clear_between(from, middle, &open, depth - 1)?;
        self.is_clear_between(middle, to, &open, depth - 1)
    }

    /// Between two places of the way: where obstacles move for longer than a period, in the middle of that time.
    fn middle_s(&self, from_s: f64, to_s: f64, open: &Sections) -> f64 {
        let times_s = [from_s, to_s].map(|way_s| self.stopping.time_s(way_s));
        let is_open = |(watched, open): (&Watched<'_>, &u8)| *open != 0 && !watched.stands();
        if times_s[1] - times_s[0] > self.guard.period_s
            && self.near.watched().zip(open).any(is_open)
        {
            self.stopping.way_after_s(0.5 * (times_s[0] + times_s[1]))
        } else {
            0.5 * (from_s + to_s)
        }
    }

    /// Those that can have come nearer between.
    ///
    /// A point that goes from p to p' in h seconds is nowhere farther from both together than |p' - p| and twice what it leaves
    /// the chord by: that is at most its acceleration · h²/8.
    fn unsettled(&self, from: Left<'_>, to: Left<'_>, which: &Sections) -> Sections {
        let stopping = &self.stopping;
        let time_s = stopping.time_s(to.way_s) - stopping.time_s(from.way_s);
        // What it moves in a period may lack.
        let counted_s = (time_s - self.guard.period_s).max(0.0);
        let way_s = to.way_s - from.way_s;
        let is_even = self.guard.is_even_between(self.rates, from.way_s, to.way_s);
        let chords_m = to.stance.displacement_m(self.guard.robot, from.stance);
        let travel_m: [f64; SECTIONS_MAX] = core::array::from_fn(|j| {
            let most_m = self.travel_m_s[j] * way_s;
            let bent_m = chords_m[j] + 0.25 * self.acceleration_m_s2[j] * way_s * way_s;
            if is_even { bent_m.min(most_m) } else { most_m }
        });
        let mut open = [0; NEAR_MAX];
        for (index, watched) in self.near.watched().enumerate() {
            for j in sections(which[index]) {
                // Both the clearance of the robot, and that of the one that stands still, change by its motion.
                let travel_m = travel_m[j] + 2.0 * watched.moves_m(counted_s);
                let spare_m = from.spare_m[index][j] + to.spare_m[index][j];
                let is_settled = 0.5 * (spare_m - travel_m) >= -watched.dip_m
                    || is_even && self.is_apart([from, to], watched, j);
                open[index] |= u8::from(!is_settled) << j;
            }
        }
        open
    }

    /// Whether a plane between section j and an obstacle keeps them apart from one place to another one. Along a direction d the points of the section leave the line between
    /// both places by their acceleration · h²/8 at most, the obstacle moves evenly in time, and time is at most a quarter of its span beside what is even on the way.
    fn is_apart(&self, [from, to]: [Left<'_>; 2], watched: &Watched<'_>, j: usize) -> bool {
        let times_s = [from, to].map(|left| self.stopping.time_s(left.way_s));
        let there = times_s.map(|time_s| watched.after(time_s));
        let Some(direction) = self.near.direction(&to.stance.body, &there[1], j) else {
            return false;
        };
        let least_m = |left: Left<'_>, there: &There<'_>| {
            (left.stance.body).clearance_min_along(j, there.obstacle(), &direction)
        };
        let way_s = to.way_s - from.way_s;
        let bent_m = 0.125 * self.acceleration_m_s2[j] * way_s * way_s;
        let shifted_m = if self.stopping.is_even(to.way_s) {
            0.0
        } else {
            let along_m_s = direction.dot(&watched.obstacle.velocity_m_s()).abs();
            0.25 * along_m_s * (times_s[1] - times_s[0])
        };
        let floor_m = if watched.stands() {
            watched.start_m[j].min(watched.kept_m)
        } else {
            watched.kept_m
        };
        // Of a section that is bent by more than half a circle a plane tells nothing: NaN, at either place.
        let keeps_m = floor_m - watched.dip_m + bent_m + shifted_m;
        least_m(from, &there[0]) >= keeps_m && least_m(to, &there[1]) >= keeps_m
    }
}
