//! One section: an arc of constant curvature as a function of its bend vector (§1 of docs/model.md).
//!
//! Everything is derived from five functions of w = θ². All are entire, so the straight section is not a singularity. Two
//! of them suffice, `h = (θ - sin θ)/θ³` and `k = (1/2 - g)/w`, because
//! ```text
//! f = 1 - w h     g = 1/2 - w k     f' = (h - g)/2     g' = k - h/2         (' = d/dw)
//! ```
//! None of these four differences cancels near w = 0. The textbook forms (cos θ - f)/(2w) and (f - 2g)/(2w) have ten
//! digits left at θ = 1e-3 and none at 1e-8.

use nalgebra::{Matrix3, Vector3};

use crate::wide::Wide;

/// Largest w of the power series; the closed form serves above it. It lies just above π², so that a robot (θ ≤ π) stays
/// within the series: no trigonometry, no division, no root. At this limit the alternating terms of `w h` sum to 2.7
/// times its value, which costs 1.5 bits. At θ = 2π the series would cost five bits; the closed form divides by w > 10
/// and loses nothing.
const SERIES_W_MAX: f64 = 10.0;

/// Terms of the series; the first omitted one is below 2e-20 at [`SERIES_W_MAX`].
const SERIES_TERMS: usize = 14;

/// Coefficients of h = Σ (-w)^k / (2k+3)!.
const H_SERIES: [f64; SERIES_TERMS] = alternating_inverse_factorials(3);
/// Coefficients of k = Σ (-w)^k / (2k+4)!.
const K_SERIES: [f64; SERIES_TERMS] = alternating_inverse_factorials(4);

/// (-1)^k / (2k + first)!, evaluated by the compiler.
const fn alternating_inverse_factorials(first: usize) -> [f64; SERIES_TERMS] {
    let mut coefficients = [0.0; SERIES_TERMS];
    let (mut number, mut factorial, mut sign) = (1, 1.0, 1.0);
    let mut k = 0;
    while k < SERIES_TERMS {
        while number < 2 * k + first {
            number += 1;
            factorial *= number as f64;
        }
        coefficients[k] = sign / factorial;
        sign = -sign;
        k += 1;
    }
    coefficients
}

/// Horner's rule.
#[inline(always)]
fn polynomial(coefficients: &[f64; SERIES_TERMS], w: f64) -> f64 {
    coefficients
        .iter()
        .rev()
        .fold(0.0, |sum, coefficient| sum * w + coefficient)
}

/// (h, k) at w. All five coefficients follow from them.
#[inline]
fn h_and_k(w: f64) -> (f64, f64) {
    if w <= SERIES_W_MAX {
        (polynomial(&H_SERIES, w), polynomial(&K_SERIES, w))
    } else {
        h_and_k_closed(w)
    }
}

/// (h, k) far from straight, where the closed form does not cancel.
#[cold]
fn h_and_k_closed(w: f64) -> (f64, f64) {
    let theta = w.sqrt();
    let half_sine = (0.5 * theta).sin();
    let g = 2.0 * half_sine * half_sine / w;
    ((1.0 - theta.sin() / theta) / w, (0.5 - g) / w)
}

/// (f, g) at w: the coefficients of a position.
#[inline]
pub(super) fn position_coefficients(w: f64) -> (f64, f64) {
    let (h, k) = h_and_k(w);
    (1.0 - w * h, 0.5 - w * k)
}

/// (f, g) from the series alone, without a branch, and whether the series is valid at w. Where it is, the result is
/// bit-identical to [`position_coefficients`].
#[inline(always)]
pub(super) fn series_position_coefficients(w: f64) -> (f64, f64, bool) {
    let (h, k) = (polynomial(&H_SERIES, w), polynomial(&K_SERIES, w));
    (1.0 - w * h, 0.5 - w * k, w <= SERIES_W_MAX)
}

