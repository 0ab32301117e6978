//! Tip positions of many configurations in one call.

use pulp::{Arch, NullaryFnOnce};

use super::section::series_position_coefficients;
use super::{Configuration, Robot};
use crate::wide::LANES;

impl Robot {
    /// Tip positions in the base frame (m). `bend_rad` holds 2n bend-vector components (rad) for each configuration,
    /// `tip_m` receives x, y, z for each. Surplus elements of the longer slice are ignored.
    ///
    /// Evaluates eight configurations side by side with the processor's SIMD instructions. The result is bit-identical
    /// to [`Self::tip_position`].
    pub fn tip_positions(&self, bend_rad: &[f64], tip_m: &mut [f64]) {
        Arch::new().dispatch(Tips {
            robot: self,
            bend_rad,
            tip_m,
        });
    }
}

struct Tips<'a> {
    robot: &'a Robot,
    bend_rad: &'a [f64],
    tip_m: &'a mut [f64],
}

impl NullaryFnOnce for Tips<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let width = self.robot.coordinate_count();
        let blocks = self.bend_rad.chunks(LANES * width);
        for (bends, tips) in blocks.zip(self.tip_m.chunks_mut(LANES * 3)) {
            let is_full = bends.len() == LANES * width && tips.len() == LANES * 3;
            if !(is_full && eight_at_once(self.robot, bends, tips)) {
                one_by_one(self.robot, bends, tips);
            }
        }
    }
}

/// Evaluates the configurations one by one.
#[inline(never)]
fn one_by_one(robot: &Robot, bend_rad: &[f64], tip_m: &mut [f64]) {
    let mut shape = Configuration::straight(robot.section_count());
    let bends = bend_rad.chunks_exact(robot.coordinate_count());
    for (bend, place) in bends.zip(tip_m.chunks_exact_mut(3)) {
        shape.as_mut_slice().copy_from_slice(bend);
        place.copy_from_slice(robot.tip_position(&shape).as_slice());
    }
}

/// The operations of `tip_position` in the same order, for eight configurations. False if the series is not valid for
/// every section.
#[inline(always)]
fn eight_at_once(robot: &Robot, bend_rad: &[f64], tip_m: &mut [f64]) -> bool {
    let width = robot.coordinate_count();
    let [mut x, mut y, mut z] = [[0.0; LANES]; 3];
    let mut in_series = true;
    for (j, section) in robot.sections().iter().enumerate().rev() {
        let (mut u, mut v) = ([0.0; LANES], [0.0; LANES]);
        for i in 0..LANES {
            u[i] = bend_rad[i * width + 2 * j];
            v[i] = bend_rad[i * width + 2 * j + 1];
        }
        for i in 0..LANES {
            let w = u[i] * u[i] + v[i] * v[i];
            let (f, g, serves) = series_position_coefficients(w);
            in_series &= serves;
            let t = section.length_m - (u[i] * x[i] + v[i] * y[i]);
            let across = f * z[i] + g * t;
            x[i] += u[i] * across;
            y[i] += v[i] * across;
            z[i] = (1.0 - w * g) * z[i] + f * t;
        }
    }
    for i in 0..LANES {
        tip_m[3 * i] = x[i];
        tip_m[3 * i + 1] = y[i];
        tip_m[3 * i + 2] = z[i];
    }
    in_series
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::RobotParameters;

    /// From straight to beyond the series; two of the blocks contain NaN or infinity.
    fn bends(count: usize) -> Vec<f64> {
        let bend = |i: usize| match i {
            77 => f64::NAN,
            203 => f64::INFINITY,
            _ if i.is_multiple_of(5) => 0.0,
            _ if i < 200 => (i as f64 * 0.7).sin() * 3.1,
            _ => (i as f64 * 0.7).sin() * 0.011 * i as f64,
        };
        (0..count).map(bend).collect()
    }

    fn avx2(tips: Tips<'_>) {
        #[cfg(target_arch = "x86_64")]
        if let Some(processor) = pulp::x86::V3::try_new() {
            return pulp::Simd::vectorize(processor, tips);
        }
        tips.call();
    }

    #[test]
    fn tip_positions_are_bit_identical_on_every_simd_path() {
        let paths: [fn(Tips<'_>); 3] =
            [|tips| Arch::new().dispatch(tips), |tips| tips.call(), avx2];
        for (sections, count) in (1..=6).flat_map(|n| [0, 1, 7, 8, 9, 61].map(|count| (n, count))) {
            let robot = Robot::new(&RobotParameters::paper(sections)).unwrap();
            let bends = bends(count * 2 * sections);
            for path in paths {
                let mut tips = vec![0.0; 3 * count];
                path(Tips {
                    robot: &robot,
                    bend_rad: &bends,
                    tip_m: &mut tips,
                });
                for (bend, tip) in bends.chunks_exact(2 * sections).zip(tips.chunks_exact(3)) {
                    let shape = Configuration::from_slice(bend).unwrap();
                    for (found, expected) in tip.iter().zip(&robot.tip_position(&shape)) {
                        let both_nan = found.is_nan() && expected.is_nan();
                        assert!(
                            both_nan || found.to_bits() == expected.to_bits(),
                            "{bend:?}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn surplus_elements_are_ignored() {
        let robot = Robot::new(&RobotParameters::paper(1)).unwrap();
        let mut tips = [7.0; 30];
        robot.tip_positions(&[0.1; 19], &mut tips);
        assert!(tips[..27].iter().all(|place| *place != 7.0) && tips[27..] == [7.0; 3]);
    }
}
