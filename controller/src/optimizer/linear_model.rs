//! A problem near one point: residuals, their derivatives, and constraints that a step may meet.

use std::collections::BinaryHeap;

use super::{Budget, VIOLATIONS};

/// Residuals r, Jacobian J and linearised constraints h + A Δ ≥ 0 at one point.
///
/// A constraint that a step would break becomes a residual of its own, so the step ends on it. Each is
/// written by its problem in a scale in which it outweighs the residuals.
#[derive(Debug, Clone)]
pub(crate) struct LinearModel {
    columns: usize,
    residuals: Vec<f64>,
    jacobian: Vec<f64>,
    /// Residuals of the cost; those after them are constraints that were met.
    cost_rows: usize,
    constraints: Vec<f64>,
    constraint_jacobian: Vec<f64>,
    /// Of each kind, how far each is from being broken, in the measure of its problem, and its index.
    slackest: [BinaryHeap<(i64, usize)>; VIOLATIONS],
    met: Vec<bool>,
    constraints_max: usize,
}

impl LinearModel {
    pub(crate) fn with_capacity(rows: usize, constraints: usize, columns: usize) -> Self {
        Self {
            columns: 0,
            residuals: Vec::with_capacity(rows + constraints),
            jacobian: Vec::with_capacity((rows + constraints) * columns),
            cost_rows: 0,
            constraints: Vec::with_capacity(constraints),
            constraint_jacobian: Vec::with_capacity(constraints * columns),
            slackest: core::array::from_fn(|_| BinaryHeap::with_capacity(constraints)),
            met: Vec::with_capacity(constraints),
            constraints_max: constraints,
        }
    }

    pub(crate) fn clear(&mut self, columns: usize) {
        self.residuals.clear();
        self.jacobian.clear();
        self.constraints.clear();
        self.constraint_jacobian.clear();
        self.slackest.iter_mut().for_each(BinaryHeap::clear);
        self.met.clear();
        self.columns = columns;
        self.cost_rows = 0;
    }

    /// Adds a row with all derivatives zero, and returns the derivatives for the caller to fill in.
    pub(crate) fn push(&mut self, residual: f64) -> &mut [f64] {
        let start = self.jacobian.len();
        self.residuals.push(residual);
        self.cost_rows += 1;
        self.jacobian.resize(start + self.columns, 0.0);
        &mut self.jacobian[start..]
    }

    /// Adds a constraint h + A Δ ≥ 0 of a kind (below [`VIOLATIONS`]) with all derivatives zero, and returns them for the caller
    /// to fill in. Of more than there is room for, steps see those with the least `slack`: None for one that has the most.
    /// No kind takes more than its equal part of the room while another needs it.
    pub(crate) fn push_constraint(
        &mut self,
        kind: usize,
        h: f64,
        slack: f64,
    ) -> Option<&mut [f64]> {
        let order = in_order(slack);
        let mut index = self.constraints.len();
        if index < self.constraints_max {
            self.constraints.push(h);
            self.met.push(false);
            let length = (index + 1) * self.columns;
            self.constraint_jacobian.resize(length, 0.0);
        } else {
            let crowded = if self.slackest[kind].len() < self.constraints_max / VIOLATIONS {
                self.slackest.iter_mut().max_by_key(|heap| heap.len())?
            } else {
                let own = &mut self.slackest[kind];
                if order >= own.peek()?.0 {
                    return None;
                }
                own
            };
            index = crowded.pop()?.1;
            self.constraints[index] = h;
            self.constraint_jacobian[index * self.columns..][..self.columns].fill(0.0);
        }
        self.slackest[kind].push((order, index));
        Some(&mut self.constraint_jacobian[index * self.columns..][..self.columns])
    }

    /// Residuals of the cost: the first of all.
    pub(super) fn cost_rows(&self) -> usize {
        self.cost_rows
    }

    /// Residuals, with those of constraints that were met.
    pub(crate) fn rows(&self) -> usize {
        self.residuals.len()
    }

    pub(crate) fn residual(&self, index: usize) -> f64 {
        self.residuals[index]
    }

    pub(crate) fn row(&self, index: usize) -> &[f64] {
        &self.jacobian[index * self.columns..][..self.columns]
    }

    /// Whether a constraint was met.
    pub(super) fn is_constrained(&self) -> bool {
        self.rows() > self.cost_rows
    }