/// (f, g) at w by the series alone, for the lanes of a swarm: no branch, no trigonometry.
///
/// Even and odd terms are summed separately by Horner's rule in w². This gives four dependency chains of half the
/// length, which the processor executes in parallel.
#[inline(always)]
pub(super) fn series_coefficients(w: f64) -> (f64, f64) {
    let (h, k) = series(w);
    (1.0 - w * h, 0.5 - w * k)
}

/// (h, k) at w by the same series.
#[inline(always)]
fn series(w: f64) -> (f64, f64) {
    let w2 = w * w;
    let last = SERIES_TERMS - 2;
    let (mut h_even, mut h_odd) = (H_SERIES[last], H_SERIES[last + 1]);
    let (mut k_even, mut k_odd) = (K_SERIES[last], K_SERIES[last + 1]);
    for pair in (0..last / 2).rev() {
        h_even = h_even * w2 + H_SERIES[2 * pair];
        h_odd = h_odd * w2 + H_SERIES[2 * pair + 1];
        k_even = k_even * w2 + K_SERIES[2 * pair];
        k_odd = k_odd * w2 + K_SERIES[2 * pair + 1];
    }
    (h_even + w * h_odd, k_even + w * k_odd)
}

/// Terms of [`ShortSeries`].
const SHORT_TERMS: usize = 7;
/// Largest distance in w from the centre of a [`ShortSeries`]. Up to here its truncation error is below 1e-17:
/// 0.2⁷/15!.
const SHORT_REACH: f64 = 0.2;
/// Coefficients of f, then of g.
const F_SERIES: [f64; SERIES_TERMS] = alternating_inverse_factorials(1);
const G_SERIES: [f64; SERIES_TERMS] = alternating_inverse_factorials(2);

/// f and g near one w, as polynomials with half as many terms. They suffice because a bend changes little over a
/// horizon.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ShortSeries {
    centre: f64,
    f: [f64; SHORT_TERMS],
    g: [f64; SHORT_TERMS],
}

impl ShortSeries {
    /// Series for bends within `change_rad` of (u, v); `None` if that range is too large.
    pub(super) fn around([u, v]: [f64; 2], change_rad: f64) -> Option<Self> {
        let centre = u * u + v * v;
        let reach = change_rad * (2.0 * centre.sqrt() + change_rad);
        (reach <= SHORT_REACH && centre <= SERIES_W_MAX).then(|| Self {
            centre,
            f: expanded(F_SERIES, centre),
            g: expanded(G_SERIES, centre),
        })
    }

    /// (f, g) at w.
    #[inline(always)]
    pub(super) fn evaluate(&self, w: f64) -> (f64, f64) {
        let d = w - self.centre;
        let d2 = d * d;
        let sum = |c: &[f64; SHORT_TERMS]| {
            let even = ((c[6] * d2 + c[4]) * d2 + c[2]) * d2 + c[0];
            even + ((c[5] * d2 + c[3]) * d2 + c[1]) * d
        };
        (sum(&self.f), sum(&self.g))
    }
}

/// The first coefficients of the polynomial expanded about `centre`, by repeated division.
fn expanded(mut of: [f64; SERIES_TERMS], centre: f64) -> [f64; SHORT_TERMS] {
    for first in 0..SHORT_TERMS {
        for k in (first..SERIES_TERMS - 1).rev() {
            of[k] += centre * of[k + 1];
        }
    }
    core::array::from_fn(|k| of[k])
}

/// (h, k) at W values of w side by side.
#[inline(always)]
pub(super) fn series_wide<const W: usize>(w: Wide<W>) -> (Wide<W>, Wide<W>) {
    let (mut h, mut k) = ([0.0; W], [0.0; W]);
    for lane in 0..W {
        (h[lane], k[lane]) = series(w.0[lane]);
    }
    (Wide(h), Wide(k))
}

/// (f, g) at W values of w side by side.
#[inline(always)]
pub(super) fn series_coefficients_wide<const W: usize>(w: Wide<W>) -> (Wide<W>, Wide<W>) {
    let (mut f, mut g) = ([0.0; W], [0.0; W]);
    for lane in 0..W {
        (f[lane], g[lane]) = series_coefficients(w.0[lane]);
    }
    (Wide(f), Wide(g))
}

