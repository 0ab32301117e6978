//! Error of a tip against the reference: position, and orientation beyond a tolerance.

use nalgebra::{Matrix3, Vector3};

use crate::reference::{Orientation, ReferenceSample};
use crate::robot::{COORDINATES_MAX, Jacobian, Pose, Robot, TipSeries};
use crate::wide::Wide;

/// Weights of the error of one step.
#[derive(Debug, Clone, Copy)]
pub(super) struct PoseWeights {
    /// Weight of the squared distance, per m².
    pub position: f64,
    /// Weight of the squared orientation error, per rad².
    pub orientation: f64,
    /// Orientation error without cost \[rad\].
    pub tolerance_rad: f64,
}

/// An angle between the tip axis and a preferred one costs as much as the distance that a lever of this share of the reach,
/// turned by it, makes: 10 mm of 0.9 m. The weight is at most that of a required axis, without its tolerance. So it decides
/// between shapes that reach the position, and hardly moves the tip.
pub const PREFERRED_LEVER_SHARE: f64 = 1.0 / 90.0;

impl PoseWeights {
    /// The weights with a preferred axis in place of a required one. A separate function: inlined into the swarm's
    /// evaluation it costs a tenth of the time of every other problem.
    #[inline(never)]
    fn of_preference(&self, robot: &Robot) -> Self {
        let lever_m = PREFERRED_LEVER_SHARE * robot.reach_m();
        let preference = lever_m * lever_m * self.position;
        Self {
            orientation: preference.min(self.orientation),
            tolerance_rad: 0.0,
            ..*self
        }
    }
}

/// The weighted squared error of W tips.
///
/// The orientation error is the chord 2 sin(α/2), where α is the angle between the axes, or of the rotation
/// between the frames. It is |t - a| for an axis, and |R - S| / √2 (Frobenius norm, S the reference) for a
/// rotation. Unlike an angle it has no singularity, and its differences keep all digits near zero.
#[inline(always)]
pub(super) fn squared_error<const W: usize>(
    robot: &Robot,
    bend_rad: impl Fn(usize) -> Wide<W>,
    tip_series: Option<&TipSeries>,
    target: &ReferenceSample,
    weights: &PoseWeights,
) -> Wide<W> {
    match target.orientation {
        Orientation::Axis(axis) | Orientation::Preferred(axis) if weights.orientation > 0.0 => {
            let weights = match target.orientation {
                Orientation::Preferred(_) => &weights.of_preference(robot),
                _ => weights,
            };
            let (tip, [z]) = robot.tip_frame_wide::<W, 1>(bend_rad);
            let chord = distance_squared(&z, &axis);
            distance_squared(&tip, &target.position_m) * weights.position
                + beyond_squared(chord, weights.tolerance_rad) * weights.orientation
        }
        Orientation::Full(rotation) if weights.orientation > 0.0 => {
            let (tip, [z, x]) = robot.tip_frame_wide::<W, 2>(bend_rad);
            let wanted = rotation.to_rotation_matrix().into_inner();
            let column = |i| Vector3::from(wanted.column(i));
            let chord = distance_squared(&x, &column(0))
                + distance_squared(&cross(&z, &x), &column(1))
                + distance_squared(&z, &column(2));
            distance_squared(&tip, &target.position_m) * weights.position
                + beyond_squared(chord * 0.5, weights.tolerance_rad) * weights.orientation
        }
        _ => {
            let tip = match tip_series {
                Some(tip_series) => robot.tip_position_by_series(tip_series, bend_rad),
                None => robot.tip_position_wide(bend_rad),
            };
            distance_squared(&tip, &target.position_m) * weights.position
        }
    }
}

#[inline(always)]
pub(super) fn distance_squared<const W: usize>(from: &[Wide<W>; 3], to: &Vector3<f64>) -> Wide<W> {
    let (x, y, z) = (from[0] + -to.x, from[1] + -to.y, from[2] + -to.z);
    x * x + y * y + z * z
}

