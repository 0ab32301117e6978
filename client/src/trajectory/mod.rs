//! Curves for the tip, each as an exact function of time.
//!
//! Invariant: nothing here knows a clock or a daemon. Time counts from the start of the curve.

mod changed;
mod circle;
mod figure;
#[cfg(feature = "csv")]
mod file;
mod line;
mod spiral;
#[cfg(feature = "model")]
mod straight;

pub use changed::Changed;
pub use circle::Circle;
pub use figure::{Figure, FigurePlane, FigureShape};
#[cfg(feature = "csv")]
pub use file::{FileTrajectory, TrajectoryFileError, TrajectoryFileProblem};
pub use line::Line;
pub use spiral::Spiral;
#[cfg(feature = "model")]
pub use straight::Straight;

use cdcr_shared_types::ReferencePoint;
use cdcr_shared_types::codes::OrientationKind;

/// Length of the paper's sections \[m\].
pub const PAPER_SECTION_M: f64 = 0.3;

/// Orientation of the tip.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Orientation {
    /// Any orientation.
    #[default]
    Free,
    /// The tip axis has this direction, a unit vector (x, y, z) in the base frame.
    Axis([f64; 3]),
    /// The daemon prefers this direction of the tip axis, a unit vector, where the position leaves a choice: it chooses a shape
    /// and hardly moves the tip.
    Preferred([f64; 3]),
    /// The full orientation: unit quaternion (x, y, z, w) base → tip.
    Full([f64; 4]),
}

impl Orientation {
    /// Kind and numbers of a [`ReferencePoint`].
    pub fn to_wire(self) -> (OrientationKind, [f64; 4]) {
        match self {
            Self::Free => (OrientationKind::None, [0.0; 4]),
            Self::Axis([x, y, z]) => (OrientationKind::Axis, [x, y, z, 0.0]),
            Self::Preferred([x, y, z]) => (OrientationKind::Preferred, [x, y, z, 0.0]),
            Self::Full(quaternion) => (OrientationKind::Full, quaternion),
        }
    }
}

/// A curve whose ends are closer than this is closed \[m\].
const CLOSED_M: f64 = 1e-3;

/// A curve in time. Implement it to feed your own curves.
pub trait Trajectory {
    /// Name for messages.
    fn name(&self) -> &str;

    /// Duration \[s\], ≥ 0.
    fn duration_s(&self) -> f64;

    /// Exact position of the tip at `time_s` \[m, base frame\], for 0 ≤ `time_s` ≤ duration. Outside that
    /// range, the position at the nearer end.
    fn position_m(&self, time_s: f64) -> [f64; 3];

    /// Orientation of the tip at `time_s`; free by default.
    fn orientation(&self, _time_s: f64) -> Orientation {
        Orientation::Free
    }

    /// Times \[s\] that must be sent exactly: increasing, the first 0, the last the duration. `None`: the
    /// curve is sampled at equal steps.
    fn knots_s(&self) -> Option<&[f64]> {
        None
    }

    /// Whether it ends within a millimetre of where it begins.
    fn is_closed(&self) -> bool {
        let ends_m = [0.0, self.duration_s()].map(|time_s| self.position_m(time_s));
        let squares = (0..3).map(|i| (ends_m[1][i] - ends_m[0][i]).powi(2));
        squares.sum::<f64>().sqrt() < CLOSED_M
    }

    /// The reference point at `time_s`, stamped with `time_ns` on the daemon's clock.
    fn point(&self, time_s: f64, time_ns: u64) -> ReferencePoint {
        let (kind, orientation) = self.orientation(time_s).to_wire();
        ReferencePoint {
            time_ns,
            position_m: self.position_m(time_s),
            orientation,
            orientation_kind: kind.code(),
            reserved: 0,
        }
    }
}

/// Splits section lengths into the height of the straight sections below the last, and the length of the last
/// one. An empty robot counts as one section of the paper.
fn base_and_last_m(section_lengths_m: &[f64]) -> (f64, f64) {
    match section_lengths_m.split_last() {
        Some((&last_m, below)) => (below.iter().sum(), last_m),
        None => (0.0, PAPER_SECTION_M),
    }
}

#[cfg(test)]
mod tests {
    /// Asserts that two vectors are equal within rounding.
    pub(super) fn assert_near<const N: usize>(values: [f64; N], expected: [f64; N]) {
        for (value, wanted) in values.iter().zip(expected) {
            assert!((value - wanted).abs() < 1e-15, "{values:?} {expected:?}");
        }
    }

    /// Both declare the constants: the controller knows no client, and a client without `model` no controller.
    #[cfg(feature = "model")]
    #[test]
    fn the_curves_of_the_paper_are_those_of_the_scenes_of_the_controller() {
        use super::{Circle, Line, Spiral, Trajectory};
        use cdcr_controller::closed_loop::Scene;

        let vertical = Line {
            tip_axis: Some([0.0, 0.0, 1.0]),
            ..Line::for_sections(&[0.3; 3])
        };
        let curves: [(&dyn Trajectory, Scene); 3] = [
            (&Spiral::for_sections(&[0.3; 3]), Scene::spiral(3).unwrap()),
            (&vertical, Scene::line(2.0).unwrap()),
            (&Circle::for_sections(&[0.3]), Scene::circle().unwrap()),
        ];
        for (curve, scene) in curves {
            let cycles = (curve.duration_s() / Scene::PERIOD_S) as u64;
            assert!(cycles > 500, "{}", curve.name());
            for time_s in (0..=cycles).map(|cycle| cycle as f64 * Scene::PERIOD_S) {
                let expected = (scene.reference_at)(time_s);
                let found_m = nalgebra::Vector3::from(curve.position_m(time_s));
                let apart_m = (expected.position_m - found_m).norm();
                assert!(apart_m < 1e-12, "{}, {time_s} s: {apart_m} m", curve.name());
                let orientation = crate::model::orientation_of(curve.orientation(time_s));
                assert_eq!(orientation, expected.orientation, "{}", curve.name());
            }
        }
    }
}
