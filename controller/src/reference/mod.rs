//! The reference: time-stamped tip poses, buffered ahead of time and interpolated.
//!
//! [`Trajectory`] is what clients feed; [`ReferenceWindow`] is what one solve looks at: the reference
//! at the release and at each step of the horizon. [`FollowedReference`] is what the tip is led along: the same, but for
//! the [`Approach`] at its beginning.
//!
//! Invariant: nothing here knows where points come from. Times are nanoseconds of one clock that the
//! caller chooses; nothing allocates after construction.

mod approach;
mod followed;
mod interpolation;
mod trajectory;
mod window;

pub use approach::{Approach, ApproachLimits, QUINTIC_ACCELERATION_PEAK, QUINTIC_SPEED_PEAK};
pub use followed::{FollowedReference, GridPoint};
pub use trajectory::{APART_MIN_NS, Trajectory, TrajectoryError};
pub use window::{HORIZON_STEPS_MAX, ReferenceWindow};

use nalgebra::{Unit, UnitQuaternion, Vector3};

/// How much of the tip's orientation a reference asks for.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Orientation {
    /// Nothing: position only.
    #[default]
    Free,
    /// The direction of the tip axis (the z axis of the tip frame) in the base frame.
    Axis(Unit<Vector3<f64>>),
    /// The whole rotation base → tip.
    Full(UnitQuaternion<f64>),
}

/// How the position between two points is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Interpolation {
    /// A straight line.
    Linear,
    /// A cubic Hermite curve whose tangents are five-point differences, for smooth references. Fourth
    /// order: a circle of 0.3 m sampled each 5 ms at 1 rad/s is met to 1e-12 m. It rounds corners, and
    /// swings a little before and after them, but not beyond the reach. Tangents leave out points that are much closer
    /// to each other than the rest: noise of the points reaches the curve at most eightfold, whatever their spacing.
    #[default]
    Cubic,
}

/// One point of a trajectory.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReferencePoint {
    /// When the tip shall be there \[ns\].
    pub time_ns: u64,
    /// Tip position in the base frame \[m\].
    pub position_m: Vector3<f64>,
    /// Tip orientation.
    pub orientation: Orientation,
    /// Interpolation on the way **to** this point.
    pub interpolation: Interpolation,
}

/// Where an instant lies relative to the trajectory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ReferenceState {
    /// There is no trajectory.
    #[default]
    None,
    /// Before its first point, which counts until then.
    Before,
    /// Inside.
    Inside,
    /// After its last point, which counts from then on.
    Ended,
}

/// The reference at one instant.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ReferenceSample {
    /// Where the instant lies.
    pub state: ReferenceState,
    /// Tip position in the base frame \[m\]; meaningless in state `None`.
    pub position_m: Vector3<f64>,
    /// Tip orientation.
    pub orientation: Orientation,
}

impl ReferenceSample {
    /// A tip position (m, base frame) that is reached in any orientation.
    pub fn at(position_m: Vector3<f64>) -> Self {
        Self {
            state: ReferenceState::Inside,
            position_m,
            orientation: Orientation::Free,
        }
    }

    /// The same elsewhere by `by_m` (m).
    #[must_use]
    pub fn moved(&self, by_m: &Vector3<f64>) -> Self {
        let position_m = self.position_m + by_m;
        Self {
            position_m,
            ..*self
        }
    }
}
