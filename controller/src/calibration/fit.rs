//! Weighted least squares by Levenberg-Marquardt. Each row is whitened by its own noise, because cable noise moves a
//! tip more the farther it is from the bending sections.

use nalgebra::{Matrix6, SMatrix, SVector};

use super::geometry::{Geometry, PARAMETERS_MAX};
use super::noise::Noise;
use super::prediction::{CalibrationRow, Prediction, Twist, residual_of};
use crate::robot::Robot;

pub(super) type Square = SMatrix<f64, PARAMETERS_MAX, PARAMETERS_MAX>;
pub(super) type Column = SVector<f64, PARAMETERS_MAX>;

/// Until outliers are excluded, a whitened residual counts linearly beyond this norm (standard deviations).
const HUBER: f64 = 3.0;
/// Maximum number of steps of one fit.
const STEPS_MAX: usize = 60;
/// The fit has converged when every parameter changes by less than this share of its plausible error.
const STEP_MIN: f64 = 1e-8;

/// Selection of the estimated parameters, and options of the fit.
pub(super) struct Estimated<'a> {
    /// Indices of the parameters.
    pub(super) active: &'a [usize],
    /// Plausible error of each parameter.
    pub(super) scale: &'a [f64; PARAMETERS_MAX],
    /// Adds a prior at the configured geometry with the plausible errors, so that undetermined parameters keep their
    /// values.
    pub(super) prior: bool,
    /// True if large residuals count linearly.
    pub(super) robust: bool,
}

/// The rows of a fit, whitened at a geometry.
struct Whitened<'a> {
    rows: Vec<(&'a CalibrationRow, Matrix6<f64>)>,
    robust: bool,
}

impl Whitened<'_> {
    /// Total cost of the residuals; infinite if the geometry is not a valid robot.
    fn cost(&self, geometry: &Geometry) -> f64 {
        let Ok(robot) = geometry.checked() else {
            return f64::INFINITY;
        };
        let costs = self.rows.iter().map(|(row, white)| {
            let norm = (white * residual_of(&robot, geometry, row)).norm();
            if self.robust && norm > HUBER {
                HUBER * (2.0 * norm - HUBER)
            } else {
                norm * norm
            }
        });
        costs.sum()
    }

    /// JᵀJ and Jᵀe of the whitened rows.
    fn normal(&self, robot: &Robot, geometry: &Geometry, active: &[usize]) -> (Square, Column) {
        let (mut square, mut column) = (Square::zeros(), Column::zeros());
        let mut whitened = [Twist::zeros(); PARAMETERS_MAX];
        for (row, white) in &self.rows {
            let prediction = Prediction::new(robot, geometry, row);
            let residual = white * prediction.residual(row);
            let norm = residual.norm();
            let weight = if self.robust && norm > HUBER {
                HUBER / norm
            } else {
                1.0
            };
            for (at, &index) in active.iter().enumerate() {
                whitened[index] = white * prediction.by_parameter[index];
                column[index] += weight * whitened[index].dot(&residual);
                for &other in &active[..=at] {
                    square[(index, other)] += weight * whitened[index].dot(&whitened[other]);
                }
            }
        }
        for (at, &index) in active.iter().enumerate() {
            for &other in &active[..at] {
                square[(other, index)] = square[(index, other)];
            }
        }
        (square, column)
    }
}

fn whitened<'a>(
    geometry: &Geometry,
    robot: &Robot,
    rows: &[&'a CalibrationRow],
    noise: &Noise,
    robust: bool,
) -> Whitened<'a> {
    let rows = rows.iter().map(|row| {
        let prediction = Prediction::new(robot, geometry, row);
        (*row, noise.whitening(&prediction, row))
    });
    Whitened {
        rows: rows.collect(),
        robust,
    }
}

