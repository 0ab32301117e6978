//! W numbers that are computed with side by side: one particle of a swarm in each lane.
//!
//! Nothing here names a processor. Plain arrays and loops over them, inlined into a function that was
//! compiled for AVX-512 or AVX2, become vector instructions there; see
//! [`Path`](crate::optimizer::Path). Products and sums stay separate operations (no fused
//! multiply-add), so every lane holds **the same bits on every path**, and `Wide<1>` is the scalar
//! reference.

use std::ops::{Add, Mul, Sub};

/// W double-precision numbers, lane by lane.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(transparent)]
pub struct Wide<const W: usize>(pub [f64; W]);

/// Lanes of the fast path: one AVX-512 register, two of AVX2.
pub const LANES: usize = 8;

impl<const W: usize> Wide<W> {
    /// The same number in every lane.
    #[inline(always)]
    pub fn splat(value: f64) -> Self {
        Self([value; W])
    }

    /// Lane by lane from its index.
    #[inline(always)]
    pub fn from_fn(mut lane: impl FnMut(usize) -> f64) -> Self {
        // A plain loop: `array::from_fn` is not inlined into a function with other instructions.
        let mut lanes = [0.0; W];
        for i in 0..W {
            lanes[i] = lane(i);
        }
        Self(lanes)
    }

    /// Each lane kept within `low` and `high`.
    #[inline(always)]
    #[must_use]
    pub fn clamp(mut self, low: f64, high: f64) -> Self {
        for i in 0..W {
            let above = if self.0[i] < low { low } else { self.0[i] };
            self.0[i] = if above > high { high } else { above };
        }
        self
    }

    /// The lane of `self` where `chosen`, that of `other` elsewhere.
    #[inline(always)]
    #[must_use]
    pub fn select(self, other: Self, chosen: [bool; W]) -> Self {
        Self::from_fn(|lane| {
            if chosen[lane] {
                self.0[lane]
            } else {
                other.0[lane]
            }
        })
    }

    /// Whether each lane is less than that of `other`; never with a NaN.
    #[inline(always)]
    pub fn less(self, other: Self) -> [bool; W] {
        let mut less = [false; W];
        for i in 0..W {
            less[i] = self.0[i] < other.0[i];
        }
        less
    }
}

impl<const W: usize> Add for Wide<W> {
    type Output = Self;
    #[inline(always)]
    fn add(mut self, other: Self) -> Self {
        for i in 0..W {
            self.0[i] += other.0[i];
        }
        self
    }
}

impl<const W: usize> Sub for Wide<W> {
    type Output = Self;
    #[inline(always)]
    fn sub(mut self, other: Self) -> Self {
        for i in 0..W {
            self.0[i] -= other.0[i];
        }
        self
    }
}

impl<const W: usize> Mul for Wide<W> {
    type Output = Self;
    #[inline(always)]
    fn mul(mut self, other: Self) -> Self {
        for i in 0..W {
            self.0[i] *= other.0[i];
        }
        self
    }
}

impl<const W: usize> Mul<f64> for Wide<W> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, factor: f64) -> Self {
        self * Self::splat(factor)
    }
}

impl<const W: usize> Add<f64> for Wide<W> {
    type Output = Self;
    #[inline(always)]
    fn add(self, term: f64) -> Self {
        self + Self::splat(term)
    }
}
