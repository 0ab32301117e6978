//! Tip positions of W configurations side by side: the kernel of the swarm's rollouts.

use super::section::{ShortSeries, series_coefficients, series_wide};
use super::{COORDINATES_MAX, Configuration, Robot, SECTIONS_MAX, SectionParameters};
use crate::wide::Wide;

/// The coefficients of all sections near one configuration.
pub(crate) type TipSeries = [ShortSeries; SECTIONS_MAX];

impl Robot {
    /// Position of the tip in the base frame \[m\] for W configurations, `bend_rad(i)` being the i-th
    /// bend-vector component of each \[rad\].
    ///
    /// No branches and no trigonometry: the coefficients come from the power series, accurate to 5e-16 for θ ≤ π and to
    /// 1e-12 for θ ≤ 2π. Each lane has the same bits as W = 1.
    #[inline(always)]
    pub(crate) fn tip_position_wide<const W: usize>(
        &self,
        bend_rad: impl Fn(usize) -> Wide<W>,
    ) -> [Wide<W>; 3] {
        tip_position_of(self.sections(), bend_rad)
    }

    /// Tip position by short series, faster, for configurations close to that of `tip_series`. Calls `bend_rad` once
    /// for each component.
    #[inline(always)]
    pub(crate) fn tip_position_by_series<const W: usize>(
        &self,
        tip_series: &TipSeries,
        bend_rad: impl FnMut(usize) -> Wide<W>,
    ) -> [Wide<W>; 3] {
        let (tip, []) =
            tip_wide::<W, 0, true>(self.sections(), bend_rad, |j, w| tip_series[j].evaluate(w));
        tip
    }

    /// Coefficients for [`Self::tip_position_by_series`] if no section's bend vector changes by more than `change_rad`;
    /// `None` if that range is too large.
    pub(crate) fn tip_series(
        &self,
        at: &Configuration,
        change_rad: &[f64; SECTIONS_MAX],
    ) -> Option<TipSeries> {
        let of_section = |j: usize| ShortSeries::around(at.section(j), change_rad[j]);
        let mut tip_series = [of_section(0)?; SECTIONS_MAX];
        for j in 1..self.section_count() {
            tip_series[j] = of_section(j)?;
        }
        Some(tip_series)
    }

    /// Position of the tip, and the first `AXES` (up to 2) of its z and x axis, in the base frame.
    #[inline(always)]
    pub(crate) fn tip_frame_wide<const W: usize, const AXES: usize>(
        &self,
        bend_rad: impl Fn(usize) -> Wide<W>,
    ) -> ([Wide<W>; 3], [[Wide<W>; 3]; AXES]) {
        tip_wide::<W, AXES, false>(self.sections(), bend_rad, |_, w| series_coefficients(w))
    }
}

/// [`Robot::tip_position_wide`] of these sections. Where the caller knows their number, the loops become straight code.
#[inline(always)]
pub(crate) fn tip_position_of<const W: usize>(
    sections: &[SectionParameters],
    bend_rad: impl Fn(usize) -> Wide<W>,
) -> [Wide<W>; 3] {
    let (tip, []) = tip_wide::<W, 0, false>(sections, bend_rad, |_, w| series_coefficients(w));
    tip
}

