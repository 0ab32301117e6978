//! Poses of the tip, of the section ends and of points of the body (§1 of docs/model.md).
//!
//! The chain from base to tip: p = Σ R₀ⱼ₋₁ pⱼ, R = Π Rⱼ.

use nalgebra::{Matrix3, Vector3};

use super::section::position_coefficients;
use super::{Arc, Configuration, Robot, SECTIONS_MAX};

/// Position and orientation of a frame of the robot, seen from its base.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Position in the base frame (m).
    pub position_m: Vector3<f64>,
    /// Rotation from this frame to the base frame. Its columns are this frame's axes; the third is the direction of the
    /// backbone.
    pub rotation: Matrix3<f64>,
}

impl Pose {
    /// The base frame.
    pub fn identity() -> Self {
        Self {
            position_m: Vector3::zeros(),
            rotation: Matrix3::identity(),
        }
    }

    /// The pose at the end of `arc`, which starts at this pose.
    #[inline]
    #[must_use]
    pub(super) fn then(&self, arc: &Arc) -> Self {
        Self {
            position_m: self.position_m + self.rotation * arc.position_m(),
            rotation: self.rotation * arc.rotation(),
        }
    }
}

impl Robot {
    /// Pose of the tip in the base frame.
    pub fn tip_pose(&self, configuration: &Configuration) -> Pose {
        self.arcs(configuration)
            .fold(Pose::identity(), |pose, arc| pose.then(&arc))
    }

    /// Position of the tip in the base frame (m).
    ///
    /// Hot path of every rollout. It transforms one vector from the tip back to the base, x ← Rⱼ x + pⱼ, without
    /// matrices. With t = l - (u x + v y), each section costs its two coefficients and a dozen multiplications.
    #[inline]
    pub fn tip_position(&self, configuration: &Configuration) -> Vector3<f64> {
        let (mut x, mut y, mut z) = (0.0, 0.0, 0.0);
        let bends = self.sections().iter().zip(configuration.pairs());
        for (section, &[u, v]) in bends.rev() {
            let w = u * u + v * v;
            let (f, g) = position_coefficients(w);
            let t = section.length_m - (u * x + v * y);
            let across = f * z + g * t;
            x += u * across;
            y += v * across;
            z = (1.0 - w * g) * z + f * t;
        }
        Vector3::new(x, y, z)
    }

    /// The frame of the base, then of each section's end: entry 0 is the base, entry n the tip. Entries beyond n repeat
    /// the tip.
    pub fn section_frames(&self, configuration: &Configuration) -> [Pose; SECTIONS_MAX + 1] {
        let mut frames = [Pose::identity(); SECTIONS_MAX + 1];
        let mut arcs = self.arcs(configuration);
        let mut pose = Pose::identity();
        for frame in &mut frames[1..] {
            if let Some(arc) = arcs.next() {
                pose = pose.then(&arc);
            }
            *frame = pose;
        }
        frames
    }

    /// A point of the backbone in the base frame (m): in section `section` (0 at the base), at the share `s` of its
    /// length from its start. `s` is clamped to [0, 1]; a section beyond the last gives the tip.
    pub fn body_point(
        &self,
        configuration: &Configuration,
        section: usize,
        s: f64,
    ) -> Vector3<f64> {
        self.body_pose(configuration, section, s).position_m
    }

    /// Pose of the backbone at the point of [`Self::body_point`]; its z axis is the tangent.
    pub fn body_pose(&self, configuration: &Configuration, section: usize, s: f64) -> Pose {
        let start = self
            .arcs(configuration)
            .take(section)
            .fold(Pose::identity(), |pose, arc| pose.then(&arc));
        let Some(parameters) = self.sections().get(section) else {
            return start;
        };
        let s = s.clamp(0.0, 1.0);
        let [u, v] = configuration.section(section);
        // The first part of an arc is an arc: the same curvature over the length s l.
        start.then(&Arc::new(s * parameters.length_m, [s * u, s * v]))
    }

