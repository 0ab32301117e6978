//! W numbers processed at once, for example one particle of a swarm in each lane.
//!
//! Nothing here depends on a processor. Loops over plain arrays become vector instructions when they are
//! inlined into a function compiled for AVX-512 or AVX2; see [`Simd`](crate::optimizer::Simd). Products and
//! sums stay separate operations (no fused multiply-add). So every lane holds **the same bits on every
//! path**, and `Wide<1>` is the scalar reference.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// W double-precision numbers, lane by lane.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(transparent)]
pub(crate) struct Wide<const W: usize>(pub(crate) [f64; W]);

/// W numbers in memory, aligned so that a register loads eight without crossing a cache line.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(crate) struct Aligned<const W: usize>(pub(crate) Wide<W>);

/// Lanes of the vector path: one AVX-512 register, or two AVX2 registers.
pub(crate) const LANES: usize = 8;

/// An expression for each lane. In `dev` the loop is unrolled by hand: LLVM then compiles a swarm in half the
/// time, but the code is slower, so a release has the loop.
#[cfg(not(debug_assertions))]
macro_rules! lanes {
    ($count:ident, |$lane:ident| $each:expr) => {
        for $lane in 0..$count {
            $each;
        }
    };
}

#[cfg(debug_assertions)]
macro_rules! lanes {
    ($count:ident, |$lane:ident| $each:expr) => {
        const { assert!($count <= LANES) };
        lanes!($count, |$lane| $each, 0 1 2 3 4 5 6 7);
    };
    ($count:ident, |$lane:ident| $each:expr, $($index:literal)+) => {
        $(if $count > $index {
            let $lane = $index;
            $each;
        })+
    };
}

impl<const W: usize> Wide<W> {
    /// The same number in every lane.
    #[inline(always)]
    pub(crate) fn splat(value: f64) -> Self {
        Self([value; W])
    }

    /// Each lane computed from its index.
    #[inline(always)]
    pub(crate) fn from_fn(mut lane: impl FnMut(usize) -> f64) -> Self {
        // A plain loop: `array::from_fn` is not inlined into a function compiled for other instructions.
        let mut lanes = [0.0; W];
        lanes!(W, |i| lanes[i] = lane(i));
        Self(lanes)
    }

    /// Each lane clamped to `low` and `high`.
    #[inline(always)]
    #[must_use]
    pub(crate) fn clamp(mut self, low: f64, high: f64) -> Self {
        lanes!(W, |i| {
            let above = if self.0[i] < low { low } else { self.0[i] };
            self.0[i] = if above > high { high } else { above };
        });
        self
    }

    /// The lane of `self` where `chosen` is true, that of `other` elsewhere.
    #[inline(always)]
    #[must_use]
    pub(crate) fn select(self, other: Self, chosen: [bool; W]) -> Self {
        Self::from_fn(|lane| {
            if chosen[lane] {
                self.0[lane]
            } else {
                other.0[lane]
            }
        })
    }

    /// All bits set in each lane that is less than that of `other`, no bit in the others; for
    /// [`Self::masked`].
    #[inline(always)]
    pub(crate) fn less_mask(self, other: Self) -> [u64; W] {
        let mut mask = [0; W];
        lanes!(W, |i| mask[i] =
            if self.0[i] < other.0[i] { u64::MAX } else { 0 });
        mask
    }

    /// The lane of `self` where the mask is set, that of `other` elsewhere. In a loop over memory this
    /// compiles to one instruction.
    #[inline(always)]
    #[must_use]
    pub(crate) fn masked(mut self, other: Self, mask: [u64; W]) -> Self {
        lanes!(W, |i| self.0[i] = f64::from_bits(
            (self.0[i].to_bits() & mask[i]) | (other.0[i].to_bits() & !mask[i])
        ));
        self
    }

