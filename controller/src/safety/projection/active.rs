//! The active set of the projection, and its linear equations.

use crate::robot::COORDINATES_MAX;

use super::{ConstraintRow, Vector, add, dot};

/// The active half-spaces and their multipliers.
#[derive(Debug, Clone, Copy)]
pub(super) struct Active {
    pub(super) rows: [ConstraintRow; COORDINATES_MAX],
    pub(super) multipliers: Vector,
    pub(super) count: usize,
    /// Cholesky factor of Nᵀ N for the normals N, by row, in the order of addition.
    factor: [Vector; COORDINATES_MAX],
}

impl Active {
    pub(super) const NONE: Self = Self {
        rows: [ConstraintRow::ZERO; COORDINATES_MAX],
        multipliers: [0.0; COORDINATES_MAX],
        count: 0,
        factor: [[0.0; COORDINATES_MAX]; COORDINATES_MAX],
    };

    /// The solution of Nᵀ N x = `right`. `None` if the normals are linearly dependent.
    pub(super) fn solved(&self, right: impl Fn(usize) -> f64) -> Option<Vector> {
        let is_dependent = (0..self.count).any(|i| self.factor[i][i] == 0.0);
        (!is_dependent).then(|| self.solved_back(&self.solved_forward(right)))
    }

    /// Forward substitution: L y = `right`.
    pub(super) fn solved_forward(&self, right: impl Fn(usize) -> f64) -> Vector {
        let mut solved = [0.0; COORDINATES_MAX];
        for (i, row) in self.factor[..self.count].iter().enumerate() {
            // Components from i on are zero in `row` or in `solved`.
            solved[i] = (right(i) - dot(row, &solved)) / row[i];
        }
        solved
    }

    /// Back substitution: Lᵀ x = y.
    pub(super) fn solved_back(&self, forward: &Vector) -> Vector {
        let mut solved = *forward;
        for (i, row) in self.factor[..self.count].iter().enumerate().rev() {
            let share = solved[i] / row[i];
            add(&mut solved, row, -share);
            solved[i] = share;
        }
        solved
    }

    /// Component of `normal` orthogonal to the active normals.
    pub(super) fn rest(&self, normal: &Vector, shares: &Vector) -> Vector {
        let mut rest = *normal;
        for (row, share) in self.rows[..self.count].iter().zip(shares) {
            add(&mut rest, &row.normal, -share);
        }
        rest
    }

    /// The step at which the first multiplier becomes zero, and its index.
    pub(super) fn first_released(&self, shares: &Vector) -> (f64, usize) {
        let (mut until, mut first) = (f64::INFINITY, 0);
        for i in 0..self.count {
            let step = self.multipliers[i].max(0.0) / shares[i];
            if shares[i] > 0.0 && step < until {
                (until, first) = (step, i);
            }
        }
        (until, first)
    }

    /// Adds a row; `forward` is [`Self::solved_forward`] of its products with the active rows.
    pub(super) fn push(&mut self, row: ConstraintRow, multiplier: f64, mut forward: Vector) {
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
        // Later rows now have one entry beyond the diagonal; Givens rotations of column pairs eliminate it.
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