#[inline(always)]
fn cross<const W: usize>(a: &[Wide<W>; 3], b: &[Wide<W>; 3]) -> [Wide<W>; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// The square of the excess over the tolerance of a length, given the square of the length.
#[inline(always)]
fn beyond_squared<const W: usize>(squared: Wide<W>, tolerance: f64) -> Wide<W> {
    if tolerance == 0.0 {
        return squared;
    }
    let beyond = squared.sqrt() + -tolerance;
    let zero = Wide::splat(0.0);
    // A comparison with NaN is false, so a NaN stays NaN.
    zero.select(beyond * beyond, beyond.less(zero))
}

/// A residual and its derivatives with respect to the bend vectors.
pub(super) struct ResidualRow {
    pub residual: f64,
    pub derivatives: [f64; COORDINATES_MAX],
}

/// Residuals, whose squared sum is the weighted squared error, and their derivatives.
pub(super) fn residuals(
    robot: &Robot,
    tip: &Pose,
    jacobian: &Jacobian,
    target: &ReferenceSample,
    weights: &PoseWeights,
    mut push: impl FnMut(ResidualRow),
) {
    let scale = weights.position.sqrt();
    let error = tip.position_m - target.position_m;
    for axis in 0..3 {
        let mut derivatives = [0.0; COORDINATES_MAX];
        for (derivative, column) in derivatives.iter_mut().zip(jacobian.columns()) {
            *derivative = scale * column[axis];
        }
        push(ResidualRow {
            residual: scale * error[axis],
            derivatives,
        });
    }
    if weights.orientation > 0.0 {
        match target.orientation {
            Orientation::Free => {}
            Orientation::Axis(axis) | Orientation::Preferred(axis) => {
                let weights = match target.orientation {
                    Orientation::Preferred(_) => &weights.of_preference(robot),
                    _ => weights,
                };
                let axes = [(tip.rotation.column(2).into(), axis.into_inner())];
                chord_residuals(&axes, 1.0, jacobian, weights, push);
            }
            Orientation::Full(rotation) => {
                let wanted: Matrix3<f64> = rotation.to_rotation_matrix().into_inner();
                let axes =
                    [0, 1, 2].map(|i| (tip.rotation.column(i).into(), wanted.column(i).into()));
                chord_residuals(&axes, 0.5_f64.sqrt(), jacobian, weights, push);
            }
        }
    }
}

/// Three residuals for each pair of an axis and its reference. With chord ρ = |e| and tolerance τ they are r
/// = (1 - τ/ρ) e, and dr = (1 - τ/ρ) de + (τ/ρ³) e (e·de). None within the tolerance.
fn chord_residuals(
    axes: &[(Vector3<f64>, Vector3<f64>)],
    factor: f64,
    jacobian: &Jacobian,
    weights: &PoseWeights,
    mut push: impl FnMut(ResidualRow),
) {
    let errors = || axes.iter().map(|(is, wanted)| (is - wanted) * factor);
    let chord = errors()
        .map(|error| error.norm_squared())
        .sum::<f64>()
        .sqrt();
    let tolerance = weights.tolerance_rad;
    if chord <= tolerance {
        return;
    }
    let share = if tolerance > 0.0 {
        tolerance / chord
    } else {
        0.0
    };
    let along = if tolerance > 0.0 {
        share / (chord * chord)
    } else {
        0.0
    };
    let scale = weights.orientation.sqrt();
    // e·de for each coordinate, proportional to the rate of change of the chord.
    let mut towards = [0.0; COORDINATES_MAX];
    for (i, column) in jacobian.columns().iter().enumerate() {
        let spin = Vector3::new(column[3], column[4], column[5]);
        let turned = axes.iter().map(|(is, _)| spin.cross(is) * factor);
        towards[i] = errors()
            .zip(turned)
            .map(|(error, turn)| error.dot(&turn))
            .sum();
    }
    for ((is, _), error) in axes.iter().zip(errors()) {
        for row in 0..3 {
            let mut derivatives = [0.0; COORDINATES_MAX];
            for (i, column) in jacobian.columns().iter().enumerate() {
                let spin = Vector3::new(column[3], column[4], column[5]);
                let turn = spin.cross(is)[row] * factor;
                derivatives[i] = scale * ((1.0 - share) * turn + along * error[row] * towards[i]);
            }
            push(ResidualRow {
                residual: scale * (1.0 - share) * error[row],
                derivatives,
            });
        }
    }
}