/// The geometry that fits the rows best, starting from `begin`; `None` if no geometry near it is a valid robot.
pub(super) fn fit(
    configured: &Geometry,
    begin: &Geometry,
    rows: &[&CalibrationRow],
    noise: &Noise,
    estimated: &Estimated<'_>,
) -> Option<Geometry> {
    let Estimated {
        active,
        scale,
        prior,
        robust,
    } = *estimated;
    let mut geometry = begin.clone();
    let white = whitened(&geometry, &geometry.checked().ok()?, rows, noise, robust);
    let offset = |geometry: &Geometry, index: usize| {
        let parameter = super::Parameter::from_index(index);
        (geometry.value(parameter) - configured.value(parameter)) / scale[index]
    };
    let cost = |geometry: &Geometry| {
        let near: f64 = active.iter().map(|&i| offset(geometry, i).powi(2)).sum();
        white.cost(geometry) + if prior { near } else { 0.0 }
    };
    let mut here = cost(&geometry);
    let mut damping = 1e-3;
    for _ in 0..STEPS_MAX {
        let (mut square, mut column) = white.normal(&geometry.checked().ok()?, &geometry, active);
        if prior {
            for &index in active {
                square[(index, index)] += scale[index].powi(-2);
                column[index] -= offset(&geometry, index) / scale[index];
            }
        }
        let step = loop {
            let step = solved(&square, &column, active, scale, damping)?;
            let moved = geometry.moved(&step);
            let there = cost(&moved);
            if there <= here {
                (geometry, here) = (moved, there);
                damping = (0.1 * damping).max(1e-12);
                break Some(step);
            }
            damping *= 10.0;
            if damping > 1e6 {
                break None;
            }
        };
        let is_small = |step: [f64; PARAMETERS_MAX]| {
            let mut parts = active.iter().map(|&i| (step[i] / scale[i]).abs());
            parts.all(|part| part < STEP_MIN)
        };
        if step.is_none_or(is_small) {
            break;
        }
    }
    Some(geometry)
}

/// One damped step.
fn solved(
    square: &Square,
    column: &Column,
    active: &[usize],
    scale: &[f64; PARAMETERS_MAX],
    damping: f64,
) -> Option<[f64; PARAMETERS_MAX]> {
    let (mut scaled, right) = (
        scaled(square, active, scale),
        Column::from_fn(|i, _| {
            if active.contains(&i) {
                column[i] * scale[i]
            } else {
                0.0
            }
        }),
    );
    for &index in active {
        // A parameter without effect keeps its value.
        scaled[(index, index)] += damping * scaled[(index, index)] + 1e-9;
    }
    let step = scaled.cholesky()?.solve(&right);
    Some(core::array::from_fn(|i| step[i] * scale[i]))
}

/// The matrix in units of the plausible errors, with ones on the diagonal for parameters that are not estimated.
pub(super) fn scaled(square: &Square, active: &[usize], scale: &[f64; PARAMETERS_MAX]) -> Square {
    let mut scaled = Square::identity();
    for &i in active {
        for &j in active {
            scaled[(i, j)] = square[(i, j)] * scale[i] * scale[j];
        }
    }
    scaled
}

/// JᵀJ of the whitened rows at a geometry: the inverse of the covariance of the estimates.
pub(super) fn information(
    geometry: &Geometry,
    rows: &[&CalibrationRow],
    noise: &Noise,
    active: &[usize],
) -> Option<Square> {
    let robot = geometry.checked().ok()?;
    let white = whitened(geometry, &robot, rows, noise, false);
    Some(white.normal(&robot, geometry, active).0)
}

/// The whitened residual of each row.
pub(super) fn residuals(
    geometry: &Geometry,
    rows: &[&CalibrationRow],
    noise: &Noise,
) -> Option<Vec<Twist>> {
    let robot = geometry.checked().ok()?;
    let white = whitened(geometry, &robot, rows, noise, false);
    let residual =
        |(row, white): &(&CalibrationRow, Matrix6<f64>)| white * residual_of(&robot, geometry, row);
    Some(white.rows.iter().map(residual).collect())
}
