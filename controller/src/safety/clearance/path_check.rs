//! Check of a command along its whole stopping path: exact at its ends, by bounds of the travel between.

use crate::robot::{BendRates, SECTIONS_MAX};
use crate::safety::stopping::{StoppingPath, fastest};

use super::ClearanceGuard;
use super::body_pose::BodyPose;
use super::near::{Margins, NEAR_MAX, NearObstacles, PathPoint, Sections, ends_s, sections};
use super::watched::{PredictedObstacle, WatchedObstacle};

/// Bisections of a part of the path before it counts as violated.
const DEPTH: u32 = 9;
/// Share of the rates that is tried next when no clearance suggests one.
const HALF: f64 = 0.5;

/// The motion of the robot at some rates.
struct PathCheck<'a> {
    near: &'a NearObstacles<'a>,
    guard: &'a ClearanceGuard<'a>,
    rates: &'a BendRates,
    stopping: StoppingPath,
    /// Upper bound of the speed of each section's points \[m/s\].
    travel_m_s: [f64; SECTIONS_MAX],
    /// Upper bound of their acceleration \[m/s²\].
    acceleration_m_s2: [f64; SECTIONS_MAX],
}

/// Margins at s = `path_s`.
#[derive(Clone, Copy)]
struct PathMargins<'a> {
    path_s: f64,
    pose: &'a BodyPose,
    margin_m: &'a Margins,
}

/// Checks the rule of [`ClearanceGuard::apply`] for `rates`.
///
/// # Errors
/// The share of the rates at which the first violated clearance would suffice if it were linear.
pub(super) fn check(
    near: &NearObstacles<'_>,
    guard: &ClearanceGuard<'_>,
    rates: &BendRates,
) -> Result<(), f64> {
    if near.is_empty() {
        return Ok(());
    }
    let turn_rad_s = guard.bend_bound(core::array::from_fn(|j| {
        let [u, v] = rates.section(j);
        (u * u + v * v).sqrt()
    }));
    let way = PathCheck {
        near,
        guard,
        rates,
        stopping: guard.stopping.path(fastest(rates)),
        travel_m_s: guard.robot.travel_m(&turn_rad_s),
        acceleration_m_s2: guard.robot.acceleration_m_s2(&turn_rad_s),
    };
    let undecided = near.undecided(&way.stopping, &way.travel_m_s);
    if undecided == [0; NEAR_MAX] {
        return Ok(());
    }
    // Most violations occur at the end of the path, so that is checked first.
    let [period_s, end_s] = ends_s(guard, rates);
    let mut margin_m = [[[0.0; SECTIONS_MAX]; NEAR_MAX]; 3];
    let [start_m, period_m, end_m] = &mut margin_m;
    let tolerance_m = |_: &WatchedObstacle<'_>| guard.rounding_m();
    let end = near.point(guard, rates, end_s);
    near.margins_at(&end, &undecided, tolerance_m, end_m)?;
    let period = near.point(guard, rates, period_s);
    near.margins_at(&period, &undecided, tolerance_m, period_m)?;
    near.margins_at_start(&undecided, start_m);
    let start = PathMargins {
        path_s: 0.0,
        pose: near.standing(),
        margin_m: start_m,
    };
    let (period, end) = (
        PathMargins::new(&period, period_m),
        PathMargins::new(&end, end_m),
    );
    way.is_clear_between(start, period, &undecided, DEPTH)?;
    way.is_clear_between(period, end, &undecided, DEPTH)
}

impl<'a> PathMargins<'a> {
    fn new(point: &'a PathPoint, margin_m: &'a Margins) -> Self {
        Self {
            path_s: point.path_s,
            pose: &point.pose,
            margin_m,
        }
    }
}