    /// Index of the first minimum among the first `count` lanes; NaN is ignored.
    #[inline(always)]
    pub(crate) fn first_least(self, count: usize) -> usize {
        let mut own = [f64::INFINITY; W];
        lanes!(W, |i| if i < count && self.0[i] < own[i] {
            own[i] = self.0[i];
        });
        let (mut least, mut width) = (own, W);
        while width > 1 {
            width /= 2;
            for i in 0..width {
                let other = least[i + width];
                least[i] = if other < least[i] { other } else { least[i] };
            }
        }
        let mut first = 0;
        lanes!(W, |i| if own[W - 1 - i] == least[0] {
            first = W - 1 - i;
        });
        first
    }

    /// Square root of each lane, rounded as in IEEE 754.
    #[inline(always)]
    #[must_use]
    pub(crate) fn sqrt(mut self) -> Self {
        lanes!(W, |i| self.0[i] = self.0[i].sqrt());
        self
    }

    /// Absolute value of each lane.
    #[inline(always)]
    #[must_use]
    pub(crate) fn abs(mut self) -> Self {
        lanes!(W, |i| self.0[i] = self.0[i].abs());
        self
    }

    /// The smaller of two numbers in each lane; NaN if either is NaN.
    #[inline(always)]
    #[must_use]
    pub(crate) fn min_or_nan(self, other: Self) -> Self {
        other.select(self, either(other.less(self), other.is_nan()))
    }

    /// The smaller of two numbers in each lane; a NaN in `self` is ignored.
    #[inline(always)]
    #[must_use]
    pub(crate) fn min(mut self, other: Self) -> Self {
        lanes!(W, |i| {
            let (own, other) = (self.0[i], other.0[i]);
            self.0[i] = if own < other { own } else { other };
        });
        self
    }

    /// The larger of two numbers in each lane; a NaN in `other` is ignored, one in `self` stays.
    #[inline(always)]
    #[must_use]
    pub(crate) fn max(self, other: Self) -> Self {
        other.select(self, self.less(other))
    }

    /// Whether each lane is less than that of `other`; false with a NaN.
    #[inline(always)]
    pub(crate) fn less(self, other: Self) -> [bool; W] {
        let mut less = [false; W];
        lanes!(W, |i| less[i] = self.0[i] < other.0[i]);
        less
    }

    /// Whether each lane is at most that of `other`; false with a NaN.
    #[inline(always)]
    pub(crate) fn less_or_equal(self, other: Self) -> [bool; W] {
        let mut less = [false; W];
        lanes!(W, |i| less[i] = self.0[i] <= other.0[i]);
        less
    }

    /// Whether each lane is NaN.
    #[inline(always)]
    pub(crate) fn is_nan(self) -> [bool; W] {
        let mut nan = [false; W];
        lanes!(W, |i| nan[i] = self.0[i].is_nan());
        nan
    }
}

/// Logical and in each lane.
#[inline(always)]
#[must_use]
pub(crate) fn both<const W: usize>(mut a: [bool; W], b: [bool; W]) -> [bool; W] {
    lanes!(W, |i| a[i] &= b[i]);
    a
}

/// Logical or in each lane.
#[inline(always)]
#[must_use]
pub(crate) fn either<const W: usize>(mut a: [bool; W], b: [bool; W]) -> [bool; W] {
    lanes!(W, |i| a[i] |= b[i]);
    a
}

/// Logical not in each lane.
#[inline(always)]
#[must_use]
pub(crate) fn not<const W: usize>(mut a: [bool; W]) -> [bool; W] {
    lanes!(W, |i| a[i] = !a[i]);
    a
}

/// Whether any bit is set.
#[inline(always)]
pub(crate) fn any_set<const W: usize>(mask: [u64; W]) -> bool {
    let mut set = 0;
    lanes!(W, |i| set |= mask[i]);
    set != 0
}

/// Whether any lane is true.
#[inline(always)]
pub(crate) fn any<const W: usize>(chosen: [bool; W]) -> bool {
    let mut any = false;
    lanes!(W, |i| any |= chosen[i]);
    any
}

/// Whether every lane is true.
#[inline(always)]
pub(crate) fn all<const W: usize>(chosen: [bool; W]) -> bool {
    let mut all = true;
    lanes!(W, |i| all &= chosen[i]);
    all
}