    /// The arcs from base to tip.
    #[inline]
    pub(super) fn arcs<'a>(
        &'a self,
        configuration: &'a Configuration,
    ) -> impl Iterator<Item = Arc> + 'a {
        self.sections()
            .iter()
            .zip(configuration.pairs())
            .map(|(section, &bend)| Arc::new(section.length_m, bend))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::robot::{Jacobian, RobotParameters};

    fn robot(n: usize) -> Robot {
        Robot::new(&RobotParameters::paper(n)).unwrap()
    }

    fn shapes() -> impl Strategy<Value = Configuration> {
        let component = prop_oneof![4 => -2.2..2.2_f64, 1 => -1e-7..1e-7_f64, 1 => Just(0.0)];
        (1..=SECTIONS_MAX)
            .prop_flat_map(move |n| prop::collection::vec(component.clone(), 2 * n))
            .prop_map(|components| Configuration::from_slice(&components).unwrap())
    }

    proptest! {
        #[test]
        fn the_tip_from_the_base_outwards_and_from_the_tip_back_agree(shape in shapes()) {
            let robot = robot(shape.section_count());
            let difference = robot.tip_pose(&shape).position_m - robot.tip_position(&shape);
            prop_assert!(difference.norm() < 3e-15 * robot.reach_m(), "{:e} m", difference.norm());
        }

        #[test]
        fn rotations_stay_orthonormal_and_right_handed(shape in shapes()) {
            let rotation = robot(shape.section_count()).tip_pose(&shape).rotation;
            prop_assert!((rotation * rotation.transpose() - Matrix3::identity()).amax() < 5e-15);
            prop_assert!((rotation.determinant() - 1.0).abs() < 5e-15);
        }

        #[test]
        fn frames_begin_at_the_base_end_at_the_tip_and_then_repeat_it(shape in shapes()) {
            let n = shape.section_count();
            let robot = robot(n);
            let frames = robot.section_frames(&shape);
            prop_assert_eq!(frames[0], Pose::identity());
            for frame in &frames[n..] {
                prop_assert_eq!(*frame, robot.tip_pose(&shape));
            }
            for j in 0..n {
                prop_assert_eq!(robot.body_point(&shape, j, 0.0), frames[j].position_m);
                prop_assert_eq!(robot.body_point(&shape, j, 1.0), frames[j + 1].position_m);
                prop_assert_eq!(robot.body_pose(&shape, j, 1.0), frames[j + 1]);
            }
            prop_assert_eq!(robot.body_point(&shape, n + 3, 0.2), frames[n].position_m);
        }

        #[test]
        fn the_body_is_a_curve_of_the_given_length_along_each_frames_z(shape in shapes(), share in 0.01..0.98_f64) {
            let robot = robot(shape.section_count());
            let frames = robot.section_frames(&shape);
            for (j, section) in robot.sections().iter().enumerate() {
                // Speed along the curve by central differences is the length, everywhere: inextensible, constant curvature.
                let step = 1e-3;
                let ahead = robot.body_point(&shape, j, share + step);
                let behind = robot.body_point(&shape, j, share - step);
                let speed = (ahead - behind).norm() / (2.0 * step);
                prop_assert!((speed / section.length_m - 1.0).abs() < 1e-5);
                let start = robot.body_point(&shape, j, 1e-6) - frames[j].position_m;
                prop_assert!((start.normalize() - frames[j].rotation.column(2)).norm() < 1e-5);
            }
        }
    }

    #[test]
    fn a_shape_of_another_section_count_is_adapted_to_the_robot() {
        let longer = Configuration::from_bend_angles(&[[0.6, -2.0], [1.1, 0.7], [0.4, 0.1]]);
        let shorter = Configuration::from_bend_angles(&[[0.6, -2.0]]);
        let same = Configuration::from_bend_angles(&[[0.6, -2.0], [1.1, 0.7]]);
        let straightened = Configuration::from_bend_angles(&[[0.6, -2.0], [0.0, 0.0]]);
        let robot = robot(2);
        for (other, own) in [(&longer, &same), (&shorter, &straightened)] {
            assert_eq!(robot.tip_position(other), robot.tip_position(own));
            assert_eq!(robot.tip_pose(other), robot.tip_pose(own));
            assert_eq!(robot.cable_lengths(other), robot.cable_lengths(own));
            assert_eq!(robot.body(other), robot.body(own));
            let mut columns = [Jacobian::new(), Jacobian::new()];
            let [first, second] = &mut columns;
            robot.tip_jacobian(other, first);
            robot.tip_jacobian(own, second);
            assert_eq!(first, second);
        }
    }

    #[test]
    fn an_s_outside_its_range_is_clamped() {
        let shape = Configuration::from_bend_angles(&[[0.6, -2.0], [1.1, 0.7]]);
        let robot = robot(2);
        assert_eq!(
            robot.body_point(&shape, 1, -0.5),
            robot.body_point(&shape, 1, 0.0)
        );
        assert_eq!(
            robot.body_point(&shape, 1, 1.5),
            robot.tip_pose(&shape).position_m
        );
    }

    #[test]
    fn a_quarter_circle_and_a_full_circle_agree_with_geometry() {
        let robot = robot(1);
        let radius_m = 0.3 / core::f64::consts::FRAC_PI_2;
        let quarter = Configuration::from_bend_angles(&[[core::f64::consts::FRAC_PI_2, 0.0]]);
        assert!(
            (robot.tip_pose(&quarter).position_m - Vector3::new(radius_m, 0.0, radius_m)).norm()
                < 1e-16
        );
        let circle = Configuration::from_bend_angles(&[[core::f64::consts::TAU, 1.0]]);
        assert!(robot.tip_pose(&circle).position_m.norm() < 1e-16);
    }
}