impl PathCheck<'_> {
    /// Checks that no margin falls below -[`WatchedObstacle::dip_m`] between two points: by a bound of the
    /// travel between them, otherwise at their middle, recursively. Positions of moving obstacles are
    /// resolved to one period.
    fn is_clear_between(
        &self,
        from: PathMargins<'_>,
        to: PathMargins<'_>,
        which: &Sections,
        depth: u32,
    ) -> Result<(), f64> {
        let undecided = self.undecided_between(from, to, which);
        if undecided == [0; NEAR_MAX] {
            return Ok(());
        }
        let path_s = self.middle_s(from.path_s, to.path_s, &undecided);
        if depth == 0 || self.near.is_budget_spent() {
            if let Some(index) = undecided.iter().position(|bits| *bits != 0) {
                let section = undecided[index].trailing_zeros() as usize;
                self.near.note_violation(index, section, path_s);
            }
            return Err(HALF);
        }
        let point: PathPoint = self.near.point(self.guard, self.rates, path_s);
        let dip_m = |watched: &WatchedObstacle<'_>| watched.dip_m;
        let mut margin_m = [[0.0; SECTIONS_MAX]; NEAR_MAX];
        self.near
            .margins_at(&point, &undecided, dip_m, &mut margin_m)?;
        let middle = PathMargins::new(&point, &margin_m);
        self.is_clear_between(from, middle, &undecided, depth - 1)?;
        self.is_clear_between(middle, to, &undecided, depth - 1)
    }

    /// Middle of two points of the path; the middle in time where obstacles move for longer than a period.
    fn middle_s(&self, from_s: f64, to_s: f64, undecided: &Sections) -> f64 {
        let times_s = [from_s, to_s].map(|path_s| self.stopping.time_s(path_s));
        let is_open = |(watched, undecided): (&WatchedObstacle<'_>, &u8)| {
            *undecided != 0 && !watched.stands()
        };
        if times_s[1] - times_s[0] > self.guard.period_s
            && self.near.watched().zip(undecided).any(is_open)
        {
            self.stopping.path_after_s(0.5 * (times_s[0] + times_s[1]))
        } else {
            0.5 * (from_s + to_s)
        }
    }

    /// Sections that may violate the rule between two points.
    ///
    /// For a point that moves from p to p' in h seconds, the sum of its distances to both is at most |p' - p|
    /// plus twice its deviation from the chord, which is at most its acceleration · h²/8.
    fn undecided_between(
        &self,
        from: PathMargins<'_>,
        to: PathMargins<'_>,
        which: &Sections,
    ) -> Sections {
        let stopping = &self.stopping;
        let time_s = stopping.time_s(to.path_s) - stopping.time_s(from.path_s);
        // The obstacle's motion in one period is tolerated.
        let counted_s = (time_s - self.guard.period_s).max(0.0);
        let path_s = to.path_s - from.path_s;
        let has_constant_speed_until =
            self.guard
                .is_linear_between(self.rates, from.path_s, to.path_s);
        let chords_m = to.pose.displacement_m(self.guard.robot, from.pose);
        let travel_m: [f64; SECTIONS_MAX] = core::array::from_fn(|j| {
            let most_m = self.travel_m_s[j] * path_s;
            let bent_m = chords_m[j] + 0.25 * self.acceleration_m_s2[j] * path_s * path_s;
            if has_constant_speed_until {
                bent_m.min(most_m)
            } else {
                most_m
            }
        });
        let mut undecided = [0; NEAR_MAX];
        for (index, watched) in self.near.watched().enumerate() {
            for j in sections(which[index]) {
                // The obstacle's motion changes the clearance of the moving robot and that of the robot at
                // rest.
                let travel_m = travel_m[j] + 2.0 * watched.moves_m(counted_s);
                let margin_m = from.margin_m[index][j] + to.margin_m[index][j];
                let is_decided = 0.5 * (margin_m - travel_m) >= -watched.dip_m
                    || has_constant_speed_until && self.is_apart([from, to], watched, j);
                undecided[index] |= u8::from(!is_decided) << j;
            }
        }
        undecided
    }

    /// Whether one plane separates section j from an obstacle between two points. Along its normal d, the
    /// points of the section deviate from the chord by at most acceleration · h²/8. The obstacle moves at
    /// constant velocity in time, and time deviates from a linear function of the path by at most a quarter
    /// of its span.
    fn is_apart(
        &self,
        [from, to]: [PathMargins<'_>; 2],
        watched: &WatchedObstacle<'_>,
        j: usize,
    ) -> bool {
        let times_s = [from, to].map(|left| self.stopping.time_s(left.path_s));
        let predicted = times_s.map(|time_s| watched.after(time_s));
        let Some(direction) = self.near.direction(&to.pose.body, &predicted[1], j) else {
            return false;
        };
        let least_m = |left: PathMargins<'_>, predicted: &PredictedObstacle<'_>| {
            (left.pose.body).clearance_min_along(j, predicted.obstacle(), &direction)
        };
        let path_s = to.path_s - from.path_s;
        let bent_m = 0.125 * self.acceleration_m_s2[j] * path_s * path_s;
        let shifted_m = if self.stopping.has_constant_speed_until(to.path_s) {
            0.0
        } else {
            let along_m_s = direction.dot(&watched.obstacle.velocity_m_s()).abs();
            0.25 * along_m_s * (times_s[1] - times_s[0])
        };
        let floor_m = if watched.stands() {
            watched.start_m[j].min(watched.required_m)
        } else {
            watched.required_m
        };
        // For a section that is bent by more than half a circle the bound is NaN, which separates nothing.
        let keeps_m = floor_m - watched.dip_m + bent_m + shifted_m;
        least_m(from, &predicted[0]) >= keeps_m && least_m(to, &predicted[1]) >= keeps_m
    }
}
