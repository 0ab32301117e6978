//! The obstacles that the body can get too near to, section by section, and whether it does.

use core::cell::Cell;

use crate::robot::{BendRates, Body, COORDINATES_MAX, Configuration, Obstacle, SECTIONS_MAX};
use crate::safety::projection::Region;

use super::{Guard, fastest};

/// Obstacles that are watched one by one. When more than these are within reach, the robot stands still.
pub(super) const NEAR_MAX: usize = 64;
/// What a correction asks for beyond the allowed clearance \[m\], so that rounding does not undo it.
const MARGIN_M: f64 = 1e-9;
/// What is not looked for between two places of the way \[m\], at most: half of what lies between the axes at distance D, if
/// that is less, so that no thin section jumps through a thin obstacle.
const DIP_M: f64 = 1e-3;
/// Obstacles that are looked at in all places of one command, before what is not known to be clear counts as not clear.
const LOOKS: u32 = 6000;
/// How often a part of the way is halved before it counts as not clear.
const DEPTH: u32 = 6;

/// What is left of a clearance beyond what must be \[m\], of each watched obstacle and each of the sections: infinite where
/// nothing is watched, NaN where the state is not finite.
type Spare = [[f64; SECTIONS_MAX]; NEAR_MAX];

/// The watched obstacles.
pub(super) struct Near {
    at: Configuration,
    /// The robot that stands still there.
    still: Body,
    watched_count: u32,
    /// What is left of [`LOOKS`].
    looks: Cell<u32>,
    watched: [Option<Watched>; NEAR_MAX],
}

#[derive(Clone, Copy)]
struct Watched {
    obstacle: Obstacle,
    speed_m_s: f64,
    /// A section that is farther than this at one place of the way keeps clear along all of it \[m\]; -∞ for one that is not
    /// watched.
    reach_m: [f64; SECTIONS_MAX],
    /// What each section must keep at the ends of [`ends_s`] \[m\].
    floors_m: [[f64; SECTIONS_MAX]; 2],
    /// As [`DIP_M`].
    dip_m: f64,
}

/// A place of the way: bend + s q̇.
struct Place {
    way_s: f64,
    spare_m: Spare,
}

impl Near {
    /// Those of a robot that is `at` a configuration, with this `body`. `None` when there are more than fit.
    pub(super) fn find(
        guard: &Guard<'_>,
        at: &Configuration,
        body: &Body,
        rates: &BendRates,
    ) -> Option<Self> {
        let (way_s, safe_m) = (guard.stopping.way_s, guard.safe_distance_m);
        let travel_m = farthest_m(guard, rates);
        let time_s = guard.stopping.time_s(way_s);
        let mut near = Self {
            at: *at,
            still: *body,
            watched_count: 0,
            looks: Cell::new(LOOKS),
            watched: [None; NEAR_MAX],
        };
        let thinnest_m = guard
            .robot
            .sections()
            .iter()
            .map(|section| section.body_radius_m);
        let thinnest_m = thinnest_m.fold(f64::INFINITY, f64::min);
        let mut slots = near.watched.iter_mut();
        for obstacle in guard.obstacles {
            let speed_m_s = obstacle.velocity_m_s().norm();
            let reach_m = travel_m.map(|travel_m| safe_m + travel_m + 2.0 * time_s * speed_m_s);
            if !body.reaches(obstacle, reach_m.into_iter().fold(0.0, f64::max)) {
                continue;
            }
            let sections = body.sections_in_reach(obstacle, &reach_m);
            if sections != 0 {
                let mut watched = Watched {
                    obstacle: *obstacle,
                    speed_m_s,
                    reach_m: core::array::from_fn(|j| {
                        let is_watched = sections & (1 << j) != 0;
                        if is_watched {
                            reach_m[j]
                        } else {
                            f64::NEG_INFINITY
                        }
                    }),
                    floors_m: [[0.0; SECTIONS_MAX]; 2],
                    dip_m: DIP_M.min(0.5 * (safe_m + thinnest_m + obstacle.radius_m())),
                };
                watched.floors_m = if speed_m_s == 0.0 {
                    [watched.floor_m(guard, body, 0.0); 2]
                } else {
                    ends_s(guard).map(|way_s| watched.floor_m(guard, body, way_s))
                };
                *slots.next()? = Some(watched);
                near.watched_count += 1;
            }
        }
        Some(near)
    }