    /// Forgets which constraints were met.
    pub(super) fn release_constraints(&mut self) {
        self.residuals.truncate(self.cost_rows);
        self.jacobian.truncate(self.cost_rows * self.columns);
        self.met.fill(false);
    }

    /// Makes residuals of the constraints that `step` breaks. None when it breaks none that were not met
    /// before, or the budget was spent.
    pub(crate) fn meet_constraints(&mut self, step: &[f64], budget: &mut Budget<'_>) -> Option<()> {
        let before = self.rows();
        for (index, h) in self.constraints.iter().enumerate() {
            if !budget.spend(self.columns as u32) {
                return None;
            }
            let row = &self.constraint_jacobian[index * self.columns..][..self.columns];
            if !self.met[index] && h + dot(row, step) < 0.0 {
                self.met[index] = true;
                self.residuals.push(*h);
                self.jacobian.extend_from_slice(row);
            }
        }
        (self.rows() > before).then_some(())
    }

    /// Half the gradient of the cost, Jᵀr, and what its norm would be if all rows pulled one way: the Frobenius
    /// norm of J times the norm of r. None: the budget was spent.
    pub(super) fn gradient(&self, into: &mut [f64], budget: &mut Budget<'_>) -> Option<f64> {
        into.fill(0.0);
        let (mut jacobian, mut residuals) = (0.0, 0.0);
        for (index, residual) in self.residuals.iter().enumerate() {
            if !budget.spend(self.columns as u32) {
                return None;
            }
            let row = self.row(index);
            for (sum, derivative) in into.iter_mut().zip(row) {
                *sum += derivative * residual;
            }
            jacobian += dot(row, row);
            residuals += residual * residual;
        }
        Some(f64::sqrt(jacobian * residuals))
    }
}

/// An integer that is in the order of [`f64::total_cmp`].
fn in_order(number: f64) -> i64 {
    let bits = number.to_bits().cast_signed();
    bits ^ ((bits >> 63).cast_unsigned() >> 1).cast_signed()
}

/// Σ aᵢ bᵢ over the shorter length, in eight sums side by side: the order is fixed, and no product waits for the
/// one before it.
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let length = a.len().min(b.len());
    let (a, a_rest) = a[..length].as_chunks::<8>();
    let (b, b_rest) = b[..length].as_chunks::<8>();
    let mut sums = [0.0; 8];
    for (a, b) in a.iter().zip(b) {
        for i in 0..8 {
            sums[i] += a[i] * b[i];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    let [s0, s1, s2, s3, s4, s5, s6, s7] = sums;
    ((s0 + s1) + (s2 + s3)) + ((s4 + s5) + (s6 + s7)) + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The slacks that a step sees of constraints of these kinds and slacks.
    fn seen(room: usize, constraints: &[(usize, f64)]) -> Vec<f64> {
        let mut model = LinearModel::with_capacity(0, room, 1);
        model.clear(1);
        for &(kind, slack) in constraints {
            let Some(derivatives) = model.push_constraint(kind, slack, slack) else {
                continue;
            };
            assert_eq!(derivatives, [0.0]);
            derivatives[0] = -1.0;
        }
        let met = model.meet_constraints(&[100.0], &mut Budget::unlimited());
        assert_eq!(met, Some(()));
        let mut seen: Vec<f64> = (0..model.rows()).map(|row| model.residual(row)).collect();
        seen.sort_by(f64::total_cmp);
        seen
    }

    #[test]
    fn of_too_many_constraints_a_step_sees_those_with_the_least_slack() {
        let one_kind = [5.0, -1.0, 4.0, 9.0, -2.0, 3.0].map(|slack| (0, slack));
        assert_eq!(seen(3, &one_kind), [-2.0, -1.0, 3.0]);
    }

    #[test]
    fn no_kind_of_constraint_displaces_another_from_its_part() {
        let near = [5.0, -1.0, 4.0, 9.0, -2.0, 3.0].map(|slack| (0, slack));
        let far = [70.0, 90.0, 60.0].map(|slack| (1, slack));
        for mixed in [[&near[..], &far].concat(), [&far[..], &near].concat()] {
            assert_eq!(seen(4, &mixed), [-2.0, -1.0, 60.0, 70.0]);
            // What one kind leaves is the other's.
            assert_eq!(
                seen(8, &mixed),
                [-2.0, -1.0, 3.0, 4.0, 5.0, 60.0, 70.0, 90.0]
            );
        }
    }
}
