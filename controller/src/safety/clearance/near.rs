//! The obstacles that the body can get too near to, section by section, and what is left of their clearances at a place.

use core::cell::{Cell, OnceCell};

use nalgebra::Vector3;

use crate::robot::{
    BendRates, Body, BodyMotion, Closest, Configuration, Nearest, Pose, Robot, SECTIONS_MAX,
};

use super::watched::{CAPSULE_LOOKS, There, Watched, least_m};
use super::{ClearanceGuard, StoppingWay, fastest};

/// Obstacles that are watched one by one. When more than these are within reach, the robot stands still.
pub(super) const NEAR_MAX: usize = 64;
/// What is not looked for between two places of the way \[m\], at most: half of what lies between the axes at distance D, if
/// that is less, so that no thin section jumps through a thin obstacle.
const DIP_M: f64 = 1e-3;
/// What a bound on a clearance allows for rounding \[m\], with obstacles of any size.
pub(super) const ROUNDING_M: f64 = 1e-6;
/// The work for one command, in the time of an exact clearance from a sphere, about 22 ns: when it is used up, what is not known to
/// be clear counts as not clear.
const LOOKS: u32 = 4000;
/// So many more where a command is linearised anew,
const RENEWAL_LOOKS: u32 = 3250;
/// with as many obstacles near at most: among more of them the worst case stays as long as it is.
const RENEWED_MAX: usize = 32;
/// How many of them a place of the way takes the time of,
const PLACE_LOOKS: u32 = 24;
/// a plane between a section and an obstacle,
const PLANE_LOOKS: u32 = 2;
/// a row of a correction, beside its clearance,
pub(super) const ROW_LOOKS: u32 = 4;
/// its part of the solution,
pub(super) const SOLVED_LOOKS: u32 = 6;
/// and where all rows are made linear anew, the copy of a region and what finds its nearest point, beside the products there:
/// each of these counts as one.
pub(super) const REGION_LOOKS: u32 = 25;

/// What is left of a clearance beyond what must be \[m\], of each watched obstacle and each of the sections, at least: of any value
/// where it is not asked for, NaN where the state is not finite.
pub(super) type Spare = [[f64; SECTIONS_MAX]; NEAR_MAX];

/// Sections of each watched obstacle, a bit each.
pub(super) type Sections = [u8; NEAR_MAX];

/// The watched obstacles.
pub(super) struct Near<'a> {
    /// The robot that stands still.
    still: &'a Stance,
    /// What no section comes near to is farther than this from all of them \[m\].
    beyond_m: f64,
    period_s: f64,
    watched_count: usize,
    watched: [Option<Watched<'a>>; NEAR_MAX],
    /// What is left of [`LOOKS`].
    looks: Cell<u32>,
    /// The watched obstacles in the order in which they are looked at: first those that were the last to be too near, then
    /// those that are nearest now.
    order: Cell<[u8; NEAR_MAX]>,
    /// What was too small when rates were checked last.
    lack: Cell<Option<Lack>>,
    /// What was found so between the ends of the way, of a command that is made linear anew.
    between: Cell<Option<Lack>>,
    /// The sections of each watched obstacle that have a row in the region of a correction, a bit each.
    rows: [Cell<u8>; NEAR_MAX],
    /// From each watched capsule to each section, the direction in which these were nearest when that was looked for last; zero where it was not.
    directions: [[Cell<[f64; 3]>; SECTIONS_MAX]; NEAR_MAX],
    /// What each section must keep after the period \[m\], beside obstacles that move; zero where that was not looked for.
    period_floor_m: [[Cell<f64>; SECTIONS_MAX]; NEAR_MAX],
}

/// Where a section is too near to a watched obstacle, or may be.
#[derive(Clone, Copy)]
pub(super) struct Lack {
    pub(super) index: usize,
    pub(super) section: usize,
    pub(super) way_s: f64,
}

