//! The linear system of dense rows, in the space of the residuals or of the unknowns, whichever is smaller.

use super::GaussNewton;
use crate::optimizer::products::{ANNOUNCED_MAX, add_times, dot, with_known_size};
use crate::optimizer::{Budget, cholesky};

impl GaussNewton {
    /// Solves for the free unknowns, with the fixed ones at their present step.
    pub(super) fn solve_dense(
        &mut self,
        dimension: usize,
        damping: f64,
        budget: &mut Budget<'_>,
    ) -> bool {
        self.factored = self.free.len();
        let rows = self.model.rows();
        let weight = damping + self.model.regulariser().map_or(0.0, |(weight, _)| weight);
        match self.prepare(dimension, damping, budget) {
            None => false,
            Some(true) => self.solve_in_residual_space(rows, weight, budget),
            Some(false) => self.solve_in_unknown_space(dimension, rows, weight, budget),
        }
    }

    /// Initialises the step of the free unknowns and computes the residuals there. In residual space the step
    /// starts at the minimum of weight and damping alone, otherwise at zero. Returns whether the system is
    /// solved in residual space. None: the budget was spent.
    fn prepare(&mut self, dimension: usize, damping: f64, budget: &mut Budget<'_>) -> Option<bool> {
        let rows = self.model.rows();
        let by_residuals = rows <= self.free.len();
        let regulariser = self.model.regulariser().filter(|_| by_residuals);
        for &i in &self.free {
            let own =
                regulariser.map(|(weight, distances)| -weight * distances[i] / (damping + weight));
            self.step[i] = own.unwrap_or(0.0);
        }
        // Contribution of the fixed unknowns.
        let at_rest = self.step[..dimension].iter().all(|step| *step == 0.0);
        self.residuals[..rows].copy_from_slice(self.model.residuals());
        for row in 0..if at_rest { 0 } else { rows } {
            if !budget.spend(dimension as u32) {
                return None;
            }
            self.residuals[row] += dot(self.model.row(row), &self.step[..dimension]);
        }
        Some(by_residuals)
    }

    /// Copies the columns of the free unknowns, row by row, to contiguous memory.
    fn gather_free_columns(&mut self, rows: usize, budget: &mut Budget<'_>) -> bool {
        let width = self.free.len();
        for row in 0..rows {
            if !budget.spend(width as u32) {
                return false;
            }
            let source = self.model.row(row);
            let target = &mut self.columns[row * width..][..width];
            if width == source.len() {
                target.copy_from_slice(source);
                continue;
            }
            for (target, &i) in target.iter_mut().zip(&self.free) {
                *target = source[i];
            }
        }
        true
    }

    /// Δ = -Jᵀ y with (J Jᵀ + wI) y = r, where w is the sum of the damping and the weight of the unknowns.
    fn solve_in_residual_space(
        &mut self,
        rows: usize,
        weight: f64,
        budget: &mut Budget<'_>,
    ) -> bool {
        let width = self.free.len();
        if !self.gather_free_columns(rows, budget) {
            return false;
        }
        for a in 0..rows {
            let row_a = &self.columns[a * width..][..width];
            let line = self.matrix[a * rows..][..=a].iter_mut();
            let line = line.zip(self.columns.chunks_exact(width));
            for (b, (entry, row_b)) in line.enumerate() {
                if !budget.spend(width as u32 / 4) {
                    return false;
                }
                *entry = dot(row_a, row_b) + if a == b { weight } else { 0.0 };
            }
        }
        cholesky::factorise(&mut self.matrix[..rows * rows], rows, budget)
            && self.step_in_residual_space(rows, budget)
    }

    /// The same with the factorised matrix.
    fn step_in_residual_space(&mut self, rows: usize, budget: &mut Budget<'_>) -> bool {
        let right_side = &mut self.right_side[..rows];
        right_side.copy_from_slice(&self.residuals[..rows]);
        if !cholesky::substitute(&self.matrix[..rows * rows], rows, right_side, budget) {
            return false;
        }
        for row in 0..rows {
            if !budget.spend(self.free.len() as u32) {
                return false;
            }
            let (weight, derivatives) = (self.right_side[row], self.model.row(row));
            if self.free.len() == derivatives.len() {
                add_times(-weight, derivatives, &mut self.step);
                continue;
            }
            for &i in &self.free {
                self.step[i] -= derivatives[i] * weight;
            }
        }
        true
    }

    /// Solves again for other residuals with the factorised matrix of the last solution. Only the unknowns
    /// that were free in it move. False also when the number of free unknowns has changed.
    pub(super) fn solve_with_last_factors(
        &mut self,
        dimension: usize,
        damping: f64,
        budget: &mut Budget<'_>,
    ) -> bool {
        if self.free.is_empty() || self.free.len() != self.factored {
            return false;
        }
        self.step[..dimension].fill(0.0);
        if self.model.is_staged() {
            let step = &mut self.step[..dimension];
            let (model, free) = (&self.model, &self.free);
            return self
                .smoother
                .solve_again(model, free, damping, step, budget);
        }
        let rows = self.model.rows();
        match self.prepare(dimension, damping, budget) {
            None => false,
            Some(true) => self.step_in_residual_space(rows, budget),
            Some(false) => self.step_in_unknown_space(rows, budget),
        }
    }