    fn watched(&self) -> impl Iterator<Item = &Watched> {
        self.watched.iter().map_while(Option::as_ref)
    }

    /// The rule of [`Guard::keep_clear`].
    pub(super) fn holds(&self, guard: &Guard<'_>, rates: &BendRates) -> bool {
        if self.watched_count == 0 {
            return true;
        }
        if self.looks.get() == 0 {
            return false;
        }
        let all = u64::MAX;
        let is_clear = |place: &Place| {
            place
                .spare_m
                .iter()
                .flatten()
                .all(|spare_m| *spare_m >= 0.0)
        };
        let [period_s, end_s] = ends_s(guard);
        let period = self.place(guard, rates, period_s, all);
        if !is_clear(&period) {
            return false;
        }
        let end = self.place(guard, rates, end_s, all);
        if !is_clear(&end) {
            return false;
        }
        let start = self.place(guard, rates, 0.0, all);
        let way = Way {
            near: self,
            guard,
            rates,
            travel_m_s: travel_m_s(guard, rates),
        };
        way.is_clear_between(&start, &period, all, DEPTH)
            && way.is_clear_between(&period, &end, all, DEPTH)
    }

    /// Bounds `region` to where the clearances that are too small at these rates are as large as they must be, to first order.
    /// Whether there were some.
    pub(super) fn bound(&self, guard: &Guard<'_>, rates: &BendRates, region: &mut Region) -> bool {
        let mut is_bounded = false;
        for way_s in ends_s(guard) {
            let place = self.place(guard, rates, way_s, u64::MAX);
            let next = self.at.advanced(rates, place.way_s);
            let body = guard.robot.body(&next);
            for (watched, spare_m) in self.watched().zip(&place.spare_m) {
                for (section, spare_m) in spare_m.iter().enumerate() {
                    if *spare_m < 0.0 {
                        let obstacle = watched.at(guard, place.way_s);
                        let nearest = body.nearest_of(section, &obstacle);
                        let mut columns = [[0.0; 3]; COORDINATES_MAX];
                        guard
                            .robot
                            .body_point_jacobian(&next, section, nearest.s, &mut columns);
                        let d = &nearest.direction;
                        let slope =
                            columns.map(|[x, y, z]| place.way_s * (d.x * x + d.y * y + d.z * z));
                        let gained_m: f64 = rates
                            .as_slice()
                            .iter()
                            .zip(slope)
                            .map(|(rate, slope)| rate * slope)
                            .sum();
                        region.bound(&slope, gained_m + MARGIN_M - spare_m);
                        is_bounded = true;
                    }
                }
            }
        }
        is_bounded
    }

    /// The place at s = `way_s`, with the spare of the watched obstacles whose bits are in `which`.
    fn place(&self, guard: &Guard<'_>, rates: &BendRates, way_s: f64, which: u64) -> Place {
        let looks = which.count_ones().min(self.watched_count);
        self.looks.set(self.looks.get().saturating_sub(looks));
        let body = guard.robot.body(&self.at.advanced(rates, way_s));
        let mut spare_m = [[f64::INFINITY; SECTIONS_MAX]; NEAR_MAX];
        for (index, watched) in self.watched().enumerate() {
            if which & (1 << index) != 0 {
                spare_m[index] = watched.spare_m(guard, &self.still, &body, way_s);
            }
        }
        Place { way_s, spare_m }
    }
}

impl Watched {
    /// Where it is when the robot has come to s = `way_s`.
    fn at(&self, guard: &Guard<'_>, way_s: f64) -> Obstacle {
        if self.speed_m_s == 0.0 {
            return self.obstacle;
        }
        self.obstacle.moved(guard.stopping.time_s(way_s))
    }

