//! Calibration of the geometry from measured cables and tips: section lengths, cable radii, angles and zeros, and the
//! poses of base and sensor.
//!
//! A row holds the measurements of one time. The cables determine the bends, given the geometry. The geometry is the
//! one that places the tip where it was measured (weighted non-linear least squares). Cable noise is part of the
//! weights: at 12.5 mm from the backbone, 30 µm move the tip of a robot of one metre by more than a millimetre.
//!
//! Parameters that the rows do not determine keep their configured value and are listed: [`Calibration::held`]. So are those
//! that depend on the errors of such parameters. For example, no row distinguishes a turn of the base about z from the
//! same turn of all cables.
//!
//! Invariant: nothing here knows a file, a unit other than SI, or a robot's mode.

mod error;
mod fit;
mod geometry;
mod held;
mod noise;
mod play;
mod prediction;

use nalgebra::Vector3;

pub use error::CalibrationError;
use fit::{Estimated, Square, fit, information, residuals};
pub use geometry::{Geometry, PARAMETERS_MAX, Parameter, ParameterGroup};
pub use held::{Held, HeldReason};
use held::{covariance, hold_uncertain, hold_undetermined, uncertain};
pub use noise::{DEVIATION_OF_MEDIAN, Noise, median};
pub use play::behind_play;
pub use prediction::CalibrationRow;
use prediction::{Twist, residual_of};

use crate::robot::RobotParameters;

/// Minimum number of rows.
pub const ROWS_MIN: usize = 100;
/// Number of parts into which the rows are divided; every fifth is held out of the fit.
const PARTS: usize = 25;
/// Minimum motion: some cable must change by at least this times its distance from the backbone.
const MOTION_MIN_RAD: f64 = 0.05;
/// Maximum number of rounds of fit and noise estimation.
const ROUNDS_MAX: usize = 8;
/// Half-width of the 95 % interval of a normal distribution, in standard deviations.
const SHARE_95: f64 = 1.96;

/// Estimate of one parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// The parameter that was estimated.
    pub parameter: Parameter,
    /// Configured value (m or rad).
    pub old: f64,
    /// Estimated value.
    pub value: f64,
    /// Half-width of the 95 % confidence interval around `value`. Parameters that the rows do not determine count as
    /// far as the rows leave them uncertain, at most with their plausible errors; the turn of the base about z and the distance of the sensor along the tip do not.
    pub within: f64,
}

/// Difference between measured tips and those predicted from the cables.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TipError {
    /// Number of rows.
    pub rows: usize,
    /// Root mean square of the distance (m).
    pub rms_m: f64,
    /// Root mean square of each coordinate (m).
    pub axis_rms_m: [f64; 3],
    /// Largest distance (m).
    pub max_m: f64,
    /// Root mean square of the angle (rad); 0 if no rotation was measured.
    pub rms_rad: f64,
}

/// Result of a calibration.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// Estimated geometry; held parameters are as configured.
    pub geometry: Geometry,
    /// Estimated parameters, except the zeros of cables: those are in `cable_zeros`.
    pub estimates: Vec<Estimate>,
    /// Zero of each cable, measured minus true length, relative to the mean of its section's three (m), with its 95 %
    /// bound. That mean has no effect on the bend.
    pub cable_zeros: Vec<[(f64, f64); 3]>,
    /// Parameters that were not estimated.
    pub held: Vec<Held>,
    /// Standard deviations of the measurements.
    pub noise: Noise,
    /// Rows of the fit that noise does not explain; they were excluded.
    pub outliers: usize,
    /// The same of the held-out rows, by the spread of their own residuals: a wrong geometry widens it, and makes no outliers.
    pub outliers_held_out: usize,
    /// Factor by which correlation between the residuals of successive rows widens the bounds: 1 if the model is right.
    pub correlation: f64,
    /// Errors of the configured robot: in the fit, and held out, both without outliers.
    pub before: [TipError; 2],
    /// Errors of the estimated geometry, in the same rows.
    pub after: [TipError; 2],
    /// Agreement of three cables on the backbone length: rms deviation of their mean from its average, for each section
    /// (m).
    pub cable_rms_m: Vec<f64>,
}

