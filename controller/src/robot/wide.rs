//! Tip positions of W configurations side by side: the kernel of the swarm.

use super::Robot;
use super::section::series_coefficients;
use crate::wide::Wide;

impl Robot {
    /// Position of the tip in the base frame \[m\] for W configurations, `bend_rad(i)` being the i-th
    /// bend-vector component of each \[rad\].
    ///
    /// Neither branches nor trigonometry: the series of the section's coefficients, good to 5e-16 for
    /// θ ≤ π, to 1e-12 for θ ≤ 2π. Lane by lane the bits are those of W = 1.
    #[inline(always)]
    pub fn tip_position_wide<const W: usize>(
        &self,
        bend_rad: impl Fn(usize) -> Wide<W>,
    ) -> [Wide<W>; 3] {
        let zero = Wide::splat(0.0);
        let [mut x, mut y, mut z] = [zero; 3];
        for (j, section) in self.sections().iter().enumerate().rev() {
            let (u, v) = (bend_rad(2 * j), bend_rad(2 * j + 1));
            let w = u * u + v * v;
            let (f, g) = series_coefficients(w);
            // x ← Rⱼ x + pⱼ with t = ℓ - (u x + v y), as in `tip_position`.
            let t = Wide::splat(section.length_m) - (u * x + v * y);
            let across = f * z + g * t;
            x = x + u * across;
            y = y + v * across;
            z = (Wide::splat(1.0) - w * g) * z + f * t;
        }
        [x, y, z]
    }
}

#[cfg(test)]
mod tests {
    use crate::robot::RobotParameters;

    use super::*;

    #[test]
    fn agrees_with_the_scalar_chain_and_lane_by_lane_with_itself() {
        for sections in 1..=6 {
            let robot = Robot::new(&RobotParameters::paper(sections)).unwrap();
            let bend = |i: usize, lane: usize| 0.37 * (i as f64 - 2.0) * (0.4 + lane as f64 * 0.11);
            let wide = robot.tip_position_wide(|i| Wide::<8>::from_fn(|lane| bend(i, lane)));
            for lane in 0..8 {
                let bends: Vec<_> = (0..2 * sections).map(|i| bend(i, lane)).collect();
                let narrow = robot.tip_position_wide(|i| Wide([bends[i]]));
                let scalar = robot.tip_position(&bends);
                for axis in 0..3 {
                    assert_eq!(wide[axis].0[lane].to_bits(), narrow[axis].0[0].to_bits());
                    assert!((wide[axis].0[lane] - scalar[axis]).abs() < 1e-12);
                }
            }
        }
    }
}
