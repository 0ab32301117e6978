//! Between two points: Hermite curves for positions, shortest arcs for orientations.

use nalgebra::{Unit, Vector3};

use super::Orientation;

/// A position with its time in seconds from an origin near by, so that differences stay exact.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Knot {
    pub(super) time_s: f64,
    pub(super) position_m: Vector3<f64>,
}

/// Points that a tangent is made from.
pub(super) const STENCIL: usize = 5;

/// Tangent at `knots[at]`: derivative of the polynomial through all `knots` (2 to [`STENCIL`]), by the
/// barycentric formula (Berrut & Trefethen 2004, eq. 9.4). Fourth order for five knots.
pub(super) fn tangent(knots: &[Knot], at: usize) -> Vector3<f64> {
    let here = knots[at];
    let mut sum = Vector3::zeros();
    for (j, knot) in knots.iter().enumerate().filter(|(j, _)| *j != at) {
        let mut ratio = 1.0;
        for (k, other) in knots.iter().enumerate() {
            if k != j && k != at {
                ratio *= (here.time_s - other.time_s) / (knot.time_s - other.time_s);
            }
        }
        sum += (knot.position_m - here.position_m) * (ratio / (knot.time_s - here.time_s));
    }
    sum
}

/// Cubic Hermite curve (de Boor, *A Practical Guide to Splines*, ch. IV), `part` ∈ \[0, 1\].
pub(super) fn hermite(
    from: Knot,
    to: Knot,
    tangent_from: Vector3<f64>,
    tangent_to: Vector3<f64>,
    part: f64,
) -> Vector3<f64> {
    let span = to.time_s - from.time_s;
    let rest = 1.0 - part;
    from.position_m * (rest * rest * (1.0 + 2.0 * part))
        + to.position_m * (part * part * (3.0 - 2.0 * part))
        + (tangent_from * (rest * rest * part) - tangent_to * (part * part * rest)) * span
}

/// The orientation `part` of the way between two; where the kinds differ, the nearer one counts.
pub(super) fn orientation(from: Orientation, to: Orientation, part: f64) -> Orientation {
    match (from, to) {
        (Orientation::Full(from), Orientation::Full(to)) => {
            Orientation::Full(from.try_slerp(&to, part, 1e-12).unwrap_or(to))
        }
        (Orientation::Axis(from), Orientation::Axis(to)) => Orientation::Axis(axis(from, to, part)),
        _ if part < 0.5 => from,
        _ => to,
    }
}

fn axis(from: Unit<Vector3<f64>>, to: Unit<Vector3<f64>>, part: f64) -> Unit<Vector3<f64>> {
    from.try_slerp(&to, part, 1e-12).unwrap_or(to)
}
