use nalgebra::{Rotation3, Unit, UnitQuaternion, Vector3};

use super::{Orientation, ReferenceSample};
use crate::robot::Pose;

/// Peak speed of the quintic from rest to rest, relative to distance / duration: 15/8, at its middle.
pub const QUINTIC_SPEED_PEAK: f64 = 1.875;
/// Peak acceleration of the same quintic, relative to distance / duration²: 10/√3.
pub const QUINTIC_ACCELERATION_PEAK: f64 = 5.773_502_691_896_258;
/// Peak acceleration of the quintic that ends a speed, relative to speed / duration: at s = (16 - √76) / 30.
const JOINING_ACCELERATION_PEAK: f64 = 3.941;
/// Peak distance of the same quintic, relative to speed · duration.
const JOINING_DISTANCE_PEAK: f64 = 0.1976;

/// Largest deviation while joining a reference from rest, as a share of the robot's length ([`ApproachLimits::excursion_m`]).
pub const EXCURSION_SHARE: f64 = 0.02;

/// Limits of an approach.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ApproachLimits {
    /// Peak speed with which the distance to the reference decays \[m/s\].
    pub speed_m_s: f64,
    /// Peak acceleration added to that of the reference \[m/s²\]: half of it for the distance, half of it for joining
    /// the motion.
    pub acceleration_m_s2: f64,
    /// Largest distance that the tip may leave the path to the reference in order to join its motion gently \[m\]. A
    /// motion that would exceed it is joined faster.
    pub excursion_m: f64,
    /// Peak turn rate of the tip towards a specified orientation \[rad/s\].
    pub turn_rad_s: f64,
}

/// Smooth transition to a reference that begins away from the tip or in motion.
///
/// The reference keeps its own timing; the initial difference between the followed point and the reference decays to
/// zero. The position difference follows a quintic from rest to rest, the velocity difference a quintic of its own;
/// both have zero acceleration at their ends. Quintic with given ends: L. Biagiotti, C. Melchiorri, *Trajectory
/// Planning for Automatic Machines and Robots*, Springer 2008, §2.1.4. While joining a motion, the tip is briefly up to
/// 1.52 times as fast as the reference.
///
/// Invariant: the fields determine the approach completely, so that a cycle can be recomputed from them.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Approach {
    /// Start time, on the clock of the releases \[ns\].
    pub begin_ns: u64,
    /// Duration of the decay of the distance \[ns\].
    pub duration_ns: u64,
    /// Duration of joining the motion \[ns\].
    pub joining_ns: u64,
    /// Tip minus reference at the start \[m\].
    pub offset_m: Vector3<f64>,
    /// Velocity followed before minus that of the reference, at the start \[m/s\].
    pub velocity_m_s: Vector3<f64>,
    /// Rotation from the reference's orientation to the tip's at the start, as axis times angle \[rad\].
    pub turn_rad: Vector3<f64>,
}

impl Approach {
    /// Plans an approach from a tip at `tip`, led with `velocity_m_s`, to a reference at `reference` at `begin_ns` that
    /// moves with `reference_m_s`. A part that would end within `period_ns`, or that is not finite, is omitted.
    pub fn plan(
        limits: &ApproachLimits,
        begin_ns: u64,
        (tip, velocity_m_s): (&Pose, &Vector3<f64>),
        (reference, reference_m_s): (&ReferenceSample, &Vector3<f64>),
        period_ns: u64,
    ) -> Self {
        let approach = Self {
            begin_ns,
            duration_ns: 0,
            joining_ns: 0,
            offset_m: tip.position_m - reference.position_m,
            velocity_m_s: velocity_m_s - reference_m_s,
            turn_rad: turn_rad(tip, &reference.orientation),
        };
        let in_ns = |duration_s: f64| {
            let lasts = duration_s.is_finite() && duration_s * 1e9 > period_ns as f64;
            if lasts {
                (duration_s * 1e9).ceil() as u64
            } else {
                0
            }
        };
        let planned = Self {
            duration_ns: in_ns(approach.distance_s(limits)),
            joining_ns: in_ns(approach.joining_s(limits)),
            ..approach
        };
        if planned.is_active() {
            planned
        } else {
            Self::default()
        }
    }

    /// Shortest duration of the distance's decay within the limits \[s\].
    fn distance_s(&self, limits: &ApproachLimits) -> f64 {
        let distance_m = self.offset_m.norm();
        let most_m_s2 = 0.5 * limits.acceleration_m_s2;
        let by_acceleration_s = (QUINTIC_ACCELERATION_PEAK * distance_m / most_m_s2).sqrt();
        let by_speed_s = QUINTIC_SPEED_PEAK * distance_m / limits.speed_m_s;
        let by_turn_s = QUINTIC_SPEED_PEAK * self.turn_rad.norm() / limits.turn_rad_s;
        by_acceleration_s.max(by_speed_s).max(by_turn_s)
    }

