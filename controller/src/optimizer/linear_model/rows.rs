//! Rows of a linear model.

use crate::optimizer::RowStage;

/// Values with their derivatives.
#[derive(Debug)]
pub(super) struct Rows {
    pub(super) values: Vec<f64>,
    /// Those of the rows, and what earlier rows left after them.
    pub(super) derivatives: Vec<f64>,
    pub(super) row_stages: Vec<RowStage>,
}

impl Rows {
    pub(super) fn with_capacity(rows: usize, columns: usize) -> Self {
        Self {
            values: Vec::with_capacity(rows),
            derivatives: Vec::with_capacity(rows * columns),
            row_stages: Vec::with_capacity(rows),
        }
    }

    pub(super) fn truncate(&mut self, rows: usize) {
        self.values.truncate(rows);
        self.row_stages.truncate(rows);
    }

    /// Adds a row with any derivatives, for the caller to fill in.
    #[inline(always)]
    pub(super) fn push(&mut self, value: f64, stage: RowStage, stride: usize) -> &mut [f64] {
        let start = self.values.len() * stride;
        let end = start + stride;
        self.values.push(value);
        self.row_stages.push(stage);
        if self.derivatives.len() < end {
            self.derivatives.resize(end, 0.0);
        }
        &mut self.derivatives[start..end]
    }
}