/// Tip position of these sections, and in `slopes` its derivatives by each component of the bend vectors \[m/rad\].
#[inline(always)]
pub(crate) fn tip_slopes_of<const W: usize>(
    sections: &[SectionParameters],
    bend_rad: impl Fn(usize) -> Wide<W>,
    slopes: &mut [[Wide<W>; 3]; COORDINATES_MAX],
) -> [Wide<W>; 3] {
    let mut tip = [Wide::splat(0.0); 3];
    for (j, section) in sections.iter().enumerate().rev() {
        let (u, v) = (bend_rad(2 * j), bend_rad(2 * j + 1));
        let w = u * u + v * v;
        let (h, k) = series_wide(w);
        let (f, g) = (Wide::splat(1.0) - w * h, Wide::splat(0.5) - w * k);
        let (f_slope, g_slope) = ((h - g) * 0.5, k - h * 0.5);
        let upright = Wide::splat(1.0) - w * g;
        // Transforms a vector from the end of this section to its start, as in `tip_wide`. Also returns the terms
        // that both components share.
        let turned = |[x, y, z]: [Wide<W>; 3], length_m: f64| {
            let t = Wide::splat(length_m) - (u * x + v * y);
            let across = f * z + g * t;
            let turned = [x + u * across, y + v * across, upright * z + f * t];
            (turned, t, across)
        };
        let (own, later) = slopes.split_at_mut(2 * j + 2);
        for slope in &mut later[..2 * (sections.len() - 1 - j)] {
            *slope = turned(*slope, 0.0).0;
        }
        let [x, y, z] = tip;
        let (end, t, across) = turned(tip, section.length_m);
        let bent = (f_slope * z + g_slope * t) * 2.0;
        let sunk = (f_slope * t - (g + w * g_slope) * z) * 2.0;
        let (by_u, by_v) = (u * bent - g * x, v * bent - g * y);
        own[2 * j] = [across + u * by_u, v * by_u, u * sunk - f * x];
        own[2 * j + 1] = [u * by_v, across + v * by_v, v * sunk - f * y];
        tip = end;
    }
    tip
}

/// As [`Robot::tip_frame_wide`], with the coefficients (f, g) of section j at w from `coefficients`. `SHORT`:
/// without axes, and with fewer operations for the last section, in more code.
#[inline(always)]
fn tip_wide<const W: usize, const AXES: usize, const SHORT: bool>(
    sections: &[SectionParameters],
    mut bend_rad: impl FnMut(usize) -> Wide<W>,
    coefficients: impl Fn(usize, f64) -> (f64, f64),
) -> ([Wide<W>; 3], [[Wide<W>; 3]; AXES]) {
    // Tip position (x, y, z) and axes, transformed from each section's end to its start.
    let [mut x, mut y, mut z] = [[0.0; W]; 3];
    let mut axes = [[Wide::splat(0.0); 3]; AXES];
    for (axis, component) in [2, 0].into_iter().enumerate().take(AXES) {
        axes[axis][component] = Wide::splat(1.0);
    }
    for (j, section) in sections.iter().enumerate().rev() {
        let (u, v) = (bend_rad(2 * j).0, bend_rad(2 * j + 1).0);
        let length_m = section.length_m;
        if SHORT && j + 1 == sections.len() {
            // Nothing follows the last section.
            for i in 0..W {
                let (f, g) = coefficients(j, u[i] * u[i] + v[i] * v[i]);
                (x[i], y[i], z[i]) = (u[i] * (g * length_m), v[i] * (g * length_m), f * length_m);
            }
            continue;
        }
        // One loop over the lanes with all of a section's arithmetic, so that the compiler vectorises it.
        for i in 0..W {
            let w = u[i] * u[i] + v[i] * v[i];
            let (f, g) = coefficients(j, w);
            let upright = 1.0 - w * g;
            // x ← Rⱼ x + pⱼ with t = ℓ - (u x + v y), as in `tip_position`.
            let t = length_m - (u[i] * x[i] + v[i] * y[i]);
            let across = f * z[i] + g * t;
            x[i] += u[i] * across;
            y[i] += v[i] * across;
            z[i] = upright * z[i] + f * t;
            for [x, y, z] in &mut axes {
                // A direction is not translated by pⱼ, hence no ℓ.
                let t = 0.0 - (u[i] * x.0[i] + v[i] * y.0[i]);
                let across = f * z.0[i] + g * t;
                x.0[i] += u[i] * across;
                y.0[i] += v[i] * across;
                z.0[i] = upright * z.0[i] + f * t;
            }
        }
    }
    ([x, y, z].map(Wide), axes)
}

