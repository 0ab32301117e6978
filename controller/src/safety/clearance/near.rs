//! Obstacles within reach of the body, section by section, and the margins of their clearances at points of
//! the stopping path.

use core::cell::Cell;

use nalgebra::Vector3;

use crate::robot::{BendRates, Body, Closest, Nearest, Obstacle, Robot, SECTIONS_MAX};
use crate::safety::stopping::{StoppingPath, fastest};

use super::ClearanceGuard;
use super::body_pose::BodyPose;
use super::watched::{CAPSULE_COST, PredictedObstacle, WatchedObstacle, least_m};

/// Obstacles that are checked individually. If more are within reach, the robot stands still.
pub(in crate::safety) const NEAR_MAX: usize = 64;
/// Largest undershoot that is tolerated between two points of the path \[m\].
const DIP_M: f64 = 1e-3;
/// Allowance for rounding in bounds of clearances \[m\], for obstacles of any size.
pub(super) const ROUNDING_M: f64 = 1e-6;
/// Work budget of one command, in units of one exact clearance from a sphere (about 22 ns). When it is spent,
/// a clearance that is not yet verified counts as violated.
const WORK_BUDGET: u32 = 4000;
/// Additional budget for the relinearisation of a command.
const RELINEARISATION_BUDGET: u32 = 3250;
/// Relinearisation is used up to this number of near obstacles, so that the worst case does not become
/// longer.
const RELINEARISED_MAX: usize = 32;
/// Cost of one point of the path.
pub(in crate::safety) const POINT_COST: u32 = 24;
/// Cost of one separating plane between a section and an obstacle.
const PLANE_COST: u32 = 2;
/// Cost of one row of a correction, without its clearance.
pub(in crate::safety) const ROW_COST: u32 = 4;
/// Cost of one row in the projection.
pub(in crate::safety) const SOLVE_COST: u32 = 6;
/// Cost of copying a region and starting its projection; each product of two vectors there costs 1.
pub(in crate::safety) const REGION_COST: u32 = 25;

/// Margins: clearance minus required clearance \[m\], or a lower bound of it, by near obstacle and section.
/// Arbitrary where not requested, NaN where the state is not finite.
pub(super) type Margins = [[f64; SECTIONS_MAX]; NEAR_MAX];

/// A set of sections for each near obstacle, one bit per section.
pub(super) type Sections = [u8; NEAR_MAX];

/// The near obstacles.
pub(super) struct NearObstacles<'a> {
    /// The robot at rest.
    standing: &'a BodyPose,
    /// Obstacles outside this list are farther than this from every section \[m\].
    beyond_m: f64,
    period_s: f64,
    watched_count: usize,
    watched: [Option<WatchedObstacle<'a>>; NEAR_MAX],
    /// Remaining part of [`WORK_BUDGET`].
    budget: Cell<u32>,
    /// Order in which obstacles are checked: the most recently violated first, then by present distance.
    order: Cell<[u8; NEAR_MAX]>,
    /// Violation found by the last check.
    violation: Cell<Option<Violation>>,
    /// Violation found between the ends of the path of a command that is relinearised.
    between: Cell<Option<Violation>>,
    /// Sections that already have a row in the region of a correction.
    rows: [Cell<u8>; NEAR_MAX],
    /// Last known direction of shortest distance from each capsule to each section; zero if unknown.
    directions: [[Cell<[f64; 3]>; SECTIONS_MAX]; NEAR_MAX],
    /// Required clearance of each section from a moving obstacle after one period \[m\]; zero if unknown.
    period_floor_m: [[Cell<f64>; SECTIONS_MAX]; NEAR_MAX],
}

/// A point of the path at which a section violates the required clearance, or may violate it.
#[derive(Clone, Copy)]
pub(super) struct Violation {
    pub(super) index: usize,
    pub(super) section: usize,
    pub(super) path_s: f64,
}

/// The robot at s = `path_s`: bend + s q̇.
pub(super) struct PathPoint {
    pub(super) path_s: f64,
    pub(super) time_s: f64,
    pub(super) pose: BodyPose,
    /// Upper bound of each section's distance from its present pose \[m\].
    displacement_m: [f64; SECTIONS_MAX],
}