/// W directions (cos φ, sin φ), each turned by `turn_rad`, up to 2π. The series give cos δ = 1 - δ² g and sin δ = δ f
/// without trigonometry.
#[inline(always)]
pub(crate) fn rotate_wide<const W: usize>(
    [cos, sin]: [Wide<W>; 2],
    turn_rad: Wide<W>,
) -> [Wide<W>; 2] {
    let w = turn_rad * turn_rad;
    let (f, g) = series_coefficients_wide(w);
    let (turn_cos, turn_sin) = (Wide::splat(1.0) - w * g, turn_rad * f);
    [
        cos * turn_cos - sin * turn_sin,
        sin * turn_cos + cos * turn_sin,
    ]
}

/// The five functions of w = θ² that describe an arc, dimensionless.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Coefficients {
    /// f = sin θ / θ; 1 at straight.
    pub f: f64,
    /// g = (1 - cos θ) / θ²; 1/2 at straight.
    pub g: f64,
    /// h = (1 - f) / w; 1/6 at straight.
    pub h: f64,
    /// f' = df/dw = (cos θ - f) / (2w); -1/6 at straight.
    pub f_slope: f64,
    /// g' = dg/dw = (f - 2g) / (2w); -1/24 at straight.
    pub g_slope: f64,
}

impl Coefficients {
    /// At w = u² + v² (rad²), any w ≥ 0.
    ///
    /// Largest absolute error for θ ≤ 2π, measured against 60 digits at 30 000 points: f 3.4e-16, g 1.1e-16, h 2.8e-17,
    /// f' 5.2e-17, g' 1.4e-17. These are a few units in the last place of each function's largest value, with the same
    /// accuracy close to straight. The relative error is larger near the zeros of f, g, f' and g' (at θ = π, 2π, 4.49,
    /// 2π).
    #[inline]
    pub fn from_square(w: f64) -> Self {
        let (h, k) = h_and_k(w);
        let g = 0.5 - w * k;
        Self {
            f: 1.0 - w * h,
            g,
            h,
            f_slope: 0.5 * (h - g),
            g_slope: k - 0.5 * h,
        }
    }
}

/// One bent section in the frame of its own base: x and y across, z along the straight section.
///
/// Construction costs two polynomials; each method a few multiplications. Any finite bend is valid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arc {
    length_m: f64,
    bend_rad: [f64; 2],
    coefficients: Coefficients,
}

impl Arc {
    /// A section of `length_m` (m) bent by (u, v) (rad).
    #[inline]
    pub fn new(length_m: f64, bend_rad: [f64; 2]) -> Self {
        let [u, v] = bend_rad;
        Self {
            length_m,
            bend_rad,
            coefficients: Coefficients::from_square(u * u + v * v),
        }
    }

    /// End of the arc (m): p = l (u g, v g, f).
    #[inline]
    pub fn position_m(&self) -> Vector3<f64> {
        let [u, v] = self.bend_rad;
        let Coefficients { f, g, .. } = self.coefficients;
        Vector3::new(u * g, v * g, f) * self.length_m
    }

    /// Rotation from the frame at the arc's end to the one at its base: R = Rz(φ) Ry(θ) Rz(-φ). The last factor keeps
    /// the cables at constant angles around the backbone.
    #[inline]
    pub fn rotation(&self) -> Matrix3<f64> {
        let [u, v] = self.bend_rad;
        let Coefficients { f, g, .. } = self.coefficients;
        let (uug, vvg, uvg) = (u * u * g, v * v * g, u * v * g);
        Matrix3::new(
            1.0 - uug,
            -uvg,
            u * f,
            -uvg,
            1.0 - vvg,
            v * f,
            -u * f,
            -v * f,
            1.0 - (uug + vvg),
        )
    }

