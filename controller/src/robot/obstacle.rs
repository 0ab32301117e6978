//! Obstacles of the body: spheres and capsules that may move at constant velocity.
//!
//! Invariant: an [`Obstacle`] made by [`Obstacle::new`] holds only finite numbers, so no distance to it overflows.

use core::ops::RangeInclusive;

use nalgebra::{Isometry3, Point3, Vector3};
use thiserror::Error;

use super::lanes::WideVector;
use crate::wide::Wide;

/// Allowed components of a position (m) and of a velocity (m/s). The limit of 1000 km excludes nonsense and keeps
/// squares and their products far from overflow.
pub const OBSTACLE_COMPONENT: RangeInclusive<f64> = -1e6..=1e6;
/// Allowed radius of an obstacle (m); 0 is a point or a line.
pub const OBSTACLE_RADIUS_M: RangeInclusive<f64> = 0.0..=1e6;

/// Axis of an obstacle in the base frame of the robot. The obstacle is every point within its radius of the axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// All points within a radius of a centre.
    Sphere {
        /// Centre (m), each component in [`OBSTACLE_COMPONENT`].
        centre_m: Vector3<f64>,
    },
    /// A cylinder with round ends: every point within the radius of a segment. If start and end coincide, it is a ball.
    Capsule {
        /// One end of the segment (m), each component in [`OBSTACLE_COMPONENT`].
        start_m: Vector3<f64>,
        /// The other end of the segment (m), each component in [`OBSTACLE_COMPONENT`].
        end_m: Vector3<f64>,
    },
}

impl Shape {
    /// The shape moved by `by_m` (m).
    #[inline(always)]
    fn translated(self, by_m: Vector3<f64>) -> Self {
        match self {
            Self::Sphere { centre_m } => Self::Sphere {
                centre_m: centre_m + by_m,
            },
            Self::Capsule { start_m, end_m } => Self::Capsule {
                start_m: start_m + by_m,
                end_m: end_m + by_m,
            },
        }
    }

    fn seen_in(self, frame: &Isometry3<f64>) -> Self {
        let there = |point_m: Vector3<f64>| (frame * Point3::from(point_m)).coords;
        match self {
            Self::Sphere { centre_m } => Self::Sphere {
                centre_m: there(centre_m),
            },
            Self::Capsule { start_m, end_m } => Self::Capsule {
                start_m: there(start_m),
                end_m: there(end_m),
            },
        }
    }

    /// Points of the axis with their keys; the centre of a sphere appears twice.
    fn points(&self) -> [(&'static str, Vector3<f64>); 2] {
        match *self {
            Self::Sphere { centre_m } => [("centre_m", centre_m); 2],
            Self::Capsule { start_m, end_m } => [("start_m", start_m), ("end_m", end_m)],
        }
    }

    fn axis(&self) -> Axis {
        match *self {
            Self::Sphere { centre_m } => Axis {
                start_m: centre_m,
                span_m: Vector3::zeros(),
                length_m: 0.0,
                per_square_1_m2: 0.0,
            },
            Self::Capsule { start_m, end_m } => {
                let span_m = end_m - start_m;
                let square_m2 = span_m.norm_squared();
                let is_point = square_m2 <= POINT_M2;
                Axis {
                    start_m,
                    span_m,
                    length_m: square_m2.sqrt(),
                    per_square_1_m2: if is_point { 0.0 } else { 1.0 / square_m2 },
                }
            }
        }
    }
}

/// A segment up to this squared length (m²) is taken as a point, because the inverse may overflow.
const POINT_M2: f64 = 1e-300;

/// A point or a segment, prepared for distances to W points side by side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Axis {
    pub(super) start_m: Vector3<f64>,
    pub(super) span_m: Vector3<f64>,
    pub(super) length_m: f64,
    /// One over the squared length (1/m²); 0 for a point.
    per_square_1_m2: f64,
}

impl Axis {
    #[inline(always)]
    pub(super) fn is_point(&self) -> bool {
        self.per_square_1_m2 == 0.0
    }

    /// The point start + t span (m, base frame).
    #[inline(always)]
    pub(super) fn point<const W: usize>(&self, t: Wide<W>) -> WideVector<W> {
        WideVector::splat(&self.start_m) + WideVector::splat(&self.span_m) * t
    }

