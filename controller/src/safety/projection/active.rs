//! What holds the nearest point, and the linear equations of it.

use crate::robot::COORDINATES_MAX;

use super::{Row, Vector, add, dot};

/// The half-spaces that hold the point, and how strongly.
#[derive(Debug, Clone, Copy)]
pub(super) struct Active {
    pub(super) rows: [Row; COORDINATES_MAX],
    pub(super) multipliers: Vector,
    pub(super) count: usize,
    /// Cholesky's factor of Nᵀ N, with the normals as N: row by row, as they are taken in.
    factor: [Vector; COORDINATES_MAX],
}

impl Active {
    pub(super) const NONE: Self = Self {
        rows: [Row::ZERO; COORDINATES_MAX],
        multipliers: [0.0; COORDINATES_MAX],
        count: 0,
        factor: [[0.0; COORDINATES_MAX]; COORDINATES_MAX],
    };

    /// The solution of Nᵀ N x = `right`. `None` where those held depend on each other.
    pub(super) fn solved(&self, right: impl Fn(usize) -> f64) -> Option<Vector> {
        let is_dependent = (0..self.count).any(|i| self.factor[i][i] == 0.0);
        (!is_dependent).then(|| self.solved_back(&self.solved_forward(right)))
    }

    /// The first half of that: L y = `right`.
    pub(super) fn solved_forward(&self, right: impl Fn(usize) -> f64) -> Vector {
        let mut solved = [0.0; COORDINATES_MAX];
        for (i, row) in self.factor[..self.count].iter().enumerate() {
            // What follows is zero in one of both.
            solved[i] = (right(i) - dot(row, &solved)) / row[i];
        }
        solved
    }

    /// The second half: Lᵀ x = y.
    pub(super) fn solved_back(&self, forward: &Vector) -> Vector {
        let mut solved = *forward;
        for (i, row) in self.factor[..self.count].iter().enumerate().rev() {
            let share = solved[i] / row[i];
            add(&mut solved, row, -share);
            solved[i] = share;
        }
        solved
    }

    /// What of `normal` the held ones do not span.
    pub(super) fn rest(&self, normal: &Vector, shares: &Vector) -> Vector {
        let mut rest = *normal;
        for (row, share) in self.rows[..self.count].iter().zip(shares) {
            add(&mut rest, &row.normal, -share);
        }
        rest
    }

    /// The step after which the first of those held lets go, and which that is.
    pub(super) fn lets_go(&self, shares: &Vector) -> (f64, usize) {
        let (mut until, mut first) = (f64::INFINITY, 0);
        for i in 0..self.count {
            let step = self.multipliers[i].max(0.0) / shares[i];
            if shares[i] > 0.0 && step < until {
                (until, first) = (step, i);
            }
        }
        (until, first)
    }

    /// Takes in a row, with what [`Self::solved_forward`] makes of its products with those held.
    pub(super) fn push(&mut self, row: Row, multiplier: f64, mut forward: Vector) {
        let rest = dot(&row.normal, &row.normal) - dot(&forward, &forward);
        forward[self.count] = rest.max(0.0).sqrt();
        self.factor[self.count] = forward;
        self.rows[self.count] = row;
        self.multipliers[self.count] = multiplier;
        self.count += 1;
    }

    pub(super) fn remove(&mut self, i: usize) {
        self.count -= 1;
        self.rows.copy_within(i + 1..=self.count, i);
        self.multipliers.copy_within(i + 1..=self.count, i);
        self.multipliers[self.count] = 0.0;
        // Rows that come after have one number beyond the diagonal now, which rotations of two columns each make zero.
        self.factor.copy_within(i + 1..=self.count, i);
        for k in i..self.count {
            let [here, beyond] = [self.factor[k][k], self.factor[k][k + 1]];
            let length = (here * here + beyond * beyond).sqrt();
            let [cos, sin] = [here / length, beyond / length];
            for row in &mut self.factor[k..self.count] {
                let [here, beyond] = [row[k], row[k + 1]];
                (row[k], row[k + 1]) = (cos * here + sin * beyond, cos * beyond - sin * here);
            }
            self.factor[k][k + 1] = 0.0;
        }
    }
}
