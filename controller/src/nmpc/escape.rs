//! Escape directions where the gradient vanishes but the error does not.
//!
//! To first order, a straight robot cannot move its tip along its axis: every column of the Jacobian is
//! perpendicular to the axis. To second order it can, along eigenvectors of the Hessian with negative
//! eigenvalues. For three sections these are the S shapes. No shape is hard-coded.

use nalgebra::{SMatrix, SymmetricEigen};

use super::motion::Bent;
use super::pose_error::{self, PoseWeights, ResidualRow};
use super::problem::TrackingProblem;
use crate::optimizer::Budget;
use crate::reference::ReferenceSample;
use crate::robot::{COORDINATES_MAX, Configuration, Jacobian};

/// Largest number of directions.
pub(super) const DIRECTIONS_MAX: usize = 4;
/// Nominal time of one column of the Hessian, for each section \[ns\].
const COLUMN_NS: u32 = 120;
/// Step of the central differences for the Hessian \[rad\].
const DIFFERENCE_RAD: f64 = 1e-4;
/// Largest number of iterations of the eigenvalue solver.
const EIGEN_ITERATIONS: usize = 200;
/// An eigenvalue counts as negative below minus this share of the largest magnitude; above that it is
/// rounding.
const NEGATIVE_SHARE: f64 = 1e-8;

/// Eigenvalues and eigenvectors of the leading block of a matrix. The matrix has a fixed size for each order,
/// so nothing is allocated on the heap. None if an entry is not finite or the iteration does not converge.
macro_rules! spectrum {
    ($order:literal, $matrix:expr) => {{
        let symmetric = SMatrix::<f64, $order, $order>::from_fn(|row, column| {
            0.5 * ($matrix[row][column] + $matrix[column][row])
        });
        let finite = symmetric.iter().all(|entry| entry.is_finite());
        finite
            .then(|| SymmetricEigen::try_new(symmetric, f64::EPSILON, EIGEN_ITERATIONS))
            .flatten()
            .map(|eigen| {
                let mut spectrum = Spectrum {
                    order: $order,
                    values: [0.0; COORDINATES_MAX],
                    vectors: [[0.0; COORDINATES_MAX]; COORDINATES_MAX],
                };
                for i in 0..$order {
                    spectrum.values[i] = eigen.eigenvalues[i];
                    for k in 0..$order {
                        spectrum.vectors[i][k] = eigen.eigenvectors[(k, i)];
                    }
                }
                spectrum
            })
    }};
}

/// Unit vectors of bends along which the cost decreases to second order, steepest first.
#[derive(Debug, Clone, Copy)]
pub(super) struct Directions {
    pub vectors: [[f64; COORDINATES_MAX]; DIRECTIONS_MAX],
    pub count: usize,
}

/// Escape directions from the shape at the end of plan `z`. Empty if there is no reference or the budget is
/// spent.
///
/// The eigenvalue computation is the only work longer than a quantum: 3 µs for three sections, 7 µs for six
/// (measured, AVX-512 machine).
pub(super) fn directions(
    problem: &TrackingProblem,
    z: &[f64],
    budget: &mut Budget<'_>,
) -> Directions {
    let none = Directions {
        vectors: [[0.0; COORDINATES_MAX]; DIRECTIONS_MAX],
        count: 0,
    };
    let last = problem.steps() - 1;
    let Some(target) = problem.target(last) else {
        return none;
    };
    let mut bends: Bent = problem.motion.start();
    for step in 0..=last {
        problem.motion.advance_one(&mut bends, z, step);
    }
    let mut shape = problem.motion.shape(&bends);
    let mut hessian = [[0.0; COORDINATES_MAX]; COORDINATES_MAX];
    let weights = problem.weights(last);
    if !differentiate(problem, target, &weights, &mut shape, &mut hessian, budget)
        || !budget.begin_quantum()
    {
        return none;
    }
    let spectrum = match problem.motion.width() {
        2 => spectrum!(2, hessian),
        4 => spectrum!(4, hessian),
        6 => spectrum!(6, hessian),
        8 => spectrum!(8, hessian),
        10 => spectrum!(10, hessian),
        _ => spectrum!(12, hessian),
    };
    spectrum.map_or(none, |spectrum| negative_eigenvectors(&spectrum, none))
}

/// The full Hessian, by central differences of the gradient Σ rᵢ ∂rᵢ. It includes the second derivatives that
/// Gauss-Newton neglects. False: the budget was spent.
fn differentiate(
    problem: &TrackingProblem,
    target: &ReferenceSample,
    weights: &PoseWeights,
    shape: &mut Configuration,
    hessian: &mut [[f64; COORDINATES_MAX]; COORDINATES_MAX],
    budget: &mut Budget<'_>,
) -> bool {
    let mut jacobian = Jacobian::default();
    let mut gradient = |shape: &Configuration| {
        let mut sum = [0.0; COORDINATES_MAX];
        let tip = problem.robot.tip_jacobian(shape, &mut jacobian);
        pose_error::residuals(
            problem.robot,
            &tip,
            &jacobian,
            target,
            weights,
            &mut |row: ResidualRow| {
                for (sum, derivative) in sum.iter_mut().zip(row.derivatives) {
                    *sum += row.residual * derivative;
                }
            },
        );
        sum
    };
    for i in 0..problem.motion.width() {
        if !budget.spend(COLUMN_NS * problem.robot.section_count() as u32) {
            return false;
        }
        let at = shape.as_slice()[i];
        shape.as_mut_slice()[i] = at + DIFFERENCE_RAD;
        let ahead = gradient(shape);
        shape.as_mut_slice()[i] = at - DIFFERENCE_RAD;
        let behind = gradient(shape);
        shape.as_mut_slice()[i] = at;
        for k in 0..ahead.len() {
            hessian[i][k] = (ahead[k] - behind[k]) / (2.0 * DIFFERENCE_RAD);
        }
    }
    true
}

/// The first `order` eigenvalues, each with its eigenvector.
struct Spectrum {
    order: usize,
    values: [f64; COORDINATES_MAX],
    vectors: [[f64; COORDINATES_MAX]; COORDINATES_MAX],
}

/// Eigenvectors of negative eigenvalues, most negative first.
fn negative_eigenvectors(spectrum: &Spectrum, mut found: Directions) -> Directions {
    let values = &spectrum.values[..spectrum.order];
    let largest = values
        .iter()
        .fold(0.0_f64, |most, value| value.abs().max(most));
    let mut order: [usize; COORDINATES_MAX] = core::array::from_fn(|i| i);
    let order = &mut order[..values.len()];
    order.sort_unstable_by(|&a, &b| values[a].total_cmp(&values[b]).then(a.cmp(&b)));
    let negative = order
        .iter()
        .filter(|&&i| values[i] < -NEGATIVE_SHARE * largest);
    for (target, &i) in found.vectors.iter_mut().zip(negative) {
        *target = spectrum.vectors[i];
        found.count += 1;
    }
    found
}
