//! Half-spaces of rates in which violated clearances become large enough.

use crate::robot::{BendRates, COORDINATES_MAX, Nearest};
use crate::safety::projection::Region;
use crate::safety::stopping::fastest;

use super::near::{NearObstacles, PathPoint, ROUNDING_M, ROW_COST, SOLVE_COST, ends_s, sections};
use super::watched::WatchedObstacle;
use super::{ClearanceGuard, Linearisation};

/// Extra clearance that a correction asks for \[m\], so that rounding does not undo it.
const EXTRA_M: f64 = 1e-9;
/// Largest number of rows added by one correction.
const ROWS_MAX: usize = 56;

/// A clearance that is violated, or may become violated.
#[derive(Clone, Copy)]
struct TooNear<'a> {
    /// Lower bound of its margin \[m\].
    margin_m: f64,
    point: &'a PathPoint,
    watched: &'a WatchedObstacle<'a>,
    index: usize,
    section: usize,
    /// Points of shortest distance there.
    nearest: Nearest,
}

/// Point of linearisation of a half-space.
#[derive(Clone, Copy)]
enum Around<'a> {
    /// The robot at rest; the half-space is widened by the gain of these rates.
    Rest { wider_rad_s: f64 },
    /// At these rates, with extra clearance.
    Rates { rates: &'a BendRates, extra_m: f64 },
}

