use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};

use nalgebra::Vector3;

use super::interpolation::{Knot, STENCIL, hermite, orientation, tangent};
use super::{Interpolation, ReferencePoint, ReferenceSample, ReferenceState};

/// A bounded buffer of reference points, each at least [`POINT_SPACING_MIN_NS`] after the previous one.
///
/// Clients fill it ahead of time, so their jitter does not reach the control loop. The value at a time depends only on
/// the nearest points, so removing points long past changes nothing.
#[derive(Debug, Clone)]
pub struct Trajectory {
    points: VecDeque<ReferencePoint>,
    capacity: usize,
    reach_m: f64,
    /// Unique to the points of this trajectory.
    revision: u64,
    replacements: u64,
}

/// The next revision, unique among all trajectories.
fn next_revision() -> u64 {
    static NEXT: AtomicU64 = AtomicU64::new(1);
    NEXT.fetch_add(1, Ordering::Relaxed)
}

/// Least time between two points \[ns\].
pub const POINT_SPACING_MIN_NS: u64 = 1_000;

/// Reason why points were rejected. The trajectory is then unchanged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum TrajectoryError {
    /// A time is less than [`POINT_SPACING_MIN_NS`] after the previous one.
    #[error(
        "point {index}: its time is less than {POINT_SPACING_MIN_NS} ns after that of the point before it"
    )]
    TimeNotIncreasing {
        /// Index of the point among those offered.
        index: usize,
    },
    /// The points exceed the capacity.
    #[error("{offered} points do not fit: {used} of {capacity} are used")]
    Full {
        /// Points offered.
        offered: usize,
        /// Points buffered.
        used: usize,
        /// Capacity in points.
        capacity: usize,
    },
}

/// Number of passed points that are kept. The tangents at both ends of the present segment need them.
const PASSED_KEPT: usize = STENCIL - 1;

impl Trajectory {
    /// An empty trajectory for up to `capacity` points. Allocates all memory. A cubic between two points stays within
    /// `reach_m` of the base, or within the larger distance of the two.
    pub fn with_capacity(capacity: usize, reach_m: f64) -> Self {
        Self {
            points: VecDeque::with_capacity(capacity),
            capacity,
            reach_m,
            revision: next_revision(),
            replacements: 0,
        }
    }

    /// Revision of the samples, changed with each of them. Two trajectories of one revision have the same samples,
    /// except for removed points.
    pub(super) fn revision(&self) -> u64 {
        self.revision
    }

    /// Replaces all points.
    ///
    /// # Errors
    /// As [`Trajectory::append`].
    pub fn replace(
        &mut self,
        points: impl Iterator<Item = ReferencePoint> + Clone,
    ) -> Result<(), TrajectoryError> {
        self.check(points.clone(), None, 0)?;
        self.points.clear();
        self.points.extend(points);
        self.revision = next_revision();
        self.replacements += 1;
        Ok(())
    }

    /// Number of replacements. After one, the samples may continue elsewhere.
    pub(super) fn replacements(&self) -> u64 {
        self.replacements
    }

    /// Appends points after the last one.
    ///
    /// # Errors
    /// [`TrajectoryError`] if times are too close or do not increase, or the capacity is exceeded. No point is then
    /// taken.
    pub fn append(
        &mut self,
        points: impl Iterator<Item = ReferencePoint> + Clone,
    ) -> Result<(), TrajectoryError> {
        self.check(points.clone(), self.end_ns(), self.points.len())?;
        self.points.extend(points);
        self.revision = next_revision();
        Ok(())
    }

    fn check(
        &self,
        points: impl Iterator<Item = ReferencePoint>,
        after_ns: Option<u64>,
        used: usize,
    ) -> Result<(), TrajectoryError> {
        let mut last_ns = after_ns;
        let mut offered = 0;
        for (index, point) in points.enumerate() {
            if last_ns.is_some_and(|last| point.time_ns.saturating_sub(last) < POINT_SPACING_MIN_NS)
            {
                return Err(TrajectoryError::TimeNotIncreasing { index });
            }
            last_ns = Some(point.time_ns);
            offered += 1;
        }
        if used + offered > self.capacity {
            return Err(TrajectoryError::Full {
                offered,
                used,
                capacity: self.capacity,
            });
        }
        Ok(())
    }

    /// Removes all points.
    pub fn clear(&mut self) {
        self.points.clear();
        self.revision = next_revision();
    }

