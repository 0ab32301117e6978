use nalgebra::Matrix6;

use super::geometry::Geometry;
use super::prediction::{CalibrationRow, Prediction, residual_of};

/// Median of a chi-squared variable with three degrees of freedom.
const MEDIAN_CHI_SQUARE_3: f64 = 2.366;
/// Ratio of the standard deviation to the median absolute deviation of normal numbers.
pub const DEVIATION_OF_MEDIAN: f64 = 1.4826;
/// Lower limit of the estimated noise (m and rad).
const NOISE_MIN: f64 = 1e-9;

/// Standard deviations of the measurements.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Length of a cable (m).
    pub cable_m: f64,
    /// Each coordinate of the tip (m), including model errors that resemble noise.
    pub tip_m: f64,
    /// Rotation of the tip about each axis (rad).
    pub tip_rad: f64,
}

impl Noise {
    /// Estimates the noise of the cables from rows in the order of measurement; that of the tip is an initial guess.
    ///
    /// Three cables bend a section about two axes, so their mean contains only noise. Differences from row to row
    /// exclude slow changes by stretch and slack.
    pub(super) fn of_cables(rows: &[CalibrationRow], sections: usize) -> Self {
        let mean = |row: &CalibrationRow, j: usize| {
            row.cable_length_m[3 * j..3 * j + 3].iter().sum::<f64>() / 3.0
        };
        let steps = (0..sections).flat_map(|j| {
            let pairs = rows.windows(2);
            pairs.map(move |pair| (mean(&pair[1], j) - mean(&pair[0], j)).abs())
        });
        // The mean of three has a third of the variance, the difference of two twice that.
        let deviation_m = DEVIATION_OF_MEDIAN * median(steps.collect()) * (1.5_f64).sqrt();
        Self {
            cable_m: deviation_m.max(NOISE_MIN),
            tip_m: 1e-3,
            tip_rad: 1e-2,
        }
    }

    /// Matrix that whitens the residual of a row: its components get unit variance and are independent. Rows of
    /// unmeasured quantities are zero.
    pub(super) fn whitening(&self, prediction: &Prediction, row: &CalibrationRow) -> Matrix6<f64> {
        let mut covariance = prediction.covariance(self.cable_m);
        let is_turned = row.tip_rotation.is_some();
        for axis in 0..3 {
            covariance[(axis, axis)] += self.tip_m * self.tip_m;
            covariance[(axis + 3, axis + 3)] += self.tip_rad * self.tip_rad;
        }
        if !is_turned {
            covariance.fixed_view_mut::<3, 3>(0, 3).fill(0.0);
            covariance.fixed_view_mut::<3, 3>(3, 0).fill(0.0);
        }
        let Some(cholesky) = covariance.cholesky() else {
            return Matrix6::zeros();
        };
        let mut white = Matrix6::identity();
        cholesky.l().solve_lower_triangular_mut(&mut white);
        if !is_turned {
            white.fixed_view_mut::<3, 3>(3, 3).fill(0.0);
        }
        white
    }

    /// The noise of the tip that explains the residuals at `geometry`. Estimated by their median, so that outliers have
    /// little influence.
    #[must_use]
    pub(super) fn with_tip_noise(&self, geometry: &Geometry, rows: &[&CalibrationRow]) -> Self {
        let Ok(robot) = geometry.checked() else {
            return *self;
        };
        let parts = rows.iter().map(|row| {
            let covariance = Prediction::new(&robot, geometry, row).covariance(self.cable_m);
            (covariance, residual_of(&robot, geometry, row))
        });
        let parts: Vec<_> = parts.collect();
        // Median of the squared residuals if the noise of this block were `deviation`.
        let median_at = |block: usize, deviation: f64| {
            let squares = parts.iter().map(|(covariance, residual)| {
                let mut own = covariance.fixed_view::<3, 3>(block, block).into_owned();
                for axis in 0..3 {
                    own[(axis, axis)] += deviation * deviation;
                }
                let residual = residual.fixed_rows::<3>(block).into_owned();
                let solved = own.cholesky().map(|cholesky| cholesky.solve(&residual));
                solved.map_or(0.0, |solved| solved.dot(&residual))
            });
            median(squares.collect())
        };
        let tip_noise = |block: usize| {
            // Bisection in the logarithm.
            let (mut low, mut high) = (NOISE_MIN.ln(), 1.0_f64.ln());
            for _ in 0..24 {
                let middle = 0.5 * (low + high);
                if median_at(block, middle.exp()) > MEDIAN_CHI_SQUARE_3 {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            high.exp()
        };
        let is_turned = rows.first().is_some_and(|row| row.tip_rotation.is_some());
        Self {
            tip_m: tip_noise(0),
            tip_rad: if is_turned {
                tip_noise(3)
            } else {
                self.tip_rad
            },
            ..*self
        }
    }
}

/// The median, of an even number of values the upper one of the two in the middle; 0 for an empty list.
pub fn median(mut values: Vec<f64>) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}