    /// Shortest duration of joining the motion \[s\]; the limit of the excursion takes precedence over that of the
    /// acceleration.
    fn joining_s(&self, limits: &ApproachLimits) -> f64 {
        let speed_m_s = self.velocity_m_s.norm();
        let by_acceleration_s =
            JOINING_ACCELERATION_PEAK * speed_m_s / (0.5 * limits.acceleration_m_s2);
        by_acceleration_s.min(limits.excursion_m / (JOINING_DISTANCE_PEAK * speed_m_s))
    }

    /// True if the followed point differs from the reference at any time.
    pub fn is_active(&self) -> bool {
        self.duration_ns.max(self.joining_ns) > 0
    }

    /// True if the reference itself is followed at `time_ns`.
    pub fn is_over(&self, time_ns: u64) -> bool {
        let lasts_ns = self.duration_ns.max(self.joining_ns);
        time_ns >= self.begin_ns.saturating_add(lasts_ns)
    }

    /// The sample to follow at `time_ns`, given the reference's `sample` at that time.
    #[must_use]
    pub fn followed_sample(&self, sample: &ReferenceSample, time_ns: u64) -> ReferenceSample {
        if self.is_over(time_ns) {
            return *sample;
        }
        let part = |of_ns: u64| match time_ns.saturating_sub(self.begin_ns) {
            passed_ns if passed_ns < of_ns => passed_ns as f64 / of_ns as f64,
            _ => 1.0,
        };
        let left = offset_left(part(self.duration_ns));
        let joining_s = self.joining_ns as f64 * 1e-9;
        let joined_m = self.velocity_m_s * (speed_left(part(self.joining_ns)) * joining_s);
        ReferenceSample {
            state: sample.state,
            position_m: sample.position_m + self.offset_m * left + joined_m,
            orientation: sample.orientation.turned(self.turn_rad * left),
        }
    }
}

/// The quintic from 1 at rest to 0 at rest, with zero acceleration at its ends.
fn offset_left(s: f64) -> f64 {
    1.0 - s * s * s * (10.0 - s * (15.0 - 6.0 * s))
}

/// The quintic from 0 with slope 1 to 0 at rest, with zero acceleration at its ends.
fn speed_left(s: f64) -> f64 {
    s - s * s * s * (6.0 - s * (8.0 - 3.0 * s))
}