    /// Removes points that no sample at `now_ns` or later needs.
    pub fn forget_before(&mut self, now_ns: u64) {
        let passed = self.points.partition_point(|point| point.time_ns <= now_ns);
        self.points.drain(..passed.saturating_sub(PASSED_KEPT));
    }

    /// Number of buffered points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// True if there is no point.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Time of the last point \[ns\].
    pub fn end_ns(&self) -> Option<u64> {
        self.points.back().map(|point| point.time_ns)
    }

    /// Number of points later than `now_ns`.
    pub fn points_ahead(&self, now_ns: u64) -> usize {
        self.points.len() - self.points.partition_point(|point| point.time_ns <= now_ns)
    }

    /// True if a point is later than `now_ns`: the condition for a robot to begin to follow.
    pub fn is_fresh(&self, now_ns: u64) -> bool {
        self.end_ns().is_some_and(|end| end > now_ns)
    }

    /// The reference at `time_ns`. Cost: a binary search and one cubic.
    pub fn sample(&self, time_ns: u64) -> ReferenceSample {
        let next = self
            .points
            .partition_point(|point| point.time_ns <= time_ns);
        let hold = |point: &ReferencePoint, state| ReferenceSample {
            state,
            position_m: point.position_m,
            orientation: point.orientation,
        };
        match (
            next.checked_sub(1).and_then(|last| self.points.get(last)),
            self.points.get(next),
        ) {
            (None, None) => ReferenceSample::default(),
            (None, Some(first)) => hold(first, ReferenceState::Before),
            (Some(last), None) if last.time_ns == time_ns => hold(last, ReferenceState::Inside),
            (Some(last), None) => hold(last, ReferenceState::Ended),
            (Some(from), Some(to)) => {
                let part = (time_ns - from.time_ns) as f64 / (to.time_ns - from.time_ns) as f64;
                ReferenceSample {
                    state: ReferenceState::Inside,
                    position_m: self.position_between(next - 1, part),
                    orientation: orientation(from.orientation, to.orientation, part),
                }
            }
        }
    }

    /// Position at the share `part` between point `from` and the next.
    fn position_between(&self, from: usize, part: f64) -> Vector3<f64> {
        let (start, end) = (&self.points[from], &self.points[from + 1]);
        if end.interpolation == Interpolation::Linear {
            return start.position_m.lerp(&end.position_m, part);
        }
        let origin_ns = start.time_ns;
        let position_m = hermite(
            knot(start, origin_ns),
            knot(end, origin_ns),
            self.tangent_at(from, origin_ns),
            self.tangent_at(from + 1, origin_ns),
            part,
        );
        let ends_m = start.position_m.norm().max(end.position_m.norm());
        position_m.cap_magnitude(ends_m.max(self.reach_m))
    }

    /// Tangent at a point from the points around it, equally many on both sides where possible.
    fn tangent_at(&self, index: usize, origin_ns: u64) -> Vector3<f64> {
        let count = STENCIL.min(self.points.len());
        let first = index
            .saturating_sub(count / 2)
            .min(self.points.len() - count);
        let mut knots = [Knot::default(); STENCIL];
        for (offset, target) in knots[..count].iter_mut().enumerate() {
            *target = knot(&self.points[first + offset], origin_ns);
        }
        tangent(&knots[..count], index - first)
    }
}