    /// Share t ∈ [0, 1] of the segment's point nearest to `point_m`; 0 for an axis that is a point.
    #[inline(always)]
    pub(super) fn share<const W: usize>(&self, point_m: &WideVector<W>) -> Wide<W> {
        let after_start = *point_m - WideVector::splat(&self.start_m);
        let along = after_start.dot(&WideVector::splat(&self.span_m));
        (along * self.per_square_1_m2).clamp(0.0, 1.0)
    }

    /// Squared distance between the axis and a point (m²).
    #[inline(always)]
    pub(super) fn square_m2<const W: usize>(&self, point_m: &WideVector<W>) -> Wide<W> {
        let nearest_m = if self.is_point() {
            WideVector::splat(&self.start_m)
        } else {
            self.point(self.share(point_m))
        };
        (*point_m - nearest_m).norm_squared()
    }

    /// Rounding error of distances to this axis, caused by its coordinates (m): ten units in the last place.
    #[inline(always)]
    pub(super) fn rounding_m(&self) -> f64 {
        const SHARE: f64 = 10.0 * f64::EPSILON;
        SHARE * (self.start_m.abs().sum() + self.span_m.abs().sum())
    }
}

/// A checked obstacle: shape, radius, and the velocity of the whole. 152 bytes, no heap.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Obstacle {
    shape: Shape,
    axis: Axis,
    radius_m: f64,
    velocity_m_s: Vector3<f64>,
}

/// The number that makes an obstacle invalid.
#[derive(Debug, Clone, PartialEq, Error)]
#[error("obstacle: {key} has {value}, outside {allowed:?} (SI units: m, m/s); correct it")]
pub struct ObstacleError {
    /// Name of the number or vector: `radius_m`, `velocity_m_s`, `centre_m`, `start_m` or `end_m`.
    pub key: &'static str,
    /// The number, or the first component of the vector that is out of range; in the unit that ends the key.
    pub value: f64,
    /// [`OBSTACLE_RADIUS_M`] or [`OBSTACLE_COMPONENT`].
    pub allowed: RangeInclusive<f64>,
}

impl Obstacle {
    /// A ball at rest around `centre_m` (m, base frame).
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn ball(centre_m: Vector3<f64>, radius_m: f64) -> Result<Self, ObstacleError> {
        Self::new(Shape::Sphere { centre_m }, radius_m, Vector3::zeros())
    }

    /// An obstacle of `radius_m` (m) around `shape` (m, base frame) that moves at `velocity_m_s` (m/s, base frame; zero
    /// at rest).
    ///
    /// # Errors
    /// The first number that is NaN, infinite or outside [`OBSTACLE_RADIUS_M`] or [`OBSTACLE_COMPONENT`].
    pub fn new(
        shape: Shape,
        radius_m: f64,
        velocity_m_s: Vector3<f64>,
    ) -> Result<Self, ObstacleError> {
        let check = |key, value, allowed: RangeInclusive<f64>| {
            if allowed.contains(&value) {
                Ok(())
            } else {
                Err(ObstacleError {
                    key,
                    value,
                    allowed,
                })
            }
        };
        check("radius_m", radius_m, OBSTACLE_RADIUS_M)?;
        let [first, second] = shape.points();
        for (key, vector) in [first, second, ("velocity_m_s", velocity_m_s)] {
            for component in vector.iter() {
                check(key, *component, OBSTACLE_COMPONENT)?;
            }
        }
        Ok(Self {
            shape,
            axis: shape.axis(),
            radius_m,
            velocity_m_s,
        })
    }

    /// Axis of the obstacle (m, base frame).
    pub fn shape(&self) -> &Shape {
        &self.shape
    }

    /// The axis prepared for distances.
    #[inline(always)]
    pub(super) fn axis(&self) -> &Axis {
        &self.axis
    }

    /// Radius around the axis (m), in [`OBSTACLE_RADIUS_M`].
    pub fn radius_m(&self) -> f64 {
        self.radius_m
    }