impl<'a> NearObstacles<'a> {
    /// Near obstacles of a robot in the pose `standing`. `None` when there are more than [`NEAR_MAX`].
    pub(super) fn find(
        guard: &ClearanceGuard<'a>,
        standing: &'a BodyPose,
        rates: &BendRates,
        is_ramp: bool,
    ) -> Option<Self> {
        let way = guard.stopping.path(fastest(rates));
        let travel_m = guard.farthest_m(rates);
        let time_s = way.time_s(way.path_s);
        let thinnest_m = thinnest_m(guard.robot);
        let nearest_m = travel_m.iter().copied().fold(f64::INFINITY, f64::min);
        let mut near = Self {
            standing,
            beyond_m: guard.safe_distance_m + nearest_m,
            period_s: guard.period_s,
            watched_count: 0,
            watched: [None; NEAR_MAX],
            budget: Cell::new(WORK_BUDGET),
            order: Cell::new(core::array::from_fn(|index| index as u8)),
            violation: Cell::new(None),
            between: Cell::new(None),
            rows: [const { Cell::new(0) }; NEAR_MAX],
            directions: [const { [const { Cell::new([0.0; 3]) }; SECTIONS_MAX] }; NEAR_MAX],
            period_floor_m: [const { [const { Cell::new(0.0) }; SECTIONS_MAX] }; NEAR_MAX],
        };
        let (mut budget, mut least_m) = (WORK_BUDGET, f64::INFINITY);
        let mut slots = near.watched.iter_mut();
        for obstacle in guard.obstacles {
            let safe_m = guard.safe_distance_m;
            let speed_m_s = obstacle.velocity_m_s().norm();
            let reach_m = travel_m.map(|travel_m| safe_m + travel_m + 2.0 * time_s * speed_m_s);
            let cutoff_m = least_m.max(safe_m);
            let start_m = standing.body.clearances_below(obstacle, &reach_m, cutoff_m);
            if start_m == [f64::INFINITY; SECTIONS_MAX] {
                continue;
            }
            let dip_m = dip_m(safe_m, thinnest_m, obstacle);
            // A ramp may end inside the tolerance of the command before it, and deeper by rounding.
            let is_continued = is_ramp && speed_m_s == 0.0;
            let watched = WatchedObstacle {
                obstacle,
                index: near.watched_count,
                speed_m_s,
                start_m,
                required_m: if is_continued {
                    // At its ends the ramp itself never causes contact.
                    (safe_m - dip_m - ROUNDING_M).max(safe_m.min(0.0))
                } else {
                    safe_m
                },
                dip_m,
            };
            let exact_count = start_m.iter().filter(|m| **m < cutoff_m).count() as u32;
            budget = budget.saturating_sub(watched.cost() * exact_count);
            least_m = watched.nearest_m().min(least_m);
            *slots.next()? = Some(watched);
            near.watched_count += 1;
        }
        near.budget.set(budget);
        near.order_by_distance();
        Some(near)
    }

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

    /// Smallest present clearance of the body \[m\], if it belongs to a near obstacle; NaN where the state is
    /// not finite.
    pub(super) fn least_clearance_m(&self) -> Option<f64> {
        let least_m = least_m(self.watched().map(WatchedObstacle::nearest_m));
        (least_m.is_nan() || least_m <= self.beyond_m).then_some(least_m)
    }