/// A point with its time relative to `origin_ns`.
fn knot(point: &ReferencePoint, origin_ns: u64) -> Knot {
    let since_ns = i128::from(point.time_ns) - i128::from(origin_ns);
    Knot {
        time_s: since_ns as f64 * 1e-9,
        position_m: point.position_m,
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Unit, UnitQuaternion, Vector3};
    use proptest::prelude::*;

    use super::*;
    use crate::reference::Orientation;

    const MS: u64 = 1_000_000;
    const US: u64 = 1_000;
    const REACH_M: f64 = 0.9;

    fn point(time_ns: u64, x: f64) -> ReferencePoint {
        ReferencePoint {
            time_ns,
            position_m: Vector3::new(x, 0.0, 0.0),
            orientation: Orientation::Free,
            interpolation: Interpolation::Cubic,
        }
    }

    fn filled(points: &[ReferencePoint]) -> Trajectory {
        let mut trajectory = Trajectory::with_capacity(4096, REACH_M);
        trajectory
            .replace(points.iter().copied())
            .expect("legal points");
        trajectory
    }

    fn circle(count: u64) -> Vec<ReferencePoint> {
        (0..count)
            .map(|k| ReferencePoint {
                position_m: on_circle(k as f64 * 5e-3),
                ..point(k * 5 * MS, 0.0)
            })
            .collect()
    }

    fn on_circle(t: f64) -> Vector3<f64> {
        Vector3::new(0.3 * t.cos(), 0.3 * t.sin(), 0.1)
    }

    #[test]
    fn states_before_inside_and_after() {
        let trajectory = filled(&[point(10 * US, 1.0), point(20 * US, 2.0)]);
        let at = |time| {
            (
                trajectory.sample(time * US).state,
                trajectory.sample(time * US).position_m.x,
            )
        };
        assert_eq!(at(5), (ReferenceState::Before, 1.0));
        assert_eq!(at(10), (ReferenceState::Inside, 1.0));
        assert_eq!(at(15), (ReferenceState::Inside, 1.5));
        assert_eq!(at(20), (ReferenceState::Inside, 2.0));
        assert_eq!(at(21), (ReferenceState::Ended, 2.0));
        assert_eq!(
            Trajectory::with_capacity(1, REACH_M).sample(0).state,
            ReferenceState::None
        );
    }

    #[test]
    fn cubic_meets_a_smooth_curve_to_a_picometre() {
        let trajectory = filled(&circle(200));
        for time_ns in (0..990 * MS).step_by(1_234_567) {
            let error =
                (trajectory.sample(time_ns).position_m - on_circle(time_ns as f64 * 1e-9)).norm();
            let inner = (10 * MS..980 * MS).contains(&time_ns);
            assert!(
                error < if inner { 1e-12 } else { 1e-11 },
                "{error} at {time_ns}"
            );
        }
    }

    /// The figures of decision 4, as shares of a step between two of twelve points.
    #[test]
    fn cubic_overshoots_a_step_by_known_shares() {
        for (step, share) in [(6, 0.093), (9, 0.126), (3, 0.126), (10, 0.382), (2, 0.382)] {
            let x_m = |k| if k < step { 0.4 } else { 0.6 };
            let trajectory = filled(
                &(0..12)
                    .map(|k| point(5 * k * MS, x_m(k)))
                    .collect::<Vec<_>>(),
            );
            let samples = (0..55 * MS).step_by(50_000);
            let most_m = samples
                .map(|time_ns| trajectory.sample(time_ns).position_m.x)
                .map(|x_m| (0.4 - x_m).max(x_m - 0.6))
                .fold(0.0, f64::max);
            assert!((most_m / 0.2 - share).abs() < 1e-3, "{step}: {most_m} m");
        }
    }

    #[test]
    fn linear_does_not_overshoot_a_corner() {
        let corner = [0.0, 0.0, 1.0, 1.0]
            .iter()
            .zip(0..)
            .map(|(&x, k)| ReferencePoint {
                interpolation: Interpolation::Linear,
                ..point(k * 10 * US, x)
            });
        let trajectory = filled(&corner.collect::<Vec<_>>());
        for time in 0..=30 {
            assert!((0.0..=1.0).contains(&trajectory.sample(time * US).position_m.x));
        }
    }

    #[test]
    fn forgetting_the_past_changes_no_later_sample() {
        let whole = filled(&circle(200));
        let mut trimmed = whole.clone();
        for now_ns in (0..900 * MS).step_by(3_333_333) {
            trimmed.forget_before(now_ns);
            for ahead in [0, 1, 2_500_000, 5 * MS, 10 * MS] {
                assert_eq!(whole.sample(now_ns + ahead), trimmed.sample(now_ns + ahead));
            }
        }
        assert!(trimmed.len() < 27);
    }

    #[test]
    fn rejects_a_chunk_as_a_whole_with_the_index() {
        let mut trajectory = filled(&[point(10 * US, 0.0)]);
        let bad = [point(20 * US, 0.0), point(20 * US, 0.0)];
        assert_eq!(
            trajectory.append(bad.into_iter()),
            Err(TrajectoryError::TimeNotIncreasing { index: 1 })
        );
        // The boundary of two chunks is checked like any other place.
        for time_ns in [0, 10 * US, 11 * US - 1] {
            assert_eq!(
                trajectory.append([point(time_ns, 0.0)].into_iter()),
                Err(TrajectoryError::TimeNotIncreasing { index: 0 })
            );
        }
        assert_eq!(trajectory.len(), 1);
        let mut small = Trajectory::with_capacity(1, REACH_M);
        assert!(matches!(
            small.replace([point(US, 0.0), point(2 * US, 0.0)].into_iter()),
            Err(TrajectoryError::Full { offered: 2, .. })
        ));
    }

    #[test]
    fn orientation_follows_the_shortest_arc() {
        let full =
            |angle: f64| Orientation::Full(UnitQuaternion::from_euler_angles(0.0, 0.0, angle));
        let mut points = [point(0, 0.0), point(10 * US, 0.0)];
        points[0].orientation = full(0.0);
        points[1].orientation = full(1.0);
        let Orientation::Full(middle) = filled(&points).sample(5 * US).orientation else {
            panic!("kind changed");
        };
        assert!((middle.euler_angles().2 - 0.5).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn noise_of_the_points_grows_at_most_eightfold_whatever_their_spacing(
            spacings_ns in prop::collection::vec(
                prop_oneof![Just(US), Just(5 * US), Just(5 * MS), US..100 * MS], 1..12,
            ),
            noise_m in prop::collection::vec(-1e-5..1e-5_f64, 12),
        ) {
            // On a straight line at constant speed, which a cubic meets exactly whatever the spacing.
            let line_m = |time_ns: u64| 0.3 * time_ns as f64 * 1e-9;
            let mut time_ns = 0;
            let mut points = vec![point(0, noise_m[0])];
            for (spacing_ns, noise_m) in spacings_ns.iter().zip(&noise_m[1..]) {
                time_ns += spacing_ns;
                points.push(point(time_ns, line_m(time_ns) + noise_m));
            }
            let trajectory = filled(&points);
            for pair in points.windows(2) {
                let span_ns = pair[1].time_ns - pair[0].time_ns;
                for part in 1..20 {
                    let at_ns = pair[0].time_ns + span_ns * part / 20;
                    let error_m = trajectory.sample(at_ns).position_m.x - line_m(at_ns);
                    prop_assert!(error_m.abs() < 8e-5, "{error_m:e} m at {at_ns} ns");
                }
            }
        }

        #[test]
        fn axes_turn_at_a_constant_rate_even_if_opposite(
            from in prop::array::uniform3(-1.0..1.0_f64), off in prop::array::uniform3(-1.0..1.0_f64),
            size in prop_oneof![Just(0.0), Just(1e-12), Just(1e-8), Just(1e-4), Just(1.0)],
            sign in prop_oneof![Just(-1.0), Just(1.0)],
        ) {
            let from = Vector3::from(from);
            let to = from * sign + Vector3::from(off) * size;
            prop_assume!(from.norm() > 0.1 && to.norm() > 0.1);
            let [from, to] = [from, to].map(Unit::new_normalize);
            let mut points = [point(0, 0.0), point(10 * US, 0.0)];
            points[0].orientation = Orientation::Axis(from);
            points[1].orientation = Orientation::Axis(to);
            let trajectory = filled(&points);
            let angle = |a: Vector3<f64>, b: Vector3<f64>| a.cross(&b).norm().atan2(a.dot(&b));
            let whole = angle(*from, *to);
            let mut before = *from;
            for tenth in 1..=10 {
                let Orientation::Axis(axis) = trajectory.sample(tenth * US).orientation else {
                    panic!("kind changed");
                };
                prop_assert!((axis.norm() - 1.0).abs() < 1e-12, "{axis:?}");
                prop_assert!((angle(before, *axis) - whole / 10.0).abs() < 3e-9, "{axis:?} after {before:?}");
                before = *axis;
            }
        }
    }

    #[test]
    fn a_cubic_stays_inside_the_reach_or_within_its_points() {
        let steps = [0.7, 0.7, 0.9, 0.9, 0.9, 0.7];
        let corners: Vec<_> = (0..)
            .zip(steps)
            .map(|(k, x)| point(k * 5 * MS, x))
            .collect();
        let farthest = |trajectory: &Trajectory| {
            let samples = (0..25 * MS)
                .step_by(100_000)
                .map(|ns| trajectory.sample(ns));
            samples
                .map(|sample| sample.position_m.norm())
                .fold(0.0, f64::max)
        };
        assert!(farthest(&filled(&corners)) <= REACH_M + 1e-15);
        let mut farther = Trajectory::with_capacity(8, 2.0);
        farther.replace(corners.into_iter()).expect("legal points");
        assert!(
            farthest(&farther) > REACH_M + 0.005,
            "nothing was to be held back"
        );
    }
}