    /// Velocity (m/s, base frame).
    pub fn velocity_m_s(&self) -> Vector3<f64> {
        self.velocity_m_s
    }

    /// The obstacle in another frame. `frame` transforms points from this frame into that one.
    #[must_use]
    pub(crate) fn seen_in(&self, frame: &Isometry3<f64>) -> Self {
        let shape = self.shape.seen_in(frame);
        Self {
            shape,
            axis: shape.axis(),
            velocity_m_s: frame * self.velocity_m_s,
            ..*self
        }
    }

    /// The obstacle after `dt_s` (s, finite; negative for earlier), moved at constant velocity without turning.
    #[must_use]
    #[inline(always)]
    pub fn moved(&self, dt_s: f64) -> Self {
        let by_m = self.velocity_m_s * dt_s;
        Self {
            shape: self.shape.translated(by_m),
            axis: Axis {
                start_m: self.axis.start_m + by_m,
                ..self.axis
            },
            ..*self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn capsule(start_m: Vector3<f64>, end_m: Vector3<f64>) -> Shape {
        Shape::Capsule { start_m, end_m }
    }

    #[test]
    fn non_finite_numbers_and_negative_radii_are_rejected_by_name() {
        let (origin, x) = (Vector3::zeros(), Vector3::x());
        let key = |shape, radius_m, velocity_m_s| {
            Obstacle::new(shape, radius_m, velocity_m_s)
                .unwrap_err()
                .key
        };
        let ball = Shape::Sphere { centre_m: x };
        for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1.1e6] {
            assert_eq!(key(ball, value, origin), "radius_m");
            assert_eq!(key(ball, 0.1, x * value), "velocity_m_s");
            let far = Vector3::new(0.0, value, 0.0);
            assert_eq!(
                key(Shape::Sphere { centre_m: far }, 0.1, origin),
                "centre_m"
            );
            assert_eq!(key(capsule(far, x), 0.1, origin), "start_m");
            assert_eq!(key(capsule(x, far), 0.1, origin), "end_m");
        }
        let error = Obstacle::new(ball, -0.01, origin).unwrap_err();
        assert_eq!(
            error.to_string(),
            "obstacle: radius_m has -0.01, outside 0.0..=1000000.0 (SI units: m, m/s); correct it"
        );
        assert!(Obstacle::new(ball, 0.0, origin).is_ok());
    }

    #[test]
    fn an_obstacle_moves_as_a_whole_at_its_velocity() {
        let velocity_m_s = Vector3::new(0.1, -0.2, 0.0);
        let (start_m, end_m) = (Vector3::x(), Vector3::z());
        let shape = capsule(start_m, end_m);
        let obstacle = Obstacle::new(shape, 0.02, velocity_m_s).unwrap();
        let later = obstacle.moved(0.5);
        let by_m = Vector3::new(0.05, -0.1, 0.0);
        assert_eq!(later.shape(), &capsule(start_m + by_m, end_m + by_m));
        assert_eq!(later.radius_m(), 0.02);
        assert_eq!(later.velocity_m_s(), velocity_m_s);
        assert_eq!(obstacle.moved(0.0), obstacle);
        let ball = Shape::Sphere { centre_m: start_m };
        let ball = Obstacle::new(ball, 0.02, velocity_m_s).unwrap();
        assert_eq!(
            ball.moved(-0.5).shape(),
            &Shape::Sphere {
                centre_m: start_m - by_m
            }
        );
    }

    #[test]
    fn distance_to_the_axis_of_a_capsule_ends_at_its_ends() {
        let shape = capsule(Vector3::zeros(), Vector3::x());
        let distance_m = |shape: &Shape, point_m| {
            let Wide([square_m2]) = shape.axis().square_m2(&WideVector::splat(&point_m));
            square_m2.sqrt()
        };
        let at = |x, y| distance_m(&shape, Vector3::new(x, y, 0.0));
        assert_eq!(at(0.3, 0.4), 0.4);
        assert_eq!(at(-0.3, 0.4), 0.5);
        assert_eq!(at(1.3, 0.4), 0.5);
        let ball = capsule(Vector3::x(), Vector3::x());
        assert_eq!(distance_m(&ball, Vector3::zeros()), 1.0);
    }
}