/// Rotation from the reference's orientation to the tip's, as axis times angle \[rad\]. Zero for exactly opposite axes,
/// which have no shortest rotation; the solver then finds one.
pub(super) fn turn_rad(tip: &Pose, wanted: &Orientation) -> Vector3<f64> {
    let turn = match *wanted {
        Orientation::Free => None,
        Orientation::Axis(axis) | Orientation::Preferred(axis) => {
            let tip_axis = Unit::new_normalize(tip.rotation * Vector3::z());
            UnitQuaternion::rotation_between_axis(&axis, &tip_axis)
        }
        Orientation::Full(rotation) => {
            let tip_rotation = Rotation3::from_matrix_unchecked(tip.rotation);
            Some(UnitQuaternion::from_rotation_matrix(&tip_rotation) * rotation.inverse())
        }
    };
    turn.map_or(Vector3::zeros(), |turn| turn.scaled_axis())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const PERIOD_NS: u64 = 5_000_000;

    fn pose(position_m: Vector3<f64>, turn_rad: Vector3<f64>) -> Pose {
        Pose {
            position_m,
            rotation: UnitQuaternion::from_scaled_axis(turn_rad)
                .to_rotation_matrix()
                .into_inner(),
        }
    }

    fn sample(position_m: Vector3<f64>, orientation: Orientation) -> ReferenceSample {
        ReferenceSample {
            position_m,
            orientation,
            ..ReferenceSample::default()
        }
    }

    fn vector(most: f64) -> impl Strategy<Value = Vector3<f64>> {
        [-most..most, -most..most, -most..most].prop_map(Vector3::from)
    }

    const LIMITS: ApproachLimits = ApproachLimits {
        speed_m_s: 0.1,
        acceleration_m_s2: 0.5,
        excursion_m: 0.02,
        turn_rad_s: 0.5,
    };

    proptest! {
        /// The reference moves at constant velocity, so that all acceleration is that of the approach.
        #[test]
        fn an_approach_joins_tip_and_reference_within_its_limits(
            offset_m in vector(0.5),
            reference_m_s in vector(0.3),
            speed_m_s in 0.01..0.5_f64,
            acceleration_m_s2 in 0.1..5.0_f64,
        ) {
            let limits = ApproachLimits { speed_m_s, acceleration_m_s2, ..LIMITS };
            let tip = pose(offset_m, Vector3::zeros());
            let zero = Vector3::zeros();
            let reference = sample(zero, Orientation::Free);
            let approach = Approach::plan(&limits, 0, (&tip, &zero), (&reference, &reference_m_s), PERIOD_NS);
            let lasts_ns = approach.duration_ns.max(approach.joining_ns);
            let at = |step: u32| {
                let time_ns = (f64::from(step) * 1e-3 * lasts_ns as f64).ceil() as u64;
                approach.followed_sample(&sample(reference_m_s * (time_ns as f64 * 1e-9), Orientation::Free), time_ns).position_m
            };
            let end_m = reference_m_s * (lasts_ns as f64 * 1e-9);
            prop_assert!((at(0) - offset_m).norm() < 1e-12 && (at(1000) - end_m).norm() < 1e-12);
            let step_s = lasts_ns as f64 * 1e-12;
            let speed = reference_m_s.norm();
            // At rest, as the tip is.
            let soon_m = approach.followed_sample(&sample(reference_m_s * 1e-6, Orientation::Free), 1000).position_m;
            prop_assert!((soon_m - offset_m).norm() < 1e-6 * (0.001 * speed + 1e-6));
            let is_gentle = JOINING_ACCELERATION_PEAK * speed / (0.5 * acceleration_m_s2) * JOINING_DISTANCE_PEAK * speed <= limits.excursion_m;
            for k in 1..1000 {
                let [before, here, after] = [k - 1, k, k + 1].map(at);
                let acceleration = (after - 2.0 * here + before).norm() / (step_s * step_s);
                if is_gentle {
                    prop_assert!(acceleration <= 1.01 * acceleration_m_s2 + 1e-3, "{} at {}", acceleration, k);
                }
                let moved = (after - before).norm() / (2.0 * step_s);
                prop_assert!(moved <= 1.001 * speed_m_s + 1.52 * speed, "{} at {}", moved, k);
                // The deviation from the straight path to the reference stays within its limit.
                let time_s = f64::from(k) * step_s;
                let beside = here - reference_m_s * time_s;
                let along = beside.dot(&offset_m) / offset_m.norm_squared().max(1e-12);
                let nearest = offset_m * along.clamp(0.0, 1.0);
                prop_assert!((beside - nearest).norm() <= 1.001 * limits.excursion_m, "{} at {}", beside, k);
            }
        }

        #[test]
        fn orientations_are_turned_from_the_tips_to_the_references(
            tip_turn_rad in vector(1.5),
            wanted_rad in vector(1.5),
        ) {
            let limits = LIMITS;
            let tip = pose(Vector3::zeros(), tip_turn_rad);
            let wanted = UnitQuaternion::from_scaled_axis(wanted_rad);
            let zero = Vector3::zeros();
            let axis = wanted * Vector3::z_axis();
            for orientation in [Orientation::Free, Orientation::Preferred(axis), Orientation::Axis(axis), Orientation::Full(wanted)] {
                let reference = sample(zero, orientation);
                let approach = Approach::plan(&limits, 7, (&tip, &zero), (&reference, &zero), PERIOD_NS);
                let begin = approach.followed_sample(&reference, 7).orientation;
                match begin {
                    Orientation::Free => prop_assert_eq!(approach.duration_ns, 0),
                    Orientation::Axis(axis) | Orientation::Preferred(axis) => {
                        prop_assert!((axis.into_inner() - tip.rotation * Vector3::z()).norm() < 1e-9);
                    }
                    Orientation::Full(rotation) => {
                        let matrix = rotation.to_rotation_matrix().into_inner();
                        prop_assert!((matrix - tip.rotation).norm() < 1e-9);
                    }
                }
                let end_ns = 7 + approach.duration_ns;
                prop_assert_eq!(approach.followed_sample(&reference, end_ns), reference);
            }
        }
    }

    #[test]
    fn a_reference_that_begins_where_the_tip_is_at_rest_is_followed_at_once() {
        let limits = LIMITS;
        let zero = Vector3::zeros();
        for (offset_m, is_needed) in [(0.0, false), (1e-9, false), (1e-6, false), (1e-4, true)] {
            let tip = pose(Vector3::new(offset_m, 0.0, 0.9), zero);
            let reference = sample(Vector3::new(0.0, 0.0, 0.9), Orientation::Free);
            let approach =
                Approach::plan(&limits, 0, (&tip, &zero), (&reference, &zero), PERIOD_NS);
            assert_eq!(approach.duration_ns > 0, is_needed, "{offset_m}");
        }
        // A NaN is left to the checks of the caller.
        let tip = pose(Vector3::new(f64::NAN, 0.0, 0.0), zero);
        let reference = sample(zero, Orientation::Free);
        let approach = Approach::plan(&limits, 0, (&tip, &zero), (&reference, &zero), PERIOD_NS);
        assert_eq!(approach, Approach::default());
    }
}