    /// ∂p/∂u and ∂p/∂v (m/rad).
    #[inline]
    pub fn position_derivatives_m_rad(&self) -> [Vector3<f64>; 2] {
        let [u, v] = self.bend_rad;
        let Coefficients {
            f_slope,
            g,
            g_slope,
            ..
        } = self.coefficients;
        let cross = 2.0 * u * v * g_slope;
        [
            Vector3::new(g + 2.0 * u * u * g_slope, cross, 2.0 * u * f_slope) * self.length_m,
            Vector3::new(cross, g + 2.0 * v * v * g_slope, 2.0 * v * f_slope) * self.length_m,
        ]
    }

    /// Rotational velocity of the arc's end for u̇ = 1 and for v̇ = 1, in the frame of its base (rad/rad): the columns of
    /// [I + g K + h K²] (-v̇, u̇, 0)ᵀ with K = skew(-v, u, 0), so that Ṙ = skew(ω) R.
    #[inline]
    pub fn rotation_derivatives(&self) -> [Vector3<f64>; 2] {
        let [u, v] = self.bend_rad;
        let Coefficients { g, h, .. } = self.coefficients;
        let uvh = u * v * h;
        [
            Vector3::new(-uvh, 1.0 - v * v * h, -v * g),
            Vector3::new(u * u * h - 1.0, uvh, u * g),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows [w, f, g, h, f', g'], computed with 60 digits (Python mpmath) from the textbook forms and then rounded.
    #[rustfmt::skip]
    #[expect(clippy::unreadable_literal, reason = "a table of 17 digits is compared by machine")]
    const EXACT: [[f64; 6]; 19] = [
        [0.0, 1.0, 0.5, 0.16666666666666666, -0.16666666666666666, -0.041666666666666664],
        [1e-300, 1.0, 0.5, 0.16666666666666666, -0.16666666666666666, -0.041666666666666664],
        [1e-16, 1.0, 0.5, 0.16666666666666666, -0.16666666666666666, -0.041666666666666664],
        [1e-06, 0.9999998333333416, 0.4999999583333347, 0.16666665833333352, -0.16666665000000058, -0.04166666388888896],
        [0.01, 0.9983341664682815, 0.4995834721974234, 0.1665833531718477, -0.16650005951278785, -0.04163889632826289],
        [0.25, 0.958851077208406, 0.48966975243850913, 0.16459569116637598, -0.16253703063606656, -0.04097685533722454],
        [1.0, 0.8414709848078965, 0.4596976941318603, 0.1585290151921035, -0.1505843394698784, -0.03896220172791203],
        [2.25, 0.6649966577360363, 0.4130056881476876, 0.14889037433953942, -0.1320576569040741, -0.03578104856874198],
        [4.0, 0.45464871341284085, 0.3540367091367856, 0.1363378216467898, -0.1088494437449979, -0.03167808810759129],
        [6.25, 0.2393888576415826, 0.2881829784875094, 0.12169778277734679, -0.0832425978550813, -0.026958167946674896],
        [9.0, 0.04704000268662241, 0.2211102774000495, 0.10588444414593084, -0.05761291662705933, -0.021954475117415367],
        [9.75, 0.006114491713813593, 0.20510950991988075, 0.10193697520883963, -0.05158626735552056, -0.020723309134663997],
        [10.0, -0.0065407069689386406, 0.1999786072879326, 0.10065407069689386, -0.04966226829551936, -0.020324896077240192],
        [10.000001, -0.006540756631203092, 0.19997858696303733, 0.10065406559771375, -0.04966226068266178, -0.02032489449537444],
        [12.0, -0.09149476499657433, 0.1623702663201523, 0.09095789708304786, -0.035706184618552225, -0.01734313740153662],
        [20.0, -0.2171843183512395, 0.06189741959902956, 0.06085921591756197, -0.0005191018407337898, -0.008524478938732465],
        [30.0, -0.13172645569509123, 0.010252696280208405, 0.037724215189836374, 0.013735759454813985, -0.002537197470925134],
        [39.0, -0.006113377174773817, 1.869350445914755e-05, 0.025797778901917277, 0.012889542698729065, -7.885595107297579e-05],
        [39.47, -0.00010662724827463664, 5.684685675059878e-09, 0.025338399474240554, 0.01266919689477744, -1.350881905827043e-06],
    ];

    #[test]
    fn coefficients_have_full_precision_from_straight_to_a_full_circle() {
        for [w, f, g, h, f_slope, g_slope] in EXACT {
            let found = Coefficients::from_square(w);
            assert!((found.f - f).abs() < 4e-16, "f at {w}");
            assert!((found.g - g).abs() < 2e-16, "g at {w}");
            assert!((found.h - h).abs() < 6e-17, "h at {w}");
            assert!((found.f_slope - f_slope).abs() < 9e-17, "f' at {w}");
            assert!((found.g_slope - g_slope).abs() < 3e-17, "g' at {w}");
        }
    }

    #[test]
    fn series_and_closed_form_meet_at_the_switch() {
        let (h_series, k_series) = h_and_k(SERIES_W_MAX);
        let (h_closed, k_closed) = h_and_k_closed(SERIES_W_MAX);
        assert!((h_series - h_closed).abs() < 6e-17 && (k_series - k_closed).abs() < 3e-17);
    }

    #[test]
    fn short_series_are_exact_within_their_range() {
        for (bend_rad, change_rad) in [(0.0, 0.4), (0.3, 0.2), (1.57, 0.06), (3.1, 0.03)] {
            let short = ShortSeries::around([0.6 * bend_rad, -0.8 * bend_rad], change_rad).unwrap();
            for share in [-1.0, -0.5, 0.0, 0.3, 1.0] {
                let w = (bend_rad + share * change_rad).powi(2);
                let ((f, g), exact) = (short.evaluate(w), Coefficients::from_square(w));
                assert!((f - exact.f).abs() < 5e-16, "f at {w}: {f} {}", exact.f);
                assert!((g - exact.g).abs() < 3e-16, "g at {w}: {g} {}", exact.g);
            }
        }
        assert!(ShortSeries::around([1.57, 0.0], 0.07).is_none());
        assert!(ShortSeries::around([f64::NAN, 0.0], 0.01).is_none());
    }

    #[test]
    fn no_robot_leaves_the_series() {
        let bend_max_rad = crate::robot::ranges::BEND_MAX_RAD;
        assert!(bend_max_rad.end() * bend_max_rad.end() < SERIES_W_MAX);
    }

    #[test]
    fn the_slopes_are_the_derivatives() {
        for k in 0..390 {
            // Fourth-order central differences.
            let (w, step) = (0.1 + f64::from(k) * 0.1, 0.02);
            let at = |i: f64| Coefficients::from_square(w + i * step);
            let slope = |of: fn(Coefficients) -> f64| {
                (8.0 * (of(at(1.0)) - of(at(-1.0))) - (of(at(2.0)) - of(at(-2.0)))) / (12.0 * step)
            };
            assert!(
                (slope(|c| c.f) - at(0.0).f_slope).abs() < 1e-12,
                "f' at {w}"
            );
            assert!(
                (slope(|c| c.g) - at(0.0).g_slope).abs() < 1e-12,
                "g' at {w}"
            );
        }
    }

    #[test]
    fn the_arc_is_rz_ry_rz_of_the_papers_angles() {
        use nalgebra::{Rotation3, Vector3};
        let about =
            |axis: Vector3<f64>, angle: f64| Rotation3::from_scaled_axis(axis * angle).into_inner();
        for theta in [-1.3, 1e-9, 0.2, 1.3, 2.8, 5.0] {
            for phi in [-2.5_f64, 0.0, 0.7, 1.6] {
                let (sin, cos) = phi.sin_cos();
                let expected = about(Vector3::z(), phi)
                    * about(Vector3::y(), theta)
                    * about(Vector3::z(), -phi);
                let arc = Arc::new(0.3, [theta * cos, theta * sin]);
                assert!((arc.rotation() - expected).amax() < 2e-15, "{theta} {phi}");
                let across = 2.0 * (0.5 * theta).sin().powi(2);
                let end_m = Vector3::new(across * cos, across * sin, theta.sin()) * (0.3 / theta);
                assert!((arc.position_m() - end_m).norm() < 4e-16, "{theta} {phi}");
            }
        }
    }
}
