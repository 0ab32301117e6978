use nalgebra::{Matrix3, Vector3};

use crate::robot::{COORDINATES_MAX, Configuration, Jacobian, Robot};

/// Default standard deviation of the noise in a tip coordinate \[m\].
pub(super) const TIP_NOISE_M: f64 = 3e-4;
/// Standard deviation of a bend's deviation from its command after one second \[rad/√s\]. With the noise above and a
/// measurement every 5 ms, the filter averages over 0.14 s for one section of the paper's robot and over 0.02 s for
/// three.
const BEND_NOISE_RAD_SQRT_S: f64 = 1e-3;
/// Standard deviation of a bend before any measurement, and its upper limit \[rad\]. A larger value would turn noise
/// into large bends: an S shape of a straight robot hardly moves its tip.
const PRIOR_RAD: f64 = 0.01;
/// Maximum number of steps of one correction.
const STEPS: usize = 12;
/// A correction has converged when no bend changes by more than this \[rad\].
const STEP_MIN_RAD: f64 = 1e-9;

/// Iterated extended Kalman filter of the bends from tip positions (Simon, *Optimal State Estimation*, §13.3.2).
///
/// A tip position has three numbers; a robot of two or more sections has four or more bends. The covariance retains the
/// information of earlier positions about the others, so that tip noise which no bend explains moves none. Near the
/// straight robot no bend moves the tip along its axis, and a step that trusts every measurement fully would diverge.
#[derive(Debug, Clone)]
pub(super) struct TipFilter {
    /// Covariance of the bends \[rad²\], symmetric.
    covariance: CovarianceMatrix,
    /// Variance of a measured coordinate \[m²\].
    noise_m2: f64,
}

impl TipFilter {
    /// Vague prior of the bends. `noise_m` is the standard deviation of a measured coordinate, above 0.
    pub(super) fn new(noise_m: f64) -> Self {
        let mut filter = Self {
            covariance: [[0.0; COORDINATES_MAX]; COORDINATES_MAX],
            noise_m2: noise_m * noise_m,
        };
        filter.set_variance(PRIOR_RAD * PRIOR_RAD);
        filter
    }

    /// Resets the bends to the vague prior.
    pub(super) fn begin(&mut self) {
        self.set_variance(PRIOR_RAD * PRIOR_RAD);
    }

    /// Records that every bend was measured.
    pub(super) fn set_known(&mut self) {
        self.set_variance(0.0);
    }

    fn set_variance(&mut self, variance: f64) {
        let row = |i| core::array::from_fn(|j| if i == j { variance } else { 0.0 });
        self.covariance = core::array::from_fn(row);
    }

    /// Grows the covariance by `elapsed_s`.
    pub(super) fn predict(&mut self, elapsed_s: f64) {
        let grown = BEND_NOISE_RAD_SQRT_S * BEND_NOISE_RAD_SQRT_S * elapsed_s;
        for i in 0..COORDINATES_MAX {
            let variance = &mut self.covariance[i][i];
            *variance = (*variance + grown).min(PRIOR_RAD * PRIOR_RAD);
        }
    }

    /// The most probable configuration from `before` and a tip at `position_m`: the minimum of (tip error / noise)² +
    /// yᵀy with bends = before + C y and P = C Cᵀ. Solved by Levenberg's damped steps; none increases the cost. Returns
    /// `before` if no solution is finite.
    pub(super) fn correct(
        &mut self,
        robot: &Robot,
        before: &Configuration,
        position_m: &Vector3<f64>,
    ) -> Configuration {
        let root = self.root();
        let mut jacobian = Jacobian::default();
        let mut damping = 0.0;
        let fit = |units| Fit::new(units, robot, before, &root, position_m, self.noise_m2);
        let mut now = fit([0.0; COORDINATES_MAX]);
        for _ in 0..STEPS {
            robot.tip_jacobian(&now.bends, &mut jacobian);
            let by_unit = by_unit(&jacobian, &root);
            let Some(units) = now.improved(&by_unit, damping, self.noise_m2) else {
                break;
            };
            let next = fit(units);
            let is_converged = next.max_change_rad(&now) < STEP_MIN_RAD;
            if next.cost < now.cost {
                damping *= 0.1;
                now = next;
            } else {
                damping = (damping * 10.0).max(1.0);
            }
            if is_converged {
                break;
            }
        }
        if !now.cost.is_finite() {
            return *before;
        }
        robot.tip_jacobian(&now.bends, &mut jacobian);
        self.update_covariance(&jacobian);
        now.bends
    }

