//! The reference: time-stamped tip poses, buffered ahead of time and interpolated.
//!
//! [`Trajectory`] holds the points of a client. [`ReferenceWindow`] holds the samples for one solve: at the release and
//! at each step of the horizon. [`FollowedReference`] is the reference that the tip follows: the samples of the window,
//! with an [`Approach`] at the beginning. A tip that was held back returns to it at the pace
//! of [`Followed::pace_m_s`].
//!
//! Invariant: nothing here knows the source of the points. Times are nanoseconds of one clock chosen by the caller.
//! Nothing allocates after construction.

mod approach;
mod followed;
mod interpolation;
mod trajectory;
mod window;

pub use approach::{
    Approach, ApproachLimits, EXCURSION_SHARE, QUINTIC_ACCELERATION_PEAK, QUINTIC_SPEED_PEAK,
};
pub use followed::{Followed, FollowedReference, GridPoint};
pub use trajectory::{POINT_SPACING_MIN_NS, Trajectory, TrajectoryError};
pub use window::{HORIZON_STEPS_MAX, ReferenceWindow};

use nalgebra::{Unit, UnitQuaternion, Vector3};

use crate::robot::Pose;
use approach::turn_rad;

/// The part of the tip's orientation that a reference specifies.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Orientation {
    /// Position only.
    #[default]
    Free,
    /// Direction of the tip axis (the z axis of the tip frame) in the base frame.
    Axis(Unit<Vector3<f64>>),
    /// Direction of the tip axis that the solver prefers where the position leaves a choice: it chooses a shape and hardly
    /// moves the tip, see [`PREFERRED_LEVER_SHARE`](crate::nmpc::PREFERRED_LEVER_SHARE).
    Preferred(Unit<Vector3<f64>>),
    /// The complete rotation base → tip.
    Full(UnitQuaternion<f64>),
}

impl Orientation {
    /// Turned about a base axis by an angle: axis times angle (rad).
    #[must_use]
    fn turned(&self, by_rad: Vector3<f64>) -> Self {
        let turn = UnitQuaternion::from_scaled_axis(by_rad);
        match *self {
            Self::Free => Self::Free,
            Self::Axis(axis) => Self::Axis(turn * axis),
            Self::Preferred(axis) => Self::Preferred(turn * axis),
            Self::Full(rotation) => Self::Full(turn * rotation),
        }
    }
}

impl ReferenceSample {
    /// The point on the straight way from `tip` to this sample at `share` of it (0 to 1), in position and orientation.
    #[must_use]
    pub fn at_share_from(&self, tip: &Pose, share: f64) -> Self {
        let left_rad = turn_rad(tip, &self.orientation) * (1.0 - share);
        Self {
            state: self.state,
            position_m: tip.position_m + (self.position_m - tip.position_m) * share,
            orientation: self.orientation.turned(left_rad),
        }
    }
}

/// Interpolation of the position between two points.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Interpolation {
    /// A straight line.
    Linear,
    /// A cubic Hermite curve for smooth references, with tangents from five-point differences. Fourth order: a circle
    /// of 0.3 m sampled every 5 ms at 1 rad/s is met to 1e-12 m. It rounds corners and overshoots slightly before and
    /// after them, but stays within the reach. Tangents omit points much closer to each other than the rest: the curve
    /// amplifies noise of the points at most eightfold, whatever their spacing.
    #[default]
    Cubic,
}

/// One point of a trajectory.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReferencePoint {
    /// Time at which the tip shall be at this point \[ns\].
    pub time_ns: u64,
    /// Tip position in the base frame \[m\].
    pub position_m: Vector3<f64>,
    /// Tip orientation.
    pub orientation: Orientation,
    /// Interpolation of the segment that **ends** at this point.
    pub interpolation: Interpolation,
}

/// Position of a time relative to the trajectory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ReferenceState {
    /// There is no trajectory.
    #[default]
    None,
    /// Before the first point, which is held until then.
    Before,
    /// Within the trajectory.
    Inside,
    /// After the last point, which is held from then on.
    Ended,
}

/// The reference at one time.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ReferenceSample {
    /// Position of the time relative to the trajectory.
    pub state: ReferenceState,
    /// Tip position in the base frame \[m\]; meaningless in state `None`.
    pub position_m: Vector3<f64>,
    /// Tip orientation.
    pub orientation: Orientation,
}

impl ReferenceSample {
    /// A tip position (m, base frame) with free orientation.
    pub fn at_position(position_m: Vector3<f64>) -> Self {
        Self {
            state: ReferenceState::Inside,
            position_m,
            orientation: Orientation::Free,
        }
    }

    /// The sample with its position moved by `by_m` (m).
    #[must_use]
    pub fn moved(&self, by_m: &Vector3<f64>) -> Self {
        let position_m = self.position_m + by_m;
        Self {
            position_m,
            ..*self
        }
    }
}