/// A shape, and what clearances from it take.
pub(super) struct Stance {
    pub(super) at: Configuration,
    frames: [Pose; SECTIONS_MAX + 1],
    pub(super) body: Body,
    motion: OnceCell<BodyMotion>,
}

/// Where the robot is at s = `way_s`: bend + s q̇.
pub(super) struct Place {
    pub(super) way_s: f64,
    pub(super) time_s: f64,
    pub(super) stance: Stance,
    /// How far each section is from where it is now, at most \[m\].
    displacement_m: [f64; SECTIONS_MAX],
}

impl Stance {
    pub(super) fn new(robot: &Robot, at: &Configuration) -> Self {
        let frames = robot.section_frames(at);
        Self {
            at: *at,
            frames,
            body: robot.body_from_frames(at, &frames),
            motion: OnceCell::new(),
        }
    }

    /// How its points move.
    pub(super) fn motion(&self, robot: &Robot) -> &BodyMotion {
        self.motion.get_or_init(|| robot.body_motion(&self.at))
    }

    /// How far each section is from where it is in another stance, at most \[m\].
    pub(super) fn displacement_m(&self, robot: &Robot, other: &Self) -> [f64; SECTIONS_MAX] {
        robot.displacement_m((&other.at, &other.frames), (&self.at, &self.frames))
    }
}

impl<'a> Near<'a> {
    /// Those of a robot that is in this stance. `None` when there are more than fit.
    pub(super) fn find(
        guard: &ClearanceGuard<'a>,
        still: &'a Stance,
        rates: &BendRates,
        is_ramp: bool,
    ) -> Option<Self> {
        let way = guard.stopping.way(fastest(rates));
        let travel_m = guard.farthest_m(rates);
        let time_s = way.time_s(way.way_s);
        let radii_m = guard.robot.sections().iter().map(|s| s.body_radius_m);
        let thinnest_m = radii_m.fold(f64::INFINITY, f64::min);
        let nearest_m = travel_m.iter().copied().fold(f64::INFINITY, f64::min);
        let mut near = Self {
            still,
            beyond_m: guard.safe_distance_m + nearest_m,
            period_s: guard.period_s,
            watched_count: 0,
            watched: [None; NEAR_MAX],
            looks: Cell::new(LOOKS),
            order: Cell::new(core::array::from_fn(|index| index as u8)),
            lack: Cell::new(None),
            between: Cell::new(None),
            rows: [const { Cell::new(0) }; NEAR_MAX],
            directions: [const { [const { Cell::new([0.0; 3]) }; SECTIONS_MAX] }; NEAR_MAX],
            period_floor_m: [const { [const { Cell::new(0.0) }; SECTIONS_MAX] }; NEAR_MAX],
        };
        let (mut looks, mut least_m) = (LOOKS, f64::INFINITY);
        let mut slots = near.watched.iter_mut();
        for obstacle in guard.obstacles {
            let safe_m = guard.safe_distance_m;
            let speed_m_s = obstacle.velocity_m_s().norm();
            let reach_m = travel_m.map(|travel_m| safe_m + travel_m + 2.0 * time_s * speed_m_s);
            let enough_m = least_m.max(safe_m);
            let start_m = still.body.clearances_below(obstacle, &reach_m, enough_m);
            if start_m == [f64::INFINITY; SECTIONS_MAX] {
                continue;
            }
            let dip_m = DIP_M.min(0.5 * (safe_m + thinnest_m + obstacle.radius_m()));
            // A ramp may end in what the command before was allowed between, and a rounding deeper.
            let is_continued = is_ramp && speed_m_s == 0.0;
            let watched = Watched {
                obstacle,
                index: near.watched_count,
                speed_m_s,
                start_m,
                kept_m: if is_continued {
                    // But at its ends never contact by the ramp itself.
                    (safe_m - dip_m - ROUNDING_M).max(safe_m.min(0.0))
                } else {
                    safe_m
                },
                dip_m,
            };
            let exact_count = start_m.iter().filter(|m| **m < enough_m).count() as u32;
            looks = looks.saturating_sub(watched.looks() * exact_count);
            least_m = watched.nearest_m().min(least_m);
            *slots.next()? = Some(watched);
            near.watched_count += 1;
        }
        near.looks.set(looks);
        near.order_by_distance();
        Some(near)
    }