    /// JᵀJ of the cost's rows, lower triangle, once per linearisation.
    fn fill_gram(&mut self, dimension: usize, budget: &mut Budget<'_>) -> bool {
        if !self.gram_is_current {
            self.gram_is_current =
                with_known_size!(dimension, self.fill_gram_of(dimension, budget));
        }
        self.gram_is_current
    }

    #[inline(always)]
    fn fill_gram_of(&mut self, dimension: usize, budget: &mut Budget<'_>) -> bool {
        let gram = &mut self.gram[..dimension * dimension];
        gram.fill(0.0);
        for row in 0..self.model.cost_rows() {
            let derivatives = &self.model.row(row)[..dimension];
            for i in 0..dimension {
                // Rows of early steps do not depend on late blocks.
                if derivatives[i] == 0.0 {
                    continue;
                }
                if !budget.spend(i as u32 / 2) {
                    return false;
                }
                // Some entries beside the diagonal, which nothing reads, make the row one of fours.
                let end = if dimension <= 4 {
                    dimension
                } else {
                    dimension.min((i + 1).next_multiple_of(4))
                };
                let target = &mut gram[i * dimension..][..end];
                add_times(derivatives[i], derivatives, target);
            }
        }
        true
    }

    /// The part of JᵀJ for the free unknowns, active constraints included.
    fn gather_free_matrix(
        &mut self,
        dimension: usize,
        rows: usize,
        budget: &mut Budget<'_>,
    ) -> bool {
        let order = self.free.len();
        if order == dimension && order <= ANNOUNCED_MAX {
            if !budget.spend_each(0..order as u32) {
                return false;
            }
            let size = order * order;
            self.matrix[..size].copy_from_slice(&self.gram[..size]);
        } else {
            for (a, &i) in self.free.iter().enumerate() {
                if !budget.spend(a as u32) {
                    return false;
                }
                for (b, &k) in self.free[..=a].iter().enumerate() {
                    self.matrix[a * order + b] = self.gram[i * dimension + k];
                }
            }
        }
        for row in self.model.cost_rows()..rows {
            let derivatives = self.model.row(row);
            for (a, &i) in self.free.iter().enumerate() {
                if !budget.spend(a as u32) {
                    return false;
                }
                for (b, &k) in self.free[..=a].iter().enumerate() {
                    self.matrix[a * order + b] += derivatives[i] * derivatives[k];
                }
            }
        }
        true
    }

    /// (JᵀJ + wI) Δ = -Jᵀ r - ρ z, where ρ is the weight of the unknowns, and w the sum of ρ and the damping.
    fn solve_in_unknown_space(
        &mut self,
        dimension: usize,
        rows: usize,
        weight: f64,
        budget: &mut Budget<'_>,
    ) -> bool {
        let order = self.free.len();
        if !self.fill_gram(dimension, budget) || !self.gather_free_matrix(dimension, rows, budget) {
            return false;
        }
        for a in 0..order {
            self.matrix[a * order + a] += weight;
        }
        cholesky::factorise(&mut self.matrix[..order * order], order, budget)
            && self.step_in_unknown_space(rows, budget)
    }

    /// The same with the factorised matrix.
    fn step_in_unknown_space(&mut self, rows: usize, budget: &mut Budget<'_>) -> bool {
        let order = self.free.len();
        let regulariser = self.model.regulariser();
        for (side, &i) in self.right_side.iter_mut().zip(&self.free) {
            // The residuals include the steps of the fixed unknowns; those of the free ones are zero.
            *side = regulariser.map_or(0.0, |(weight, distances)| -weight * distances[i]);
        }
        if order == self.model.row(0).len() {
            if !with_known_size!(order, self.subtract_gradient(order, rows, budget)) {
                return false;
            }
        } else {
            for row in 0..rows {
                if !budget.spend(order as u32) {
                    return false;
                }
                let (residual, derivatives) = (self.residuals[row], self.model.row(row));
                for (sum, &i) in self.right_side.iter_mut().zip(&self.free) {
                    *sum -= derivatives[i] * residual;
                }
            }
        }
        let right_side = &mut self.right_side[..order];
        if !cholesky::substitute(&self.matrix[..order * order], order, right_side, budget) {
            return false;
        }
        for (a, &i) in self.free.iter().enumerate() {
            self.step[i] = self.right_side[a];
        }
        true
    }

    /// Subtracts Jᵀr from the right side, where all unknowns are free. False: the budget was spent.
    #[inline(always)]
    fn subtract_gradient(&mut self, order: usize, rows: usize, budget: &mut Budget<'_>) -> bool {
        let sums = &mut self.right_side[..order];
        for (row, residual) in self.residuals[..rows].iter().enumerate() {
            if !budget.spend(order as u32) {
                return false;
            }
            add_times(-residual, &self.model.row(row)[..order], sums);
        }
        true
    }
}