/// Bounds `region` by the linearised clearances at the point where the check of these rates found a
/// violation. Returns whether there were any. Of more than [`ROWS_MAX`], those with the smallest margins are
/// used.
pub(super) fn bound(
    near: &NearObstacles<'_>,
    guard: &ClearanceGuard<'_>,
    rates: &BendRates,
    region: &mut Region,
) -> bool {
    let Some(violation) = near.violation() else {
        return false;
    };
    let point = near.point(guard, rates, violation.path_s);
    let mut least = Least {
        rows: [None; ROWS_MAX],
        count: 0,
    };
    let is_end = ends_s(guard, rates).contains(&violation.path_s);
    for (index, watched) in near.watched().enumerate() {
        let predicted = watched.after(point.time_s);
        for section in sections(watched.sections()) {
            let floor_m = watched.floor_bound_m(section, point.time_s);
            // Between the ends, only the violation that was found counts.
            let cutoff_m = if is_end {
                floor_m
            } else if (index, section) == (violation.index, violation.section) {
                f64::INFINITY
            } else {
                continue;
            };
            if let Some(nearest) = near.nearest_below(&point, &predicted, section, cutoff_m) {
                least.insert(TooNear {
                    margin_m: nearest.clearance_m - floor_m,
                    point: &point,
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
            let extra_m = EXTRA_M;
            short.bound(
                near,
                guard,
                &short.nearest,
                Around::Rates { rates, extra_m },
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

/// Bounds `region` at both ends of the path by every clearance that can become active. Linearised at rest,
/// half-spaces are wider by the slack of `linearisation`. Linearised at other rates, only clearances that had
/// a row or are violated count, and the violation found between the ends.
pub(super) fn bound_relinearised(
    near: &NearObstacles<'_>,
    guard: &ClearanceGuard<'_>,
    desired_rates: &BendRates,
    around: Option<&BendRates>,
    linearisation: &Linearisation,
    region: &mut Region,
) {
    let row_around = match around {
        None => Around::Rest {
            wider_rad_s: linearisation.slack * fastest(desired_rates),
        },
        Some(rates) => Around::Rates {
            rates,
            extra_m: linearisation.extra_m,
        },
    };
    let rest = BendRates::zero(desired_rates.section_count());
    let farthest_m = guard.farthest_m(desired_rates);
    let longest_s = guard.stopping.path(fastest(desired_rates)).path_s;
    let [period_s, end_s] = ends_s(guard, around.unwrap_or(desired_rates));
    let between = near.between().filter(|_| around.is_some());
    for path_s in [
        Some(period_s),
        Some(end_s),
        between.map(|violation| violation.path_s),
    ] {
        let Some(path_s) = path_s else { break };
        let point = near.point(guard, around.unwrap_or(&rest), path_s);
        let is_end = path_s == period_s || path_s == end_s;
        // Bound of the change of rates: from rest to any rates, or twice that between two rates.
        let changes = if around.is_some() { 2.0 } else { 1.0 } * path_s / longest_s;
        for (index, watched) in near.watched().enumerate() {
            if near.is_budget_spent() {
                // The check that follows rejects the rates then: it has no budget either.
                return;
            }
            if around.is_none() && watched.stands() && path_s < end_s {
                // The row at the end of the path is stricter.
                continue;
            }
            let predicted = watched.after(point.time_s);
            for section in sections(watched.sections()) {
                let is_violated = between.is_some_and(|violation| {
                    (violation.index, violation.section) == (index, section)
                });
                let cutoff_m = if !is_end && !is_violated {
                    continue;
                } else if is_violated || around.is_none() || near.has_row(index, section) {
                    // The required clearance is out of reach of all rates that are not faster.
                    watched.required_m + changes * farthest_m[section] + ROUNDING_M
                } else {
                    watched.floor_bound_m(section, point.time_s)
                };
                if let Some(nearest) = near.nearest_below(&point, &predicted, section, cutoff_m) {
                    let short = TooNear {
                        margin_m: 0.0,
                        point: &point,
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

/// The clearances with the smallest margins.
struct Least<'a> {
    rows: [Option<TooNear<'a>>; ROWS_MAX],
    count: usize,
}

impl<'a> Least<'a> {
    fn insert(&mut self, short: TooNear<'a>) {
        if self.count < ROWS_MAX {
            self.rows[self.count] = Some(short);
            self.count += 1;
            return;
        }
        let known = self.rows.iter_mut().flatten();
        if let Some(most) = known.max_by(|one, other| one.margin_m.total_cmp(&other.margin_m))
            && short.margin_m < most.margin_m
        {
            *most = short;
        }
    }
}

impl TooNear<'_> {
    /// Points of shortest distance for the robot at rest.
    fn standing(&self, near: &NearObstacles<'_>) -> Nearest {
        near.spend(self.watched.cost());
        let predicted = self.watched.after(self.point.time_s);
        near.standing()
            .body
            .nearest_of(self.section, predicted.obstacle())
    }

    /// Adds the half-space linearised at these rates, or at rest, where every clearance suffices and so the
    /// region is not empty. Returns whether the half-space cuts the region.
    fn bound(
        &self,
        near: &NearObstacles<'_>,
        guard: &ClearanceGuard<'_>,
        nearest: &Nearest,
        around: Around<'_>,
        region: &mut Region,
    ) -> bool {
        near.spend(ROW_COST);
        let pose = match around {
            Around::Rest { .. } => near.standing(),
            Around::Rates { .. } => &self.point.pose,
        };
        let mut columns = [[0.0; 3]; COORDINATES_MAX];
        let motion = pose.motion(guard.robot);
        motion.point_jacobian(self.section, nearest.s, &mut columns);
        let d = &nearest.direction;
        let slope = columns.map(|[x, y, z]| self.point.path_s * (d.x * x + d.y * y + d.z * z));
        let least_m = match around {
            Around::Rates { rates, extra_m } => {
                let rates = rates.as_slice().iter();
                let gained_m: f64 = rates.zip(slope).map(|(rate, slope)| rate * slope).sum();
                let predicted = self.watched.after(self.point.time_s);
                let floor_m = near.floor_m(&predicted, self.section);
                gained_m + extra_m + floor_m - nearest.clearance_m
            }
            Around::Rest { wider_rad_s } => {
                // At rest the clearance is at least the required one.
                let left_m = (nearest.clearance_m - self.watched.required_m).max(0.0);
                let slope_m_s = slope.iter().map(|slope| slope * slope).sum::<f64>().sqrt();
                -left_m - wider_rad_s * slope_m_s
            }
        };
        let is_bound = region.bound(&slope, least_m);
        if is_bound {
            near.spend(SOLVE_COST);
        }
        is_bound
    }
}