    /// Those that are nearest now are looked at first.
    fn order_by_distance(&mut self) {
        let mut nearest_m = [f64::INFINITY; NEAR_MAX];
        for (nearest_m, watched) in nearest_m.iter_mut().zip(self.watched()) {
            *nearest_m = watched.nearest_m();
        }
        let nearest_m = |index: &u8| nearest_m[usize::from(*index)];
        let mut order = self.order.get();
        order[..self.watched_count]
            .sort_unstable_by(|one, other| nearest_m(one).total_cmp(&nearest_m(other)));
        self.order.set(order);
    }

    /// The least clearance of the body now \[m\], where a watched section has it; NaN where the state is not finite.
    pub(super) fn least_clearance_m(&self) -> Option<f64> {
        let least_m = least_m(self.watched().map(Watched::nearest_m));
        (least_m.is_nan() || least_m <= self.beyond_m).then_some(least_m)
    }

    pub(super) fn watched(&self) -> impl Iterator<Item = &Watched<'a>> {
        self.watched.iter().map_while(Option::as_ref)
    }

    /// The sections that can come below what is kept along the way, when no point of theirs is faster than `travel_m_s`.
    pub(super) fn open(&self, way: &StoppingWay, travel_m_s: &[f64; SECTIONS_MAX]) -> Sections {
        let time_s = way.time_s(way.way_s);
        let mut open = [0; NEAR_MAX];
        for (open, watched) in open.iter_mut().zip(self.watched()) {
            let moved_m = watched.speed_m_s * time_s + ROUNDING_M;
            for (j, start_m) in watched.start_m.iter().enumerate() {
                let is_clear = start_m - travel_m_s[j] * way.way_s - moved_m >= watched.kept_m;
                *open |= u8::from(!is_clear) << j;
            }
        }
        open
    }

    /// Where the robot is at s = `way_s`.
    pub(super) fn place(&self, guard: &ClearanceGuard<'_>, rates: &BendRates, way_s: f64) -> Place {
        self.count(PLACE_LOOKS);
        let stance = Stance::new(guard.robot, &guard.after(&self.still.at, rates, way_s));
        Place {
            way_s,
            time_s: guard.stopping.way(fastest(rates)).time_s(way_s),
            displacement_m: stance.displacement_m(guard.robot, self.still),
            stance,
        }
    }

    /// Fills `spare_m` with the spare of the sections in `which` at the start of the way.
    pub(super) fn spare_at_start(&self, which: &Sections, spare_m: &mut Spare) {
        for (index, watched) in self.watched().enumerate() {
            for j in sections(which[index]) {
                spare_m[index][j] = watched.start_m[j] - watched.start_m[j].min(watched.kept_m);
            }
        }
    }

    /// Fills `spare_m` with the spare of the sections in `which` at a place, where none is less than -`lack_m` of its obstacle.
    ///
    /// # Errors
    /// As [`check`](super::way::check).
    pub(super) fn spare_at(
        &self,
        place: &Place,
        which: &Sections,
        lack_m: impl Fn(&Watched<'_>) -> f64,
        spare_m: &mut Spare,
    ) -> Result<(), f64> {
        let mut order = self.order.get();
        for turn in 0..self.watched_count {
            let index = usize::from(order[turn]);
            let Some(watched) = &self.watched[index] else {
                continue;
            };
            let there = watched.after(place.time_s);
            for j in sections(which[index]) {
                let spare = self.spare_m(place, &there, j);
                // A NaN is too little, too.
                let lack_m = lack_m(watched);
                let is_enough = spare >= -lack_m;
                if !is_enough {
                    order[..=turn].rotate_right(1);
                    self.order.set(order);
                    self.set_lack(index, j, place.way_s);
                    let start = watched.start_m[j] - watched.start_m[j].min(watched.kept_m);
                    return Err((start + lack_m) / (start - spare));
                }
                spare_m[index][j] = spare;
            }
        }
        Ok(())
    }

    /// What is left to section j at a place \[m\]: exactly, or a bound of at least 0.
    fn spare_m(&self, place: &Place, there: &There<'_>, j: usize) -> f64 {
        let watched = there.watched;
        let least_m = place.clearance_min_m(watched, j);
        if least_m >= watched.kept_m {
            return least_m - watched.kept_m;
        }
        let most_m = watched.floor_most_m(j, place.time_s);
        let clearance_m = self.clearance_below(&place.stance.body, there, j, most_m);
        if clearance_m >= most_m {
            return clearance_m - most_m;
        }
        clearance_m - self.floor_m(there, j)
    }

    /// Where section j is nearest to an obstacle at a place, if its clearance is less than `enough_m`.
    pub(super) fn nearest_below(
        &self,
        place: &Place,
        there: &There<'_>,
        j: usize,
        enough_m: f64,
    ) -> Option<Nearest> {
        if place.clearance_min_m(there.watched, j) >= enough_m {
            return None;
        }
        let body = &place.stance.body;
        let closest = self.closest_below(body, there, j, enough_m).ok()?;
        let is_short = closest.clearance_m < enough_m;
        is_short.then(|| body.place(&closest, there.obstacle()))
    }

    /// The clearance of section j of a body \[m\]: exactly, or a bound of at least `enough_m`.
    fn clearance_below(&self, body: &Body, there: &There<'_>, j: usize, enough_m: f64) -> f64 {
        let closest = self.closest_below(body, there, j, enough_m);
        closest.map_or_else(|least_m| least_m, |closest| closest.clearance_m)
    }

    /// From an obstacle to where section j of a body is nearest, or was when that was looked for last.
    pub(super) fn direction(
        &self,
        body: &Body,
        there: &There<'_>,
        j: usize,
    ) -> Option<Vector3<f64>> {
        self.count(PLANE_LOOKS);
        let direction = if there.watched.is_ball() {
            body.direction(&body.closest_of(j, there.obstacle()))
        } else {
            Vector3::from(self.directions[there.watched.index][j].get())
        };
        (direction != Vector3::zeros()).then_some(direction)
    }

    /// Where section j of a body is nearest to an obstacle.
    ///
    /// # Errors
    /// A bound of its clearance \[m\] that is at least `enough_m`, where there is one.
    fn closest_below(
        &self,
        body: &Body,
        there: &There<'_>,
        j: usize,
        enough_m: f64,
    ) -> Result<Closest, f64> {
        let obstacle = there.obstacle();
        if there.watched.is_ball() {
            self.count(1);
            return Ok(body.closest_of(j, obstacle));
        }
        // The direction in which both were nearest last tells more than the chord does.
        let known = &self.directions[there.watched.index][j];
        let direction = Vector3::from(known.get());
        let least_m = if direction == Vector3::zeros() {
            body.clearance_min_of(j, obstacle)
        } else {
            body.clearance_min_along(j, obstacle, &direction)
        };
        if least_m >= enough_m {
            self.count(1);
            return Err(least_m);
        }
        self.count(CAPSULE_LOOKS);
        let closest = body.closest_of(j, obstacle);
        known.set(body.direction(&closest).into());
        Ok(closest)
    }

    /// What section j must keep \[m\]: min(D, what is left to the robot that stands still). A NaN gives D, which
    /// no NaN reaches.
    pub(super) fn floor_m(&self, there: &There<'_>, j: usize) -> f64 {
        let There {
            watched, time_s, ..
        } = *there;
        let start_m = watched.start_m[j];
        if watched.stands() || start_m == f64::INFINITY {
            return start_m.min(watched.kept_m);
        }
        if start_m - watched.moves_m(time_s) - ROUNDING_M >= watched.kept_m {
            return watched.kept_m;
        }
        // Every command is looked at there.
        let is_period = time_s == self.period_s;
        let known_m = &self.period_floor_m[watched.index][j];
        if is_period && known_m.get() != 0.0 {
            return known_m.get();
        }
        let floor_m = self
            .clearance_below(&self.still.body, there, j, watched.kept_m)
            .min(watched.kept_m);
        if is_period {
            known_m.set(floor_m);
        }
        floor_m
    }

    /// The robot that stands still.
    pub(super) fn still(&self) -> &Stance {
        self.still
    }

    /// What was too small when rates were checked last; `None` when nothing was, or they were not.
    pub(super) fn lack(&self) -> Option<Lack> {
        self.lack.get()
    }

    /// What lacks between the ends of the way of a command that is made linear anew.
    pub(super) fn between(&self) -> Option<Lack> {
        self.between.get()
    }

    pub(super) fn note_between(&self, lack: Option<Lack>) {
        self.between.set(lack);
    }

    pub(super) fn forget_lack(&self) {
        self.lack.set(None);
    }

    pub(super) fn set_lack(&self, index: usize, section: usize, way_s: f64) {
        self.lack.set(Some(Lack {
            index,
            section,
            way_s,
        }));
    }

    /// Whether a row was taken for this section and this watched obstacle.
    pub(super) fn has_row(&self, index: usize, section: usize) -> bool {
        self.rows[index].get() & 1 << section != 0
    }

    /// From now on there is one.
    pub(super) fn note_row(&self, index: usize, section: usize) {
        self.rows[index].set(self.rows[index].get() | 1 << section);
    }

    /// How many there are.
    pub(super) fn row_count(&self) -> u32 {
        let rows = self.rows.iter();
        rows.map(|sections| sections.get().count_ones()).sum()
    }

    /// Without rows, and with what a check found.
    pub(super) fn begin_again(&self, lack: Option<Lack>) {
        self.rows.iter().for_each(|sections| sections.set(0));
        self.lack.set(lack);
    }

    /// Takes these from what is left of [`LOOKS`].
    pub(super) fn count(&self, looks: u32) {
        self.looks.set(self.looks.get().saturating_sub(looks));
    }

    /// Adds [`RENEWAL_LOOKS`] to it.
    pub(super) fn allow_renewal(&self) {
        self.looks.set(self.looks.get() + RENEWAL_LOOKS);
    }

    /// Whether so few obstacles are near that a command is linearised anew.
    pub(super) fn are_few(&self) -> bool {
        self.watched_count <= RENEWED_MAX
    }

    /// Whether the time for one command is used up.
    pub(super) fn is_out_of_looks(&self) -> bool {
        self.looks.get() == 0
    }

    /// Whether as much is left as it takes to scale a command down.
    pub(super) fn has_looks_to_correct(&self) -> bool {
        self.looks.get() >= LOOKS / 8
    }

    /// Whether nothing is near.
    pub(super) fn is_empty(&self) -> bool {
        self.watched_count == 0
    }
}

impl Place {
    /// What the clearance of a section is at least, by how far it is from where it is now \[m\].
    fn clearance_min_m(&self, watched: &Watched<'_>, j: usize) -> f64 {
        let moved_m = self.displacement_m[j] + watched.moves_m(self.time_s) + ROUNDING_M;
        watched.start_m[j] - moved_m
    }
}

/// The sections of a bit set.
pub(super) fn sections(bits: u8) -> impl Iterator<Item = usize> {
    (0..SECTIONS_MAX).filter(move |j| bits & (1 << j) != 0)
}

/// Where the rule holds exactly for these rates: after the period, and after the stopping way.
pub(super) fn ends_s(guard: &ClearanceGuard<'_>, rates: &BendRates) -> [f64; 2] {
    [guard.period_s, guard.stopping.way(fastest(rates)).way_s]
}