/// Estimates the geometry that explains the rows, given in the order of measurement. Groups in `hold` are not
/// estimated. The lengths are those of the cables; where motors with play were measured, [`behind_play`] computes them.
///
/// A fifth of the rows, in five parts, is held out and used for validation only. 12 000 rows of three sections take
/// some seconds.
///
/// # Errors
/// [`CalibrationError`], if the rows or the configured robot are not suitable.
pub fn calibrate(
    robot: &RobotParameters,
    rows: &[CalibrationRow],
    hold: &[ParameterGroup],
) -> Result<Calibration, CalibrationError> {
    let configured = Geometry::configured(robot);
    configured.checked()?;
    check(robot, rows)?;
    let (held_out, fitted): (Vec<_>, Vec<_>) = rows
        .iter()
        .enumerate()
        .partition(|(at, _)| at * PARTS / rows.len() % 5 == 2);
    let without_index = |rows: Vec<(usize, _)>| rows.into_iter().map(|(_, row)| row).collect();
    let (held_out, fitted): (Vec<_>, Vec<_>) = (without_index(held_out), without_index(fitted));
    let mut search = GeometrySearch::new(&configured, rows, hold);

    // The prior keeps undetermined parameters at their configured values until they are identified.
    search.fit(&configured, &fitted, true, true)?;
    // Identified with base and sensor as configured. A sensor on the tip's axis compensates for length and radius of
    // the last section, and slightly less so after noise has moved it.
    let at_configured_poses = Geometry {
        base: configured.base,
        sensor: configured.sensor,
        ..search.geometry.clone()
    };
    let square = information(&at_configured_poses, &fitted, &search.noise, &search.active)
        .ok_or(CalibrationError::NoRobot)?;
    search.hold_undetermined(&square)?;
    loop {
        search.reset_held(&configured);
        search.fit(&configured, &fitted, false, true)?;
        let kept = search.without_outliers(&fitted, &search.noise)?;
        search.fit(&configured, &kept, false, false)?;
        // Again at the geometry that was found, with its wider bounds: there, the rows may determine less.
        let square = search.information(&kept)?;
        if search.hold_undetermined(&square)? || search.hold_uncertain(&square)? {
            continue;
        }
        let spread = search.noise.with_tip_noise(&search.geometry, &held_out);
        let held_out_kept = search.without_outliers(&held_out, &spread)?;
        let outliers = [
            fitted.len() - kept.len(),
            held_out.len() - held_out_kept.len(),
        ];
        return search.result(&configured, &kept, &held_out_kept, outliers, &square);
    }
}

/// Rejects rows from which nothing can be estimated.
fn check(robot: &RobotParameters, rows: &[CalibrationRow]) -> Result<(), CalibrationError> {
    if rows.len() < ROWS_MIN {
        return Err(CalibrationError::TooFewRows { rows: rows.len() });
    }
    let cables = 3 * robot.sections.len();
    for (at, row) in rows.iter().enumerate() {
        let numbers = row.cable_length_m[..cables].iter();
        let turned = row.tip_rotation.iter().flat_map(|turned| &turned.coords);
        if !numbers
            .chain(&row.tip_position_m)
            .chain(turned)
            .all(|number| number.is_finite())
        {
            return Err(CalibrationError::NotFinite { row: at + 1 });
        }
        if row.tip_rotation.is_some() != rows[0].tip_rotation.is_some() {
            return Err(CalibrationError::MixedRotations { row: at + 1 });
        }
    }
    let bend_rad = |cable: usize| {
        let lengths_m = || rows.iter().map(move |row| row.cable_length_m[cable]);
        let longest_m = lengths_m().fold(f64::NEG_INFINITY, f64::max);
        let shortest_m = lengths_m().fold(f64::INFINITY, f64::min);
        (longest_m - shortest_m) / robot.sections[cable / 3].cable_radius_m
    };
    let bend_rad = (0..cables).map(bend_rad).fold(0.0, f64::max);
    if bend_rad < MOTION_MIN_RAD {
        return Err(CalibrationError::NoMotion { bend_rad });
    }
    Ok(())
}

/// State of the fit.
struct GeometrySearch {
    geometry: Geometry,
    noise: Noise,
    scale: [f64; PARAMETERS_MAX],
    active: Vec<usize>,
    held: Vec<Held>,
    /// Of the last fit; 1 before.
    correlation: f64,
}

impl GeometrySearch {
    fn new(configured: &Geometry, rows: &[CalibrationRow], hold: &[ParameterGroup]) -> Self {
        let sections = configured.robot.sections.len();
        let is_turned = rows.iter().all(|row| row.tip_rotation.is_some());
        let all = (0..PARAMETERS_MAX)
            .map(Parameter::from_index)
            .filter(|p| match p {
                Parameter::Length(j)
                | Parameter::CableRadius(j)
                | Parameter::CableAngle(j)
                | Parameter::CableZero(j, _) => *j < sections,
                Parameter::SensorRotation(_) => is_turned,
                _ => true,
            });
        let (asked, active): (Vec<_>, Vec<_>) = all.partition(|p| hold.contains(&p.group()));
        let mut scale = [1.0; PARAMETERS_MAX];
        for parameter in asked.iter().chain(&active) {
            scale[parameter.index()] = parameter.plausible_error(&configured.robot);
        }
        let why = |parameter: &Parameter| Held {
            parameter: *parameter,
            why: HeldReason::Requested,
        };
        Self {
            geometry: configured.clone(),
            noise: Noise::of_cables(rows, sections),
            scale,
            active: active.iter().map(|parameter| parameter.index()).collect(),
            held: asked.iter().map(why).collect(),
            correlation: 1.0,
        }
    }