    pub(super) fn watched(&self) -> impl Iterator<Item = &WatchedObstacle<'a>> {
        self.watched.iter().map_while(Option::as_ref)
    }

    /// Sections that can violate the required clearance along the path, given an upper bound of the speed of
    /// their points.
    pub(super) fn undecided(
        &self,
        way: &StoppingPath,
        travel_m_s: &[f64; SECTIONS_MAX],
    ) -> Sections {
        let time_s = way.time_s(way.path_s);
        let mut undecided = [0; NEAR_MAX];
        for (undecided, watched) in undecided.iter_mut().zip(self.watched()) {
            let moved_m = watched.speed_m_s * time_s + ROUNDING_M;
            for (j, start_m) in watched.start_m.iter().enumerate() {
                let is_clear = start_m - travel_m_s[j] * way.path_s - moved_m >= watched.required_m;
                *undecided |= u8::from(!is_clear) << j;
            }
        }
        undecided
    }

    pub(super) fn point(
        &self,
        guard: &ClearanceGuard<'_>,
        rates: &BendRates,
        path_s: f64,
    ) -> PathPoint {
        self.spend(POINT_COST);
        let pose = BodyPose::new(guard.robot, &guard.after(&self.standing.at, rates, path_s));
        PathPoint {
            path_s,
            time_s: guard.stopping.path(fastest(rates)).time_s(path_s),
            displacement_m: pose.displacement_m(guard.robot, self.standing),
            pose,
        }
    }

    /// Fills `margin_m` with the margins of the sections in `which` at the start of the path.
    pub(super) fn margins_at_start(&self, which: &Sections, margin_m: &mut Margins) {
        for (index, watched) in self.watched().enumerate() {
            for j in sections(which[index]) {
                margin_m[index][j] =
                    watched.start_m[j] - watched.start_m[j].min(watched.required_m);
            }
        }
    }

    /// Fills `margin_m` with the margins of the sections in `which` at a point of the path. Each must be at
    /// least -`tolerance_m` of its obstacle.
    ///
    /// # Errors
    /// As [`check`](super::path_check::check).
    pub(super) fn margins_at(
        &self,
        point: &PathPoint,
        which: &Sections,
        tolerance_m: impl Fn(&WatchedObstacle<'_>) -> f64,
        margin_m: &mut Margins,
    ) -> Result<(), f64> {
        let mut order = self.order.get();
        for turn in 0..self.watched_count {
            let index = usize::from(order[turn]);
            let Some(watched) = &self.watched[index] else {
                continue;
            };
            let predicted = watched.after(point.time_s);
            for j in sections(which[index]) {
                let margin_here_m = self.margin_m(point, &predicted, j);
                // A NaN counts as a violation.
                let tolerance_m = tolerance_m(watched);
                let is_enough = margin_here_m >= -tolerance_m;
                if !is_enough {
                    order[..=turn].rotate_right(1);
                    self.order.set(order);
                    self.note_violation(index, j, point.path_s);
                    let start = watched.start_m[j] - watched.start_m[j].min(watched.required_m);
                    return Err((start + tolerance_m) / (start - margin_here_m));
                }
                margin_m[index][j] = margin_here_m;
            }
        }
        Ok(())
    }

    /// Margin of section j at a point \[m\]: exact, or a lower bound that is at least 0.
    fn margin_m(&self, point: &PathPoint, predicted: &PredictedObstacle<'_>, j: usize) -> f64 {
        let watched = predicted.watched;
        let least_m = point.clearance_min_m(watched, j);
        if least_m >= watched.required_m {
            return least_m - watched.required_m;
        }
        let most_m = watched.floor_bound_m(j, point.time_s);
        let clearance_m = self.clearance_below(&point.pose.body, predicted, j, most_m);
        if clearance_m >= most_m {
            return clearance_m - most_m;
        }
        clearance_m - self.floor_m(predicted, j)
    }

    /// Point of section j that is closest to an obstacle, if its clearance is less than `cutoff_m`.
    pub(super) fn nearest_below(
        &self,
        point: &PathPoint,
        predicted: &PredictedObstacle<'_>,
        j: usize,
        cutoff_m: f64,
    ) -> Option<Nearest> {
        if point.clearance_min_m(predicted.watched, j) >= cutoff_m {
            return None;
        }
        let body = &point.pose.body;
        let closest = self.closest_below(body, predicted, j, cutoff_m).ok()?;
        let is_short = closest.clearance_m < cutoff_m;
        is_short.then(|| body.nearest_from(&closest, predicted.obstacle()))
    }

    /// Clearance of section j \[m\]: exact, or a lower bound that is at least `cutoff_m`.
    fn clearance_below(
        &self,
        body: &Body,
        predicted: &PredictedObstacle<'_>,
        j: usize,
        cutoff_m: f64,
    ) -> f64 {
        let closest = self.closest_below(body, predicted, j, cutoff_m);
        closest.map_or_else(|least_m| least_m, |closest| closest.clearance_m)
    }

    /// Direction from an obstacle to the closest point of section j, at present or when it was computed last.
    pub(super) fn direction(
        &self,
        body: &Body,
        predicted: &PredictedObstacle<'_>,
        j: usize,
    ) -> Option<Vector3<f64>> {
        self.spend(PLANE_COST);
        let direction = if predicted.watched.is_sphere() {
            body.direction(&body.closest_of(j, predicted.obstacle()))
        } else {
            Vector3::from(self.directions[predicted.watched.index][j].get())
        };
        (direction != Vector3::zeros()).then_some(direction)
    }

    /// Closest point of section j to an obstacle.
    ///
    /// # Errors
    /// A lower bound of the clearance \[m\] that is at least `cutoff_m`, if there is one.
    fn closest_below(
        &self,
        body: &Body,
        predicted: &PredictedObstacle<'_>,
        j: usize,
        cutoff_m: f64,
    ) -> Result<Closest, f64> {
        let obstacle = predicted.obstacle();
        if predicted.watched.is_sphere() {
            self.spend(1);
            return Ok(body.closest_of(j, obstacle));
        }
        // The last direction of shortest distance gives a tighter bound than the chord.
        let known = &self.directions[predicted.watched.index][j];
        let direction = Vector3::from(known.get());
        let least_m = if direction == Vector3::zeros() {
            body.clearance_min_of(j, obstacle)
        } else {
            body.clearance_min_along(j, obstacle, &direction)
        };
        if least_m >= cutoff_m {
            self.spend(1);
            return Err(least_m);
        }
        self.spend(CAPSULE_COST);
        let closest = body.closest_of(j, obstacle);
        known.set(body.direction(&closest).into());
        Ok(closest)
    }

    /// Required clearance of section j \[m\]: min(D, clearance of the robot at rest). A NaN gives D, which no
    /// NaN satisfies.
    pub(super) fn floor_m(&self, predicted: &PredictedObstacle<'_>, j: usize) -> f64 {
        let PredictedObstacle {
            watched, time_s, ..
        } = *predicted;
        let start_m = watched.start_m[j];
        if watched.stands() || start_m == f64::INFINITY {
            return start_m.min(watched.required_m);
        }
        if start_m - watched.moves_m(time_s) - ROUNDING_M >= watched.required_m {
            return watched.required_m;
        }
        // Every command is checked at the end of the period, so that value is cached.
        let is_period = time_s == self.period_s;
        let known_m = &self.period_floor_m[watched.index][j];
        if is_period && known_m.get() != 0.0 {
            return known_m.get();
        }
        let floor_m = self
            .clearance_below(&self.standing.body, predicted, j, watched.required_m)
            .min(watched.required_m);
        if is_period {
            known_m.set(floor_m);
        }
        floor_m
    }

    /// The robot at rest.
    pub(super) fn standing(&self) -> &BodyPose {
        self.standing
    }

    /// Violation found by the last check; `None` if there was none, or no check.
    pub(super) fn violation(&self) -> Option<Violation> {
        self.violation.get()
    }

    /// Violation between the ends of the path of a command that is relinearised.
    pub(super) fn between(&self) -> Option<Violation> {
        self.between.get()
    }

    pub(super) fn note_between(&self, violation: Option<Violation>) {
        self.between.set(violation);
    }

    pub(super) fn clear_violation(&self) {
        self.violation.set(None);
    }

    pub(super) fn note_violation(&self, index: usize, section: usize, path_s: f64) {
        self.violation.set(Some(Violation {
            index,
            section,
            path_s,
        }));
    }

    pub(super) fn has_row(&self, index: usize, section: usize) -> bool {
        self.rows[index].get() & 1 << section != 0
    }

    pub(super) fn note_row(&self, index: usize, section: usize) {
        self.rows[index].set(self.rows[index].get() | 1 << section);
    }

    pub(super) fn row_count(&self) -> u32 {
        let rows = self.rows.iter();
        rows.map(|sections| sections.get().count_ones()).sum()
    }

    /// Removes all rows and restores the violation of an earlier check.
    pub(super) fn restore(&self, violation: Option<Violation>) {
        self.rows.iter().for_each(|sections| sections.set(0));
        self.violation.set(violation);
    }

    /// Spends a part of [`WORK_BUDGET`].
    pub(super) fn spend(&self, cost: u32) {
        self.budget.set(self.budget.get().saturating_sub(cost));
    }

    pub(super) fn allow_relinearisation(&self) {
        self.budget.set(self.budget.get() + RELINEARISATION_BUDGET);
    }

    /// Whether the number of near obstacles permits relinearisation.
    pub(super) fn are_few(&self) -> bool {
        self.watched_count <= RELINEARISED_MAX
    }

    pub(super) fn is_budget_spent(&self) -> bool {
        self.budget.get() == 0
    }

    /// Whether the remaining budget suffices to scale a command down after a correction.
    pub(super) fn has_budget_to_correct(&self) -> bool {
        self.budget.get() >= WORK_BUDGET / 8
    }

    pub(super) fn is_empty(&self) -> bool {
        self.watched_count == 0
    }
}