#[cfg(test)]
mod tests {
    use crate::robot::{Jacobian, RobotParameters};

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
                let at = Configuration::from_slice(&bends).unwrap();
                let scalar = robot.tip_position(&at);
                // Some of these bends exceed the range of the short series.
                let tip_series = robot.tip_series(&at, &[1e-3; SECTIONS_MAX]);
                assert!(tip_series.is_some() || sections > 3);
                let beside = tip_series.map(|tip_series| {
                    robot.tip_position_by_series(&tip_series, |i| Wide([bends[i]]))
                });
                for axis in 0..3 {
                    assert_eq!(wide[axis].0[lane].to_bits(), narrow[axis].0[0].to_bits());
                    assert!((wide[axis].0[lane] - scalar[axis]).abs() < 1e-12);
                    let apart = beside.map_or(0.0, |tip| tip[axis].0[0] - scalar[axis]);
                    assert!(apart.abs() < 2e-15, "{sections}: {apart}");
                }
            }
        }
    }

    #[test]
    fn slopes_are_those_of_the_jacobian() {
        for sections in 1..=6 {
            let robot = Robot::new(&RobotParameters::paper(sections)).unwrap();
            // Lane 0 is straight, lane 1 bends by π at most.
            let bend = |i: usize, lane: usize| 1.1 * (i as f64 % 5.0 - 2.0) * lane as f64;
            let at = |i: usize| Wide::<2>::from_fn(|lane| bend(i, lane));
            let mut slopes = [[Wide::splat(0.0); 3]; COORDINATES_MAX];
            let tip = tip_slopes_of(robot.sections(), at, &mut slopes);
            assert_eq!(tip, robot.tip_position_wide(at));
            for lane in 0..2 {
                let bends: Vec<_> = (0..2 * sections).map(|i| bend(i, lane)).collect();
                let mut jacobian = Jacobian::default();
                robot.tip_jacobian(&Configuration::from_slice(&bends).unwrap(), &mut jacobian);
                for (slope, column) in slopes.iter().zip(jacobian.columns()) {
                    for axis in 0..3 {
                        let apart = slope[axis].0[lane] - column[axis];
                        assert!(apart.abs() < 1e-14, "{sections}: {apart}");
                    }
                }
            }
        }
    }

    #[test]
    fn the_tips_axes_are_those_of_its_pose() {
        for sections in 1..=6 {
            let robot = Robot::new(&RobotParameters::paper(sections)).unwrap();
            // Lane 0 is straight, lane 7 bends by π at most.
            let bend = |i: usize, lane: usize| 0.32 * (i as f64 % 5.0 - 2.0) * lane as f64 * 0.49;
            let at = |i: usize| Wide::<8>::from_fn(|lane| bend(i, lane));
            let (tip, [z, x]) = robot.tip_frame_wide::<8, 2>(at);
            assert_eq!(tip, robot.tip_position_wide(at));
            assert_eq!((tip, [z]), robot.tip_frame_wide::<8, 1>(at));
            for lane in 0..8 {
                let bends: Vec<_> = (0..2 * sections).map(|i| bend(i, lane)).collect();
                let pose = robot.tip_pose(&Configuration::from_slice(&bends).unwrap());
                let narrow = robot.tip_frame_wide::<1, 2>(|i| Wide([bends[i]])).1;
                for axis in 0..3 {
                    assert!((tip[axis].0[lane] - pose.position_m[axis]).abs() < 1e-14);
                    for (found, narrow, column) in [(z, narrow[0], 2), (x, narrow[1], 0)] {
                        let found = found[axis].0[lane];
                        assert_eq!(found.to_bits(), narrow[axis].0[0].to_bits());
                        assert!((found - pose.rotation[(axis, column)]).abs() < 1e-14);
                    }
                }
            }
        }
    }
}