    /// Alternates between fit and noise estimation until neither changes.
    fn fit(
        &mut self,
        configured: &Geometry,
        rows: &[&CalibrationRow],
        prior: bool,
        robust: bool,
    ) -> Result<(), CalibrationError> {
        for _ in 0..ROUNDS_MAX {
            let estimated = Estimated {
                active: &self.active,
                scale: &self.scale,
                prior,
                robust,
            };
            self.geometry = fit(configured, &self.geometry, rows, &self.noise, &estimated)
                .ok_or(CalibrationError::NoRobot)?;
            let updated = self.noise.with_tip_noise(&self.geometry, rows);
            let before = core::mem::replace(&mut self.noise, updated);
            let change = self.noise.tip_m / before.tip_m + self.noise.tip_rad / before.tip_rad;
            if (change - 2.0).abs() < 0.01 {
                break;
            }
        }
        Ok(())
    }

    /// Holds what the rows do not determine. Returns whether that is more than before.
    fn hold_undetermined(&mut self, square: &Square) -> Result<bool, CalibrationError> {
        let before = self.held.len();
        hold_undetermined(square, &self.scale, &mut self.active, &mut self.held);
        self.more_than(before)
    }

    /// Holds what errors of the held parameters would change too much. Returns whether that is any.
    fn hold_uncertain(&mut self, square: &Square) -> Result<bool, CalibrationError> {
        let before = self.held.len();
        hold_uncertain(square, &self.scale, &mut self.active, &mut self.held)
            .ok_or(CalibrationError::NoRobot)?;
        self.more_than(before)
    }

    fn more_than(&self, before: usize) -> Result<bool, CalibrationError> {
        let held = self.held.len();
        if self.active.is_empty() {
            let correlation = self.correlation;
            return Err(CalibrationError::NothingLeft { held, correlation });
        }
        Ok(held > before)
    }

    /// Information of the rows about the estimated parameters and those held for lack of data, less as much as the
    /// residuals exceed the noise and are correlated.
    fn information(&mut self, kept: &[&CalibrationRow]) -> Result<Square, CalibrationError> {
        let no_robot = CalibrationError::NoRobot;
        let white = residuals(&self.geometry, kept, &self.noise).ok_or(no_robot.clone())?;
        let numbers = (freedom(kept) * kept.len()) as f64;
        let squares: f64 = white.iter().map(Twist::norm_squared).sum();
        let per_number = (squares / numbers).max(f64::MIN_POSITIVE);
        self.correlation = correlation(&white).sqrt();
        let all: Vec<_> = self
            .active
            .iter()
            .copied()
            .chain(uncertain(&self.held))
            .collect();
        let square = information(&self.geometry, kept, &self.noise, &all).ok_or(no_robot)?;
        Ok(square / (per_number * self.correlation.powi(2)))
    }

    /// Resets held parameters to their configured values.
    fn reset_held(&mut self, configured: &Geometry) {
        let mut kept = [0.0; PARAMETERS_MAX];
        for &index in &self.active {
            let parameter = Parameter::from_index(index);
            kept[index] = self.geometry.value(parameter) - configured.value(parameter);
        }
        self.geometry = configured.moved(&kept);
    }