impl PathPoint {
    /// Lower bound of the clearance of a section \[m\], by its distance from the present pose.
    fn clearance_min_m(&self, watched: &WatchedObstacle<'_>, j: usize) -> f64 {
        let moved_m = self.displacement_m[j] + watched.moves_m(self.time_s) + ROUNDING_M;
        watched.start_m[j] - moved_m
    }
}

pub(super) fn sections(bits: u8) -> impl Iterator<Item = usize> {
    (0..SECTIONS_MAX).filter(move |j| bits & (1 << j) != 0)
}

/// Points at which the rule holds exactly: the end of the period and the end of the stopping path.
pub(super) fn ends_s(guard: &ClearanceGuard<'_>, rates: &BendRates) -> [f64; 2] {
    [guard.period_s, guard.stopping.path(fastest(rates)).path_s]
}

/// Undershoot that is tolerated between two points of the path \[m\]: half the distance between the axes at
/// clearance D, if that is less than 1 mm, so that no thin section passes through a thin obstacle.
pub(in crate::safety) fn dip_m(safe_m: f64, thinnest_m: f64, obstacle: &Obstacle) -> f64 {
    DIP_M.min(0.5 * (safe_m + thinnest_m + obstacle.radius_m()))
}

/// Least radius of a section \[m\].
pub(in crate::safety) fn thinnest_m(robot: &Robot) -> f64 {
    let radii_m = robot.sections().iter().map(|it| it.body_radius_m);
    radii_m.fold(f64::INFINITY, f64::min)
}
