//! Other representations of a rotation: the paper's three angles, and the quaternion of the wire protocol.

use nalgebra::{Matrix3, Vector4};

/// The paper's orientation {Φ, Θ, Ψ} (rad): R = Rz(Φ) Ry(Θ) Rx(Ψ).
///
/// The paper does not print its convention; this is the usual one of its school (§1 of docs/model.md). Near the
/// straight robot Θ and Ψ are the tilt of the tip's axis, and Φ its twist.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ZyxAngles {
    /// Φ, about z (rad), in [-π, π].
    pub phi_rad: f64,
    /// Θ, about the y axis after the turn by Φ (rad); [`Self::from_rotation`] gives [-π/2, π/2].
    pub theta_rad: f64,
    /// Ψ, about the x axis after both turns (rad), in [-π, π].
    pub psi_rad: f64,
}

impl ZyxAngles {
    /// Angles of a rotation matrix.
    ///
    /// Φ is computed first and divided out; Θ and Ψ follow from the remaining rotation. Near Θ = ±π/2 (gimbal lock)
    /// only Φ ∓ Ψ is defined. There Φ depends on rounding, and Ψ completes it to the same rotation. In exact gimbal
    /// lock Φ = 0. Finite for every finite matrix.
    pub fn from_rotation(rotation: &Matrix3<f64>) -> Self {
        let r = rotation;
        let phi_rad = r.m21.atan2(r.m11);
        let (sin, cos) = phi_rad.sin_cos();
        Self {
            phi_rad,
            theta_rad: (-r.m31).atan2(cos * r.m11 + sin * r.m21),
            psi_rad: (sin * r.m13 - cos * r.m23).atan2(cos * r.m22 - sin * r.m12),
        }
    }

    /// The rotation matrix Rz(Φ) Ry(Θ) Rx(Ψ). Any finite angles are valid.
    pub fn to_rotation(&self) -> Matrix3<f64> {
        let (sz, cz) = self.phi_rad.sin_cos();
        let (sy, cy) = self.theta_rad.sin_cos();
        let (sx, cx) = self.psi_rad.sin_cos();
        Matrix3::new(
            cz * cy,
            cz * sy * sx - sz * cx,
            cz * sy * cx + sz * sx,
            sz * cy,
            sz * sy * sx + cz * cx,
            sz * sy * cx - cz * sx,
            -sy,
            cy * sx,
            cy * cx,
        )
    }
}

/// Unit quaternion (x, y, z, w) of a rotation matrix, with w ≥ 0.
///
/// Shepperd's method (1978): of four equivalent expressions, it uses the one that divides by the largest component,
/// which is at least 1/2. No rotation loses digits.
pub fn quaternion_xyzw(rotation: &Matrix3<f64>) -> [f64; 4] {
    let r = rotation;
    let trace = r.m11 + r.m22 + r.m33;
    // Each row is 4 q_k q for the component q_k whose square is the largest.
    let scaled = if trace >= r.m11 && trace >= r.m22 && trace >= r.m33 {
        Vector4::new(r.m32 - r.m23, r.m13 - r.m31, r.m21 - r.m12, 1.0 + trace)
    } else if r.m11 >= r.m22 && r.m11 >= r.m33 {
        Vector4::new(
            1.0 + r.m11 - r.m22 - r.m33,
            r.m21 + r.m12,
            r.m13 + r.m31,
            r.m32 - r.m23,
        )
    } else if r.m22 >= r.m33 {
        Vector4::new(
            r.m21 + r.m12,
            1.0 + r.m22 - r.m11 - r.m33,
            r.m32 + r.m23,
            r.m13 - r.m31,
        )
    } else {
        Vector4::new(
            r.m13 + r.m31,
            r.m32 + r.m23,
            1.0 + r.m33 - r.m11 - r.m22,
            r.m21 - r.m12,
        )
    };
    let sign = if scaled.w < 0.0 { -1.0 } else { 1.0 };
    (scaled * (sign / scaled.norm())).into()
}

#[cfg(test)]
mod tests {
    use core::f64::consts::{FRAC_PI_2, PI};

    use nalgebra::{Quaternion, Rotation3, UnitQuaternion, Vector3};
    use proptest::prelude::*;

    use super::*;

    /// Rotation errors below this are rounding.
    const ROUNDING: f64 = 2e-15;

    fn rebuilt_from_quaternion(quaternion: [f64; 4]) -> Matrix3<f64> {
        let unit = UnitQuaternion::new_unchecked(Quaternion::from(Vector4::from(quaternion)));
        unit.to_rotation_matrix().into_inner()
    }

