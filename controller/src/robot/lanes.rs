//! Vectors and frames of W configurations side by side; W = 1 is a single one.

use std::ops::{Add, Mul, Sub};

use nalgebra::Vector3;

use super::Pose;
use super::section::series_coefficients_wide;
use crate::wide::Wide;

/// W vectors of three components. The operations and their order are those of `nalgebra`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct WideVector<const W: usize>(pub(super) [Wide<W>; 3]);

impl<const W: usize> WideVector<W> {
    /// The same vector in every lane.
    #[inline(always)]
    pub(super) fn splat(vector: &Vector3<f64>) -> Self {
        Self([
            Wide::splat(vector.x),
            Wide::splat(vector.y),
            Wide::splat(vector.z),
        ])
    }

    #[inline(always)]
    pub(super) fn dot(&self, other: &Self) -> Wide<W> {
        let ([a, b, c], [x, y, z]) = (self.0, other.0);
        a * x + b * y + c * z
    }

    #[inline(always)]
    pub(super) fn norm_squared(&self) -> Wide<W> {
        self.dot(self)
    }
}

impl WideVector<1> {
    /// The only lane.
    pub(super) fn narrow(&self) -> Vector3<f64> {
        let [Wide([x]), Wide([y]), Wide([z])] = self.0;
        Vector3::new(x, y, z)
    }
}

impl<const W: usize> Add for WideVector<W> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        let ([a, b, c], [x, y, z]) = (self.0, other.0);
        Self([a + x, b + y, c + z])
    }
}

impl<const W: usize> Sub for WideVector<W> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        let ([a, b, c], [x, y, z]) = (self.0, other.0);
        Self([a - x, b - y, c - z])
    }
}

impl<const W: usize> Mul<Wide<W>> for WideVector<W> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, factor: Wide<W>) -> Self {
        let [x, y, z] = self.0;
        Self([x * factor, y * factor, z * factor])
    }
}

/// W frames of a robot: the poses of W configurations side by side.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frame<const W: usize> {
    /// Origin in the base frame (m).
    pub(super) position_m: WideVector<W>,
    /// Unit vectors along x, y and z in the base frame.
    pub(super) axes: [WideVector<W>; 3],
}

impl<const W: usize> Frame<W> {
    /// The base frame.
    #[inline(always)]
    pub(super) fn base() -> Self {
        let (zero, one) = (Wide::splat(0.0), Wide::splat(1.0));
        Self {
            position_m: WideVector([zero; 3]),
            axes: [
                WideVector([one, zero, zero]),
                WideVector([zero, one, zero]),
                WideVector([zero, zero, one]),
            ],
        }
    }

    /// The frame at the end of a section that starts here, bent by (u, v) (rad). With s = u x + v y and q = g s + f z,
    /// the origin moves by ℓ q. The axes become x - u q, y - v q and f s + (1 - w g) z.
    #[inline(always)]
    pub(super) fn then(&self, length_m: f64, [u, v]: [Wide<W>; 2]) -> Self {
        let w = u * u + v * v;
        let (f, g) = series_coefficients_wide(w);
        let [x, y, z] = self.axes;
        let sideways = x * u + y * v;
        let chord = sideways * g + z * f;
        Self {
            position_m: self.position_m + chord * Wide::splat(length_m),
            axes: [
                x - chord * u,
                y - chord * v,
                sideways * f + z * (Wide::splat(1.0) - w * g),
            ],
        }
    }
}

impl From<&Pose> for Frame<1> {
    fn from(pose: &Pose) -> Self {
        let [x, y, z] = [0, 1, 2].map(|axis| Vector3::from(pose.rotation.column(axis)));
        Self {
            position_m: WideVector::splat(&pose.position_m),
            axes: [
                WideVector::splat(&x),
                WideVector::splat(&y),
                WideVector::splat(&z),
            ],
        }
    }
}