    /// Lower triangle C with C Cᵀ = P (Cholesky); the column of an exactly known bend is zero.
    fn root(&self) -> CovarianceMatrix {
        let mut root = [[0.0; COORDINATES_MAX]; COORDINATES_MAX];
        for j in 0..COORDINATES_MAX {
            let left = |root: &CovarianceMatrix, i: usize| {
                let known = (0..j).map(|k| root[i][k] * root[j][k]);
                self.covariance[i][j] - known.sum::<f64>()
            };
            let pivot = left(&root, j);
            if pivot > 0.0 {
                root[j][j] = pivot.sqrt();
                for i in j + 1..COORDINATES_MAX {
                    root[i][j] = left(&root, i) / root[j][j];
                }
            }
        }
        root
    }

    /// Updates the covariance by the measurement: P - P Jᵀ S⁻¹ J P with S = J P Jᵀ + R.
    fn update_covariance(&mut self, jacobian: &Jacobian) {
        let cross = by_unit(jacobian, &self.covariance);
        let mut innovation = Matrix3::identity() * self.noise_m2;
        for (row, cross) in rows(jacobian).zip(&cross) {
            innovation += row * cross.transpose();
        }
        let Some(cholesky) = innovation.cholesky() else {
            return;
        };
        let gain = cross.map(|cross| cholesky.solve(&cross));
        for i in 0..COORDINATES_MAX {
            for j in 0..=i {
                let left = self.covariance[i][j] - gain[i].dot(&cross[j]);
                let left = if i == j { left.max(0.0) } else { left };
                self.covariance[i][j] = left;
                self.covariance[j][i] = left;
            }
        }
    }
}

type CovarianceMatrix = [[f64; COORDINATES_MAX]; COORDINATES_MAX];

/// A candidate configuration between prediction and measurement.
struct Fit {
    /// y: deviation from the prediction, in standard deviations.
    units: [f64; COORDINATES_MAX],
    bends: Configuration,
    /// Measured tip minus the tip of these bends \[m\].
    residual_m: Vector3<f64>,
    cost: f64,
}

impl Fit {
    fn new(
        units: [f64; COORDINATES_MAX],
        robot: &Robot,
        before: &Configuration,
        root: &CovarianceMatrix,
        position_m: &Vector3<f64>,
        noise_m2: f64,
    ) -> Self {
        let mut bends = *before;
        for (bend, row) in bends.as_mut_slice().iter_mut().zip(root) {
            *bend += row.iter().zip(&units).map(|(a, b)| a * b).sum::<f64>();
        }
        let residual_m = position_m - robot.tip_position(&bends);
        let cost = residual_m.norm_squared() / noise_m2
            + units.iter().map(|unit| unit * unit).sum::<f64>();
        Self {
            units,
            bends,
            residual_m,
            cost,
        }
    }

    /// The next y: (AᵀA/R + (1 + damping) I) Δ = Aᵀ missing/R - y, where A holds the motion of the tip per unit of y.
    /// Solved with a 3 × 3 matrix: (AᵀA/R + c I)⁻¹ v = (v - Aᵀ (A Aᵀ + c R I)⁻¹ A v) / c.
    fn improved(
        &self,
        by_unit: &[Vector3<f64>; COORDINATES_MAX],
        damping: f64,
        noise_m2: f64,
    ) -> Option<[f64; COORDINATES_MAX]> {
        let damped = 1.0 + damping;
        let mut gram = Matrix3::identity() * (damped * noise_m2);
        let mut by_tip = Vector3::zeros();
        let slope: [f64; COORDINATES_MAX] =
            core::array::from_fn(|i| by_unit[i].dot(&self.residual_m) / noise_m2 - self.units[i]);
        for (column, slope) in by_unit.iter().zip(&slope) {
            gram += column * column.transpose();
            by_tip += column * *slope;
        }
        let weights = gram.cholesky()?.solve(&by_tip);
        Some(core::array::from_fn(|i| {
            self.units[i] + (slope[i] - by_unit[i].dot(&weights)) / damped
        }))
    }

    fn max_change_rad(&self, other: &Self) -> f64 {
        let pairs = self.bends.as_slice().iter().zip(other.bends.as_slice());
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }
}

/// Motion of the tip by each column of a matrix over the bends.
fn by_unit(jacobian: &Jacobian, matrix: &CovarianceMatrix) -> [Vector3<f64>; COORDINATES_MAX] {
    let mut sums = [Vector3::zeros(); COORDINATES_MAX];
    for (tip, row) in rows(jacobian).zip(matrix) {
        for (sum, weight) in sums.iter_mut().zip(row) {
            *sum += tip * *weight;
        }
    }
    sums
}

/// Motion of the tip by each bend \[m/rad\].
fn rows(jacobian: &Jacobian) -> impl Iterator<Item = Vector3<f64>> + '_ {
    let columns = jacobian.columns().iter();
    columns.map(|column| Vector3::from_column_slice(&column[..3]))
}
