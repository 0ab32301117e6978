//! A near obstacle: one that the body can reach with a command and the ramp after it.

use core::cell::OnceCell;

use crate::robot::{Obstacle, SECTIONS_MAX, Shape};

/// Cost of one exact clearance from a capsule, in units of the work budget.
pub(super) const CAPSULE_COST: u32 = 7;

fn is_sphere(obstacle: &Obstacle) -> bool {
    matches!(obstacle.shape(), Shape::Sphere { .. })
}

/// Cost of one exact clearance.
pub(in crate::safety) fn clearance_cost(obstacle: &Obstacle) -> u32 {
    if is_sphere(obstacle) { 1 } else { CAPSULE_COST }
}

#[derive(Clone, Copy)]
pub(super) struct WatchedObstacle<'a> {
    pub(super) obstacle: &'a Obstacle,
    /// Index among the near obstacles.
    pub(super) index: usize,
    pub(super) speed_m_s: f64,
    /// Present clearance of each section \[m\]: a lower bound, exact where it is less than `required_m`,
    /// infinite for a section that cannot reach the obstacle.
    pub(super) start_m: [f64; SECTIONS_MAX],
    /// Required clearance: D, or less for a ramp \[m\].
    pub(super) required_m: f64,
    /// Largest undershoot that is tolerated between two points of the path \[m\].
    pub(super) dip_m: f64,
}

/// A near obstacle at a later time; its position is computed on demand.
pub(super) struct PredictedObstacle<'a> {
    pub(super) watched: &'a WatchedObstacle<'a>,
    pub(super) time_s: f64,
    moved: OnceCell<Obstacle>,
}

impl PredictedObstacle<'_> {
    pub(super) fn obstacle(&self) -> &Obstacle {
        if self.watched.stands() {
            return self.watched.obstacle;
        }
        let moved = || self.watched.obstacle.moved(self.time_s);
        self.moved.get_or_init(moved)
    }
}

impl WatchedObstacle<'_> {
    /// The obstacle after `time_s`.
    pub(super) fn after(&self, time_s: f64) -> PredictedObstacle<'_> {
        PredictedObstacle {
            watched: self,
            time_s,
            moved: OnceCell::new(),
        }
    }

    pub(super) fn stands(&self) -> bool {
        self.speed_m_s == 0.0
    }

    /// Smallest present clearance \[m\]; NaN if one is.
    pub(super) fn nearest_m(&self) -> f64 {
        least_m(self.start_m.into_iter())
    }

    pub(super) fn is_sphere(&self) -> bool {
        is_sphere(self.obstacle)
    }

    /// Cost of one exact clearance.
    pub(super) fn cost(&self) -> u32 {
        clearance_cost(self.obstacle)
    }

    /// The sections that can reach it.
    pub(super) fn sections(&self) -> u8 {
        let bit = |j: usize| u8::from(self.start_m[j] != f64::INFINITY) << j;
        (0..SECTIONS_MAX).map(bit).sum()
    }

    /// Distance that it moves in a time \[m\].
    pub(super) fn moves_m(&self, time_s: f64) -> f64 {
        self.speed_m_s * time_s
    }

    /// Upper bound of the required clearance \[m\], cheaper than the exact one.
    pub(super) fn floor_bound_m(&self, j: usize, time_s: f64) -> f64 {
        (self.start_m[j] + self.moves_m(time_s)).min(self.required_m)
    }
}

/// The smallest clearance; NaN if one is.
pub(super) fn least_m(clearances_m: impl Iterator<Item = f64>) -> f64 {
    clearances_m.fold(f64::INFINITY, |least_m, clearance_m| {
        if least_m.is_nan() || clearance_m >= least_m {
            least_m
        } else {
            clearance_m
        }
    })
}