    proptest! {
        #[test]
        fn angles_and_rotations_are_inverse(phi_rad in -3.1..3.1_f64, theta_rad in -1.5..1.5_f64, psi_rad in -3.1..3.1_f64) {
            let back = ZyxAngles::from_rotation(&ZyxAngles { phi_rad, theta_rad, psi_rad }.to_rotation());
            // cos 1.5 = 0.07, so Φ and Ψ keep a fourteenth of the digits there.
            prop_assert!((back.phi_rad - phi_rad).abs() < 20.0 * ROUNDING);
            prop_assert!((back.theta_rad - theta_rad).abs() < 20.0 * ROUNDING);
            prop_assert!((back.psi_rad - psi_rad).abs() < 20.0 * ROUNDING);
        }

        #[test]
        fn the_rotation_survives_gimbal_lock(
            phi_rad in -3.1..3.1_f64, off in prop_oneof![Just(0.0), 0.0..1e-7_f64, 0.0..1e-15_f64],
            up in any::<bool>(), psi_rad in -3.1..3.1_f64,
        ) {
            let theta_rad = if up { FRAC_PI_2 - off } else { off - FRAC_PI_2 };
            let rotation = ZyxAngles { phi_rad, theta_rad, psi_rad }.to_rotation();
            let back = ZyxAngles::from_rotation(&rotation).to_rotation();
            prop_assert!((back - rotation).amax() < ROUNDING, "{:e}", (back - rotation).amax());
        }

        #[test]
        fn quaternions_rebuild_the_rotation_with_w_not_negative(
            x in -1.0..1.0_f64, y in -1.0..1.0_f64, z in -1.0..1.0_f64, angle in prop_oneof![0.0..PI, Just(PI), Just(0.0)],
        ) {
            prop_assume!(x.abs() + y.abs() + z.abs() > 1e-3);
            let axis = Vector3::new(x, y, z).normalize();
            let rotation = Rotation3::from_scaled_axis(axis * angle).into_inner();
            let quaternion = quaternion_xyzw(&rotation);
            prop_assert!(quaternion[3] >= 0.0);
            prop_assert!((Vector4::from(quaternion).norm() - 1.0).abs() < 1e-15);
            prop_assert!((rebuilt_from_quaternion(quaternion) - rotation).amax() < ROUNDING);
        }
    }

    #[test]
    fn angles_compose_as_rz_ry_rx() {
        let (phi_rad, theta_rad, psi_rad) = (0.3, -0.4, 1.2);
        let product = Rotation3::from_axis_angle(&Vector3::z_axis(), phi_rad)
            * Rotation3::from_axis_angle(&Vector3::y_axis(), theta_rad)
            * Rotation3::from_axis_angle(&Vector3::x_axis(), psi_rad);
        let composed = ZyxAngles {
            phi_rad,
            theta_rad,
            psi_rad,
        }
        .to_rotation();
        assert!((composed - product.into_inner()).amax() < ROUNDING);
    }

    #[test]
    fn in_exact_lock_phi_is_zero_and_nothing_is_nan() {
        for sign in [1.0, -1.0] {
            let rotation = Matrix3::new(0.0, 0.0, sign, 0.0, 1.0, 0.0, -sign, 0.0, 0.0);
            let angles = ZyxAngles::from_rotation(&rotation);
            assert!(angles.phi_rad == 0.0 && angles.psi_rad == 0.0);
            assert!((angles.theta_rad - sign * FRAC_PI_2).abs() < ROUNDING);
        }
    }

    #[test]
    fn half_turns_about_each_axis_and_no_turn_have_their_known_quaternions() {
        let diagonal = |x, y, z| Matrix3::from_diagonal(&Vector3::new(x, y, z));
        for (rotation, expected) in [
            (diagonal(1.0, 1.0, 1.0), [0.0, 0.0, 0.0, 1.0]),
            (diagonal(1.0, -1.0, -1.0), [1.0, 0.0, 0.0, 0.0]),
            (diagonal(-1.0, 1.0, -1.0), [0.0, 1.0, 0.0, 0.0]),
            (diagonal(-1.0, -1.0, 1.0), [0.0, 0.0, 1.0, 0.0]),
        ] {
            assert_eq!(
                Vector4::from(quaternion_xyzw(&rotation)),
                Vector4::from(expected)
            );
        }
    }
}