    /// What is left to `body`, where the robot is at s = `way_s`.
    fn spare_m(
        &self,
        guard: &Guard<'_>,
        still: &Body,
        body: &Body,
        way_s: f64,
    ) -> [f64; SECTIONS_MAX] {
        let floor_m = match ends_s(guard).iter().position(|end_s| *end_s == way_s) {
            Some(end) => self.floors_m[end],
            None if self.speed_m_s == 0.0 => self.floors_m[0],
            None => self.floor_m(guard, still, way_s),
        };
        let clearances_m = body.clearances_in_reach(&self.at(guard, way_s), &self.reach_m);
        core::array::from_fn(|j| clearances_m[j] - floor_m[j])
    }

    /// What each section must keep at s = `way_s`: min(D, what is left to the robot that stands still). A NaN gives D, which
    /// no NaN reaches.
    fn floor_m(&self, guard: &Guard<'_>, still: &Body, way_s: f64) -> [f64; SECTIONS_MAX] {
        let safe_m = guard.safe_distance_m;
        let standing_m = still.clearances_in_reach(&self.at(guard, way_s), &[safe_m; SECTIONS_MAX]);
        standing_m.map(|clearance_m| clearance_m.min(safe_m))
    }
}

/// Where the rule holds exactly: after the period, and after the stopping way.
fn ends_s(guard: &Guard<'_>) -> [f64; 2] {
    [guard.period_s, guard.stopping.way_s]
}

/// The way of the robot at these rates.
struct Way<'a> {
    near: &'a Near,
    guard: &'a Guard<'a>,
    rates: &'a BendRates,
    /// What no point of each section moves faster than \[m/s\].
    travel_m_s: [f64; SECTIONS_MAX],
}

impl Way<'_> {
    /// Whether no spare falls below -[`Watched::dip_m`] between two places: by what can be travelled between them, and where that does
    /// not tell, by their middle. Where a moving obstacle is, is looked at once a period.
    fn is_clear_between(&self, from: &Place, to: &Place, which: u64, depth: u32) -> bool {
        let open = self.unsettled(from, to, which);
        if open == 0 {
            return true;
        }
        let way_s = 0.5 * (from.way_s + to.way_s);
        if depth == 0 || self.near.looks.get() == 0 {
            return false;
        }
        let middle = self.near.place(self.guard, self.rates, way_s, open);
        let is_clear = |(watched, spare_m): (&Watched, &[f64; SECTIONS_MAX])| {
            spare_m.iter().all(|spare_m| *spare_m >= -watched.dip_m)
        };
        self.near.watched().zip(&middle.spare_m).all(is_clear)
            && self.is_clear_between(from, &middle, open, depth - 1)
            && self.is_clear_between(&middle, to, open, depth - 1)
    }

    /// The bits of those that can have come nearer between.
    fn unsettled(&self, from: &Place, to: &Place, which: u64) -> u64 {
        let stopping = &self.guard.stopping;
        let time_s = stopping.time_s(to.way_s) - stopping.time_s(from.way_s);
        let obstacles = if time_s > self.guard.period_s {
            2.0
        } else {
            0.0
        };
        let mut open = 0;
        for (index, watched) in self.near.watched().enumerate() {
            let is_open = |j: usize| {
                // Both the clearance of the robot, and that of the one that stands still, change by its motion.
                let travel_m = self.travel_m_s[j] * (to.way_s - from.way_s)
                    + obstacles * watched.speed_m_s * time_s;
                let least_m = 0.5 * (from.spare_m[index][j] + to.spare_m[index][j] - travel_m);
                least_m < -watched.dip_m
            };
            if which & (1 << index) != 0 && (0..SECTIONS_MAX).any(is_open) {
                open |= 1 << index;
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

/// What no point of each section moves by along the whole way \[m\], at these rates or any others inside the limits that are
/// not faster.
fn farthest_m(guard: &Guard<'_>, rates: &BendRates) -> [f64; SECTIONS_MAX] {
    let mut change_rad = [0.0; SECTIONS_MAX];
    for (change_rad, section) in change_rad.iter_mut().zip(guard.robot.sections()) {
        let largest_rad_s = fastest(rates).min(section.rate_max_rad_s);
        *change_rad = guard.stopping.way_s * core::f64::consts::SQRT_2 * largest_rad_s;
    }
    guard.robot.travel_m(&change_rad)
}