    /// The rows that `noise` explains.
    fn without_outliers<'a>(
        &self,
        rows: &[&'a CalibrationRow],
        noise: &Noise,
    ) -> Result<Vec<&'a CalibrationRow>, CalibrationError> {
        let gate = (freedom(rows) as f64).sqrt() + 3.5;
        let residuals = residuals(&self.geometry, rows, noise).ok_or(CalibrationError::NoRobot)?;
        let rows = rows.iter().zip(&residuals);
        Ok(rows
            .filter(|(_, residual)| residual.norm() <= gate)
            .map(|(row, _)| *row)
            .collect())
    }

    fn result(
        self,
        configured: &Geometry,
        kept: &[&CalibrationRow],
        held_out: &[&CalibrationRow],
        [outliers, outliers_held_out]: [usize; 2],
        square: &Square,
    ) -> Result<Calibration, CalibrationError> {
        let no_robot = CalibrationError::NoRobot;
        let covariance =
            covariance(square, &self.scale, &self.active, &self.held).ok_or(no_robot.clone())?;
        let estimates = self.active.iter().map(|&index| {
            let parameter = Parameter::from_index(index);
            Estimate {
                parameter,
                old: configured.value(parameter),
                value: self.geometry.value(parameter),
                within: SHARE_95 * self.scale[index] * covariance[(index, index)].sqrt(),
            }
        });
        let estimates: Vec<_> = estimates
            .filter(|estimate| estimate.parameter.group() != ParameterGroup::Zeros)
            .collect();
        let error = |geometry: &Geometry, rows: &[&CalibrationRow]| {
            tip_error(geometry, rows).ok_or(no_robot.clone())
        };
        Ok(Calibration {
            cable_zeros: self.cable_zeros(&covariance),
            cable_rms_m: cable_rms_m(configured.robot.sections.len(), kept),
            estimates,
            outliers,
            outliers_held_out,
            correlation: self.correlation,
            before: [error(configured, kept)?, error(configured, held_out)?],
            after: [
                error(&self.geometry, kept)?,
                error(&self.geometry, held_out)?,
            ],
            noise: self.noise,
            held: self.held,
            geometry: self.geometry,
        })
    }

    /// Zeros of each cable.
    fn cable_zeros(&self, covariance: &Square) -> Vec<[(f64, f64); 3]> {
        let zeros = (0..self.geometry.robot.sections.len()).map(|j| {
            let beside_m = self.geometry.section_zeros_m(j);
            core::array::from_fn(|cable| {
                let index = |pattern| Parameter::CableZero(j, pattern).index();
                let mut variance = 0.0;
                for a in (0..2).filter(|a| self.active.contains(&index(*a))) {
                    for b in (0..2).filter(|b| self.active.contains(&index(*b))) {
                        variance += geometry::ZERO_PATTERNS[a][cable]
                            * geometry::ZERO_PATTERNS[b][cable]
                            * covariance[(index(a), index(b))]
                            * self.scale[index(a)]
                            * self.scale[index(b)];
                    }
                }
                (beside_m[cable], SHARE_95 * variance.sqrt())
            })
        });
        zeros.collect()
    }
}

/// Number of measured tip coordinates in each row.
fn freedom(rows: &[&CalibrationRow]) -> usize {
    let is_turned = rows.first().is_some_and(|row| row.tip_rotation.is_some());
    if is_turned { 6 } else { 3 }
}

/// Rms deviation of the mean of three cables from its average, for each section (m).
fn cable_rms_m(sections: usize, rows: &[&CalibrationRow]) -> Vec<f64> {
    let count = rows.len() as f64;
    let rms_m = |j: usize| {
        let mean_m =
            |row: &&CalibrationRow| row.cable_length_m[3 * j..3 * j + 3].iter().sum::<f64>() / 3.0;
        let average_m = rows.iter().map(mean_m).sum::<f64>() / count;
        let squares = rows.iter().map(|row| (mean_m(row) - average_m).powi(2));
        (squares.sum::<f64>() / count).sqrt()
    };
    (0..sections).map(rms_m).collect()
}

fn tip_error(geometry: &Geometry, rows: &[&CalibrationRow]) -> Option<TipError> {
    let robot = geometry.checked().ok()?;
    let mut error = TipError {
        rows: rows.len(),
        ..TipError::default()
    };
    let mut squares = Twist::zeros();
    for row in rows {
        let residual = residual_of(&robot, geometry, row);
        squares += residual.component_mul(&residual);
        error.max_m = error.max_m.max(residual.fixed_rows::<3>(0).norm());
    }
    squares /= rows.len().max(1) as f64;
    let position: Vector3<f64> = squares.fixed_rows::<3>(0).into_owned();
    error.rms_m = position.sum().sqrt();
    error.axis_rms_m = position.map(f64::sqrt).into();
    error.rms_rad = squares.fixed_rows::<3>(3).sum().sqrt();
    Some(error)
}

/// Factor by which correlation raises the variance of a sum of residuals: 1 + 2 Σ of their autocorrelations, up to the
/// first that is not significant.
fn correlation(residuals: &[Twist]) -> f64 {
    let own: f64 = residuals.iter().map(Twist::norm_squared).sum();
    if own == 0.0 {
        return 1.0;
    }
    let count = residuals.len();
    let chance = 2.0 / (count as f64).sqrt();
    let mut sum = 1.0;
    for apart in 1..count / 4 {
        let pairs = residuals.iter().zip(&residuals[apart..]);
        let part = pairs.map(|(a, b)| a.dot(b)).sum::<f64>() / own;
        if part < chance {
            break;
        }
        sum += 2.0 * part;
    }
    sum
}
