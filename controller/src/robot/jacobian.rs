//! Derivative of the tip pose by the bends (§1 of docs/model.md).
//!
//! For section j, in the base frame: `J_w,j = R₀ⱼ₋₁ ωⱼ` and `J_v,j = R₀ⱼ₋₁ ∂pⱼ + J_w,j × (p_tip - pⱼ)`. The section's
//! own end moves, and everything beyond it turns about that end.

use nalgebra::Vector3;

use super::{COORDINATES_MAX, Configuration, Pose, Robot, SECTIONS_MAX};

/// Jacobian of the tip: 6 rows [v; ω], one column for each of the 2n coordinates, in the base frame.
///
/// v is the velocity of the tip (m/rad), ω its rotational velocity (rad/rad): `[v; ω] = J (u̇1, v̇1, …)` and Ṙ =
/// skew(ω) R. Smooth everywhere. It loses rank at the straight robot, where the component of v along the axis is zero
/// in every column.
#[derive(Debug, Clone, PartialEq)]
pub struct Jacobian {
    columns: [[f64; 6]; COORDINATES_MAX],
    column_count: usize,
}

impl Default for Jacobian {
    fn default() -> Self {
        Self::new()
    }
}

impl Jacobian {
    /// An empty Jacobian, to be filled by [`Robot::tip_jacobian`].
    pub const fn new() -> Self {
        Self {
            columns: [[0.0; 6]; COORDINATES_MAX],
            column_count: 0,
        }
    }

    /// Number of columns: 2n once filled.
    pub fn column_count(&self) -> usize {
        self.column_count
    }

    /// Column `i`: [vx, vy, vz, ωx, ωy, ωz] for a unit rate of coordinate `i` (u1, v1, u2, …); zeros from 2n on.
    ///
    /// # Panics
    /// If `i` is 12 or more.
    #[inline]
    pub fn column(&self, i: usize) -> &[f64; 6] {
        &self.columns[i]
    }

    /// All 2n columns.
    pub fn columns(&self) -> &[[f64; 6]] {
        &self.columns[..self.column_count]
    }

    /// The same Jacobian in the paper's coordinates: columns for θ1, φ1, θ2, φ2, … at the given (θ, φ) (rad) of each
    /// section. The angles are an argument because the bend vector does not determine them: a straight section has no
    /// φ, and θ may be negative.
    ///
    /// The φ column of a straight section is zero, a singularity that the bend vector does not have.
    #[must_use]
    pub fn to_bend_angles(&self, bend_angles_rad: &[[f64; 2]]) -> Self {
        let mut by_angles = Self {
            columns: [[0.0; 6]; COORDINATES_MAX],
            column_count: self.column_count,
        };
        let (sources, _) = self.columns().as_chunks::<2>();
        let (targets, _) = by_angles.columns.as_chunks_mut::<2>();
        for ((target, [by_u, by_v]), [theta, phi]) in
            targets.iter_mut().zip(sources).zip(bend_angles_rad)
        {
            let (sin, cos) = phi.sin_cos();
            // u = θ cos φ, v = θ sin φ, by the chain rule.
            *target = [
                core::array::from_fn(|row| cos * by_u[row] + sin * by_v[row]),
                core::array::from_fn(|row| theta * (cos * by_v[row] - sin * by_u[row])),
            ];
        }
        by_angles
    }
}

impl Robot {
    /// Fills the Jacobian of the tip and returns the tip pose, a by-product.
    pub fn tip_jacobian(&self, configuration: &Configuration, jacobian: &mut Jacobian) -> Pose {
        let mut own = [[(Vector3::zeros(), Vector3::zeros()); 2]; SECTIONS_MAX];
        let mut ends = [Vector3::zeros(); SECTIONS_MAX];
        let mut pose = Pose::identity();
        for ((arc, own), end) in self.arcs(configuration).zip(&mut own).zip(&mut ends) {
            let [p_u, p_v] = arc.position_derivatives_m_rad();
            let [w_u, w_v] = arc.rotation_derivatives();
            *own = [
                (pose.rotation * p_u, pose.rotation * w_u),
                (pose.rotation * p_v, pose.rotation * w_v),
            ];
            pose = pose.then(&arc);
            *end = pose.position_m;
        }
        jacobian.column_count = self.coordinate_count();
        let (columns, _) = jacobian.columns.as_chunks_mut::<2>();
        let present = self.section_count();
        for ((columns, own), end) in columns[..present].iter_mut().zip(&own).zip(&ends) {
            let lever = pose.position_m - end;
            for (column, (end_velocity, spin)) in columns.iter_mut().zip(own) {
                let velocity = end_velocity + spin.cross(&lever);
                *column = [velocity.x, velocity.y, velocity.z, spin.x, spin.y, spin.z];
            }
        }
        columns[present..].fill([[0.0; 6]; 2]);
        pose
    }
}
