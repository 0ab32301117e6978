//! Interpolation between two points: Hermite curves for positions, shortest arcs for orientations.

use nalgebra::{Unit, Vector3};

use super::Orientation;

/// A position with its time in seconds from a nearby origin, so that differences stay exact.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Knot {
    pub(super) time_s: f64,
    pub(super) position_m: Vector3<f64>,
}

/// Below this angle between two axes, or between one and the opposite of the other, rounding dominates the normal of
/// their plane \[rad\].
const PARALLEL: f64 = 1e-9;

/// Number of points of a tangent.
pub(super) const STENCIL: usize = 5;

/// A knot is used for a tangent if its distance from the previous knot on the same side is at least this share of the
/// longest distance so far. At even spacing all knots are used, up to four steps away (a share of 1/3).
const APART_SHARE: f64 = 0.3;

/// Tangent at `knots[at]`: derivative of the polynomial through those of `knots` (2 to [`STENCIL`], by time) that are
/// [`apart`], by the barycentric formula (Berrut & Trefethen 2004, eq. 9.4). Fourth order for five knots.
pub(super) fn tangent(knots: &[Knot], at: usize) -> Vector3<f64> {
    let here = knots[at];
    let are_separated = are_separated(knots, at);
    let others =
        |but: usize| (0..knots.len()).filter(move |&k| are_separated[k] && k != at && k != but);
    let mut sum = Vector3::zeros();
    for j in others(at) {
        let knot = knots[j];
        let mut ratio = 1.0;
        for k in others(j) {
            let other = knots[k];
            ratio *= (here.time_s - other.time_s) / (knot.time_s - other.time_s);
        }
        sum += (knot.position_m - here.position_m) * (ratio / (knot.time_s - here.time_s));
    }
    sum
}

/// Selects the knots that are far enough apart for a tangent at `knots[at]`. The longer of the two adjacent segments
/// always counts. Noise of the points is therefore amplified at most eightfold, however close some of them are.
fn are_separated(knots: &[Knot], at: usize) -> [bool; STENCIL] {
    let far_s = |k: usize| (knots[k].time_s - knots[at].time_s).abs();
    let last = knots.len() - 1;
    let longest_s = far_s(at.saturating_sub(1)).max(far_s(last.min(at + 1)));
    let mut are_separated = [false; STENCIL];
    let mut thin = |outwards: &mut dyn Iterator<Item = usize>| {
        let mut kept_s = 0.0;
        for k in outwards {
            are_separated[k] = far_s(k) - kept_s >= APART_SHARE * longest_s.max(kept_s);
            if are_separated[k] {
                kept_s = far_s(k);
            }
        }
    };
    thin(&mut (0..at).rev());
    thin(&mut (at + 1..knots.len()));
    are_separated
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

/// Orientation at the share `part` between two; if their kinds differ, the nearer one.
pub(super) fn orientation(from: Orientation, to: Orientation, part: f64) -> Orientation {
    match (from, to) {
        (Orientation::Full(from), Orientation::Full(to)) => {
            Orientation::Full(from.try_slerp(&to, part, 1e-12).unwrap_or(to))
        }
        (Orientation::Axis(from), Orientation::Axis(to)) => Orientation::Axis(axis(from, to, part)),
        (Orientation::Preferred(from), Orientation::Preferred(to)) => {
            Orientation::Preferred(axis(from, to, part))
        }
        _ if part < 0.5 => from,
        _ => to,
    }
}

/// Interpolates on the great circle between two axes. Between opposite axes no circle is the shortest; the circle then
/// depends only on the first axis.
fn axis(from: Unit<Vector3<f64>>, to: Unit<Vector3<f64>>, part: f64) -> Unit<Vector3<f64>> {
    let (normal, cos) = (from.cross(&to), from.dot(&to));
    let sin = normal.norm();
    let normal = if sin > PARALLEL {
        normal / sin
    } else if cos > 0.0 {
        return to;
    } else {
        let across = Vector3::ith(from.iamin(), 1.0);
        from.cross(&across).normalize()
    };
    let (turned_sin, turned_cos) = (part * sin.atan2(cos)).sin_cos();
    Unit::new_normalize(*from * turned_cos + normal.cross(&from) * turned_sin)
}
