//! Speed of the section ends (§1 of docs/model.md).
//!
//! From the base outwards, with the velocity v and the rotational velocity ω of the end of section j:
//! `vⱼ = vⱼ₋₁ + ωⱼ₋₁ × R₀ⱼ₋₁ pⱼ + R₀ⱼ₋₁ ∂pⱼ ḃⱼ` and `ωⱼ = ωⱼ₋₁ + R₀ⱼ₋₁ ωⱼ(ḃⱼ)`. It is the Jacobian of the tip times
//! the rates, for the robot up to each section, without the matrix.

use nalgebra::Vector3;

use super::{BendRates, Configuration, Pose, Robot};

impl Robot {
    /// Largest speed of the end of any section, seen from the base (m/s). Linear in the rates: half the rates, half the
    /// speed. NaN or infinite where numbers overflow.
    pub fn fastest_section_end_m_s(&self, configuration: &Configuration, rates: &BendRates) -> f64 {
        let mut pose = Pose::identity();
        let (mut velocity, mut spin) = (Vector3::zeros(), Vector3::zeros());
        let mut fastest_2 = 0.0_f64;
        for (arc, [u_rate, v_rate]) in self.arcs(configuration).zip(rates.pairs()) {
            let [p_u, p_v] = arc.position_derivatives_m_rad();
            let [w_u, w_v] = arc.rotation_derivatives();
            let along_m = pose.rotation * arc.position_m();
            velocity += spin.cross(&along_m) + pose.rotation * (p_u * *u_rate + p_v * *v_rate);
            spin += pose.rotation * (w_u * *u_rate + w_v * *v_rate);
            pose = pose.then(&arc);
            let square = velocity.norm_squared();
            // A NaN stays, unlike in `f64::max`.
            if square.is_nan() || square > fastest_2 {
                fastest_2 = square;
            }
        }
        fastest_2.sqrt()
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::robot::{Jacobian, RobotParameters, SECTIONS_MAX};

    proptest! {
        /// The Jacobian of the tip of the robot up to each section gives the same speed.
        #[test]
        fn the_jacobians_of_the_section_ends_give_the_same_speed(
            sections in 1..=SECTIONS_MAX,
            bends in prop::array::uniform12(-2.2..2.2_f64),
            rates in prop::array::uniform12(-3.0..3.0_f64),
        ) {
            let mut fastest_m_s = 0.0_f64;
            for ends in 1..=sections {
                let part = Robot::new(&RobotParameters::paper(ends)).unwrap();
                let shape = Configuration::from_slice(&bends[..2 * ends]).unwrap();
                let mut jacobian = Jacobian::new();
                part.tip_jacobian(&shape, &mut jacobian);
                let mut velocity = Vector3::zeros();
                for (column, rate) in jacobian.columns().iter().zip(rates) {
                    velocity += Vector3::new(column[0], column[1], column[2]) * rate;
                }
                fastest_m_s = fastest_m_s.max(velocity.norm());
            }
            let robot = Robot::new(&RobotParameters::paper(sections)).unwrap();
            let shape = Configuration::from_slice(&bends[..2 * sections]).unwrap();
            let found_m_s = robot
                .fastest_section_end_m_s(&shape, &BendRates::from_slice(&rates[..2 * sections]).unwrap());
            prop_assert!((found_m_s - fastest_m_s).abs() <= 1e-13 * fastest_m_s, "{found_m_s} for {fastest_m_s}");
        }
    }

    /// A NaN in any section shows, whatever the sections after it do.
    #[test]
    fn a_speed_that_is_no_number_shows() {
        let robot = Robot::new(&RobotParameters::paper(3)).unwrap();
        for j in 0..6 {
            let mut rates = BendRates::zero(3);
            rates.as_mut_slice()[j] = f64::NAN;
            let speed_m_s = robot.fastest_section_end_m_s(&Configuration::straight(3), &rates);
            assert!(speed_m_s.is_nan(), "{j}");
        }
    }
}