impl<const W: usize> Add for Wide<W> {
    type Output = Self;
    #[inline(always)]
    fn add(mut self, other: Self) -> Self {
        lanes!(W, |i| self.0[i] += other.0[i]);
        self
    }
}

impl<const W: usize> Sub for Wide<W> {
    type Output = Self;
    #[inline(always)]
    fn sub(mut self, other: Self) -> Self {
        lanes!(W, |i| self.0[i] -= other.0[i]);
        self
    }
}

impl<const W: usize> Mul for Wide<W> {
    type Output = Self;
    #[inline(always)]
    fn mul(mut self, other: Self) -> Self {
        lanes!(W, |i| self.0[i] *= other.0[i]);
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

impl<const W: usize> Sub<f64> for Wide<W> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, term: f64) -> Self {
        self - Self::splat(term)
    }
}

impl<const W: usize> Div for Wide<W> {
    type Output = Self;
    #[inline(always)]
    fn div(mut self, other: Self) -> Self {
        lanes!(W, |i| self.0[i] /= other.0[i]);
        self
    }
}

impl<const W: usize> Neg for Wide<W> {
    type Output = Self;
    #[inline(always)]
    fn neg(mut self) -> Self {
        lanes!(W, |i| self.0[i] = -self.0[i]);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOW: f64 = -1.0;
    const HIGH: f64 = 2.5;

    #[test]
    fn operators_work_lane_by_lane_as_on_numbers() {
        let (a, b) = (Wide([4.0, -1.5, 0.0]), Wide([0.5, 3.0, 2.0]));
        assert_eq!(a + b, Wide([4.5, 1.5, 2.0]));
        assert_eq!(a - b, Wide([3.5, -4.5, -2.0]));
        assert_eq!(a * b, Wide([2.0, -4.5, 0.0]));
        assert_eq!(a / b, Wide([8.0, -0.5, 0.0]));
        assert_eq!(a + 1.0, Wide([5.0, -0.5, 1.0]));
        assert_eq!(a - 1.0, Wide([3.0, -2.5, -1.0]));
        assert_eq!(-b, Wide([-0.5, -3.0, -2.0]));
        assert_eq!((-a).0[2].to_bits(), (-0.0_f64).to_bits());
        assert_eq!(a.abs().sqrt(), Wide([2.0, 1.5_f64.sqrt(), 0.0]));
        assert_eq!(a.clamp(LOW, HIGH), Wide([HIGH, LOW, 0.0]));
    }

    #[test]
    fn a_nan_is_dropped_kept_or_spread_as_documented() {
        let nan = f64::NAN;
        let (a, b) = (Wide([LOW, HIGH, nan, LOW]), Wide([HIGH, LOW, LOW, nan]));
        let bits = |wide: Wide<4>| wide.0.map(f64::to_bits);
        assert_eq!(bits(a.max(b)), bits(Wide([HIGH, HIGH, nan, LOW])));
        assert_eq!(bits(a.min_or_nan(b)), bits(Wide([LOW, LOW, nan, nan])));
        assert_eq!(a.less(b), [true, false, false, false]);
        assert_eq!(a.less_or_equal(a), [true, true, false, true]);
        assert_eq!(a.is_nan(), [false, false, true, false]);
        let (one, two) = (Wide::splat(1.0), Wide::splat(2.0));
        assert_eq!(one.masked(two, a.less_mask(b)), Wide([1.0, 2.0, 2.0, 2.0]));
        assert!(a.clamp(LOW, HIGH).0[2].is_nan());
    }

    #[test]
    fn masks_combine_lane_by_lane() {
        let (a, b) = ([true, true, false, false], [true, false, true, false]);
        assert_eq!(both(a, b), [true, false, false, false]);
        assert_eq!(either(a, b), [true, true, true, false]);
        assert_eq!(not(a), [false, false, true, true]);
        assert!(any(a) && !any([false; 4]));
        assert!(all([true; 4]) && !all(a));
    }
}
