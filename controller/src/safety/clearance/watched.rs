//! An obstacle that the body can get too near to.

use core::cell::OnceCell;

use crate::robot::{Obstacle, SECTIONS_MAX, Shape};

/// How many looks an exact clearance from a capsule takes the time of.
pub(super) const CAPSULE_LOOKS: u32 = 7;

#[derive(Clone, Copy)]
pub(super) struct Watched<'a> {
    pub(super) obstacle: &'a Obstacle,
    /// Its place among the watched.
    pub(super) index: usize,
    pub(super) speed_m_s: f64,
    /// The clearance of each section now \[m\], at least, and exactly where it is less than `kept_m`: infinite for one that is
    /// not watched.
    pub(super) start_m: [f64; SECTIONS_MAX],
    /// D, or what counts instead \[m\].
    pub(super) kept_m: f64,
    /// What is not looked for between two places of the way \[m\].
    pub(super) dip_m: f64,
}

/// A watched obstacle after a time, moved on when it is asked for.
pub(super) struct There<'a> {
    pub(super) watched: &'a Watched<'a>,
    pub(super) time_s: f64,
    moved: OnceCell<Obstacle>,
}

impl There<'_> {
    pub(super) fn obstacle(&self) -> &Obstacle {
        if self.watched.stands() {
            return self.watched.obstacle;
        }
        let moved = || self.watched.obstacle.moved(self.time_s);
        self.moved.get_or_init(moved)
    }
}

impl Watched<'_> {
    /// Where it is after a time.
    pub(super) fn after(&self, time_s: f64) -> There<'_> {
        There {
            watched: self,
            time_s,
            moved: OnceCell::new(),
        }
    }

    pub(super) fn stands(&self) -> bool {
        self.speed_m_s == 0.0
    }

    /// The least of its clearances now \[m\]; NaN where one is.
    pub(super) fn nearest_m(&self) -> f64 {
        least_m(self.start_m.into_iter())
    }

    pub(super) fn is_ball(&self) -> bool {
        matches!(self.obstacle.shape(), Shape::Sphere { .. })
    }

    /// What an exact clearance from it counts.
    pub(super) fn looks(&self) -> u32 {
        if self.is_ball() { 1 } else { CAPSULE_LOOKS }
    }

    /// Those that can come too near.
    pub(super) fn sections(&self) -> u8 {
        let bit = |j: usize| u8::from(self.start_m[j] != f64::INFINITY) << j;
        (0..SECTIONS_MAX).map(bit).sum()
    }

    /// How far it moves at most \[m\].
    pub(super) fn moves_m(&self, time_s: f64) -> f64 {
        self.speed_m_s * time_s
    }

    /// What that is at most, for less than it costs to find it.
    pub(super) fn floor_most_m(&self, j: usize, time_s: f64) -> f64 {
        (self.start_m[j] + self.moves_m(time_s)).min(self.kept_m)
    }
}

/// The least of some clearances; NaN where one is.
pub(super) fn least_m(clearances_m: impl Iterator<Item = f64>) -> f64 {
    clearances_m.fold(f64::INFINITY, |least_m, clearance_m| {
        if least_m.is_nan() || clearance_m >= least_m {
            least_m
        } else {
            clearance_m
        }
    })
}
